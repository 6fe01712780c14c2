// What start-up code and HAL of a Cortex-M board promise each other.

#ifndef BOARD_H_
#define BOARD_H_

#include <stdint.h>

#define BOARD_FED_MS 100  // the main loop may be silent for so long

// Of hal.c: serve external interrupt `number`.
void board_interrupt(int32_t number);

// Of startup.c: take the torque of every servo, remember why, reset the board. Never returns.
__attribute__((noreturn)) void board_die(int32_t cause);

// Of startup.c: begin to tick, once a millisecond.
void board_start_ticks(uint32_t core_hz);

// Of startup.c: the main loop is well.
void board_fed(void);

// Of startup.c: why board_die was called before this reset, sv_reset_cause; SV_RESET_POWER if it was not.
int32_t board_died_of(void);

// Enable external interrupt `number`.
void board_enable_interrupt(int32_t number);

#endif  // BOARD_H_
