// What start-up code, lines and HAL of a Cortex-M board promise each other.

#ifndef BOARD_H_
#define BOARD_H_

#include <stdint.h>

#include "ring.h"

#define BOARD_FED_MS 100  // the main loop may be silent for so long

typedef void (*board_vector)(void);

// Of hal.c: the handlers of the external interrupts, in their order; board_fault where none is enabled. All have the
// tick's priority, so that none stands upon another.
#define BOARD_EXTERNAL __attribute__((section(".vectors.external"), used)) static const board_vector

// Of hal.c: the handler of the interrupt that nothing masks.
void board_on_nmi(void);

// Of hal.c: send to the servos by polling, so that fault handlers can; return once the line is free for answers. Never
// inlined: a debugger stops at it.
int32_t board_send_bus(const uint8_t* data, int32_t size);

// Of hal.c, with interrupts off: give the console's line as much of board_answers as it takes now; its interrupt takes
// the rest.
void board_send_answers(void);

// Of lines.c: what has come on each line, by sv_line; a debugger may append to them.
extern ring board_received[3];

// Of lines.c: what the console is to send.
extern ring board_answers;

// Of startup.c: take the torque of every servo, remember why, reset the board. Never returns.
__attribute__((noreturn)) void board_die(int32_t cause);

// Of startup.c: the handler of faults, and of interrupts that nobody serves.
__attribute__((noreturn)) void board_fault(void);

// Of startup.c: how long the main loop may still be silent [ms]; 0: it has never been heard.
extern volatile int32_t board_fed_ms;

// Begin to tick, once a millisecond.
static inline void board_start_ticks(uint32_t core_khz) {
  volatile uint32_t* systick = (volatile uint32_t*)0xE000E010U;
  systick[1] = core_khz - 1U;
  systick[2] = 0U;
  systick[0] = 7U;
}

// Of startup.c: why board_die was called before this reset, sv_reset_cause; SV_RESET_POWER if it was not. A board that
// knows better from its own flags says so in sv_hal_init.
extern int32_t board_reset_cause;

#endif  // BOARD_H_
