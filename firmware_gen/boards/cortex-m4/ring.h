// A ring of bytes between an interrupt and the main loop: one side writes, the other takes, neither waits.
//
// The counters run on for ever and wrap by themselves; their difference is what waits. What does not fit is dropped and
// counted, the oldest bytes stay. A debugger may be the writer: deploy/firmware/qemu.py knows this layout.

#ifndef RING_H_
#define RING_H_

#include <stdint.h>

typedef struct {
  uint8_t* bytes;
  uint16_t mask;              // size - 1, the size being a power of two
  volatile uint16_t written;  // bytes that have come in
  volatile uint16_t taken;    // bytes that have gone out
  volatile uint16_t lost;     // bytes that did not fit
} ring;

// Return how many bytes wait.
static inline uint16_t ring_count(const ring* r) { return (uint16_t)(r->written - r->taken); }

// Return how many bytes fit.
static inline uint16_t ring_space(const ring* r) { return (uint16_t)(r->mask + 1U - ring_count(r)); }

// Append a byte.
static inline void ring_put(ring* r, uint8_t byte) {
  if (ring_space(r) == 0U) {
    r->lost++;
    return;
  }
  r->bytes[r->written & r->mask] = byte;
  __asm volatile("" ::: "memory");  // the byte is there before it counts
  r->written++;
}

// Take the oldest byte; there must be one.
static inline uint8_t ring_take(ring* r) {
  const uint8_t byte = r->bytes[r->taken & r->mask];
  __asm volatile("" ::: "memory");  // its place is free after it was read
  r->taken++;
  return byte;
}

#endif  // RING_H_
