#include "ring.h"

int32_t ring_put(ring* r, uint8_t byte) {
  if (ring_count(r) > r->mask) {
    r->lost++;
    return 0;
  }
  r->bytes[r->written & r->mask] = byte;
  __asm volatile("" ::: "memory");  // the byte is there before it counts
  r->written++;
  return 1;
}

uint8_t ring_take(ring* r) {
  const uint8_t byte = r->bytes[r->taken & r->mask];
  __asm volatile("" ::: "memory");  // its place is free after it was read
  r->taken++;
  return byte;
}
