// A recorded run of the native twin, given once more to the same firmware on another processor.
//
// The board of a replay is the record: what came over the lines and when, wait by wait, and a sum of all that the twin
// had said by then. A processor that computes, shifts or rounds differently says something else.

#ifndef REPLAY_H_
#define REPLAY_H_

#include <stdint.h>

// events: u32 sum, u32 now_us, u8 inputs, u16 bytes that come on bus, sensors, console; little endian
typedef enum { REPLAY_BUS = 0, REPLAY_SENSORS = 1, REPLAY_CONSOLE = 2, REPLAY_EVENTS = 3 } replay_stream;

// Return a byte of the record, and how many events it has: the processor's own.
uint8_t replay_byte(int32_t stream, int32_t place);
int32_t replay_nevent(void);

// The replay is over: at an event where the sums differ, or at the end (differs 0).
void replay_end(int32_t event, int32_t differs) __attribute__((noreturn));

#endif  // REPLAY_H_
