// What the firmware needs of a board: a clock, three byte lines, two inputs, a watchdog.
//
// A board is one file that implements these functions; everything else is the same on every board, on the native twin
// and under emulation. Nothing here allocates. Every wait is bounded: sv_hal_wait by its time, a write to the bus by
// the time that its bytes need on the line.

#ifndef SV_HAL_H_
#define SV_HAL_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
  SV_LINE_BUS = 0,      // the servos, half duplex
  SV_LINE_SENSORS = 1,  // the sensor node, read only
  SV_LINE_CONSOLE = 2   // commands in, answers and the log out
} sv_line;

typedef enum {
  SV_INPUT_STOP = 1,  // emergency stop: run no further, take the torque
  SV_INPUT_START = 2  // a button that does what the commands "arm" and "start" do
} sv_input;

typedef enum {
  SV_RESET_POWER = 0,     // switched on, or reset by a person
  SV_RESET_WATCHDOG = 1,  // the main loop hung
  SV_RESET_FAULT = 2,     // a fault handler was entered
  SV_RESET_SUPPLY = 3,    // the board's supply fell
  SV_RESET_CLOCK = 4      // the crystal stopped
} sv_reset_cause;

// Bring up clock, lines, inputs and watchdog; called once, first.
void sv_hal_init(void);

// Return the time since boot [us]; it never goes back, but begins anew every 2^32 us: see sv_time.h.
uint32_t sv_hal_now_us(void);

// Sleep until a byte waits on any line, an input changes, or a time has come; may return early.
void sv_hal_wait(uint32_t until_us);

// Take bytes that have come on a line, oldest first: => data; return how many, 0..size.
int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size);

// Send bytes; return how many the line took. The bus takes all and returns once the last bit has left and the line is
// free for answers (in emulation, at once). The console never waits: what does not fit its buffer is not taken.
int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size);

// Return which inputs are active, sv_input ORed.
uint32_t sv_hal_inputs(void);

// Tell the watchdog that the main loop is well. It bites after about 0.1 s without, and never before the first call.
void sv_hal_feed_watchdog(void);

// Return why the board was reset, sv_reset_cause.
int32_t sv_hal_reset_cause(void);

#ifdef __cplusplus
}
#endif

#endif  // SV_HAL_H_
