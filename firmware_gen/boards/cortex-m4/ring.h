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

// Append a byte, or count it as lost; return whether it fits.
int32_t ring_put(ring* r, uint8_t byte);

// Take the oldest byte; there must be one.
uint8_t ring_take(ring* r);

#endif  // RING_H_
