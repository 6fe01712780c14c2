// Counter-based noise: the n-th word of splitmix64, so a value depends on its place and never on the order of calls.

#include "rollout.h"

// (seed, counter) => 64 random bits
static uint64_t word(uint64_t seed, uint64_t counter) {
  uint64_t z = seed + (counter + 1u) * UINT64_C(0x9E3779B97F4A7C15);
  z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
  z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
  return z ^ (z >> 31);
}

double sv_noise(uint64_t seed, int32_t substep, int32_t channel) {
  uint64_t place = ((uint64_t)(uint32_t)substep * SV_SENSOR_MAX + (uint64_t)(uint32_t)channel) * 2u;
  int32_t sum = 0;
  for (uint64_t i = 0; i < 2; i++) {
    uint64_t bits = word(seed, place + i);
    for (int j = 0; j < 4; j++) {
      sum += (int32_t)((bits >> (16 * j)) & 0xFFFFu);
    }
  }
  // eight uniforms of variance 1/12 each, centred
  return (double)(sum - 262140) * (1.0 / 65536.0) * 1.2247448713915890;
}
