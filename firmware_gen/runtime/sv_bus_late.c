#include "sv_bus_late.h"

#include "sv_hal.h"

#define SV_LATE_US_MAX 250000U  // a reply that has not come by then will not come. An estimate.

void sv_bus_forget_late(sv_bus* bus) {
  for (int32_t i = 0; i < SV_LENGTHS; i++) {
    bus->lost_us[i] = sv_hal_now_us() - SV_LATE_US_MAX;
  }
}

void sv_bus_remember_late(sv_bus* bus, int32_t size) { bus->lost_us[(uint32_t)size % SV_LENGTHS] = sv_hal_now_us(); }

int32_t sv_bus_unlike_late(const sv_bus* bus, int32_t size) {
  const uint32_t now_us = sv_hal_now_us();
  int32_t best = size;
  uint32_t longest_us = 0;
  for (int32_t asked = size; asked < size + SV_LENGTHS; asked++) {
    const uint32_t since_us = now_us - bus->lost_us[(uint32_t)asked % SV_LENGTHS];
    if (since_us >= SV_LATE_US_MAX) {
      return asked;
    }
    if (since_us > longest_us) {
      longest_us = since_us;
      best = asked;
    }
  }
  return best;
}
