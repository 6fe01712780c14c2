// Start-up code of a Cortex-M4F: vectors, memory, FPU, and what happens when all is lost.
//
// A fault, a hung main loop (no sv_hal_feed_watchdog for BOARD_FED_MS) and an interrupt that nobody serves all end in
// board_die: torque-off packets to every servo, sent by polling with interrupts off, on a stack of its own, then a
// reset. The board's own watchdog stands behind that: it needs neither this code nor the core's interrupts. The stack
// lies at the bottom of the RAM, so that its overflow is a fault and not another variable's end.
//
// Source: Armv7-M Architecture Reference Manual (DDI 0403E) B1.5, B3.2, B3.3.

#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "sv_hal.h"

#define REG(address) (*(volatile uint32_t*)(address))
#define SCB_VTOR REG(0xE000ED08U)
#define SCB_AIRCR REG(0xE000ED0CU)

#define ROUNDS 3  // torque off is said so often: a servo that was answering talked over the first
#define DEAD 0x5A5A5A5AU

extern uint32_t board_stack_top[], board_data_begin[], board_data_end[], board_data_stored[];
extern uint32_t board_zero_begin[], board_zero_end[];

void sv_robot_panic(void);  // of sv_robot.h
void board_reset(void);
void board_begin(void);
void board_last_words(int32_t cause);
void board_on_tick(void);
int main(void);
void* memcpy(void* restrict to, const void* restrict from, size_t n);
void* memmove(void* to, const void* from, size_t n);
void* memset(void* to, int value, size_t n);
int memcmp(const void* a, const void* b, size_t n);

// both survive a reset: DEAD if the board has died, and of what
static uint32_t board_state __attribute__((section(".noinit")));
int32_t board_reset_cause __attribute__((section(".noinit")));

volatile int32_t board_fed_ms;

// the core's: stack, reset, NMI, faults, …, SysTick; the board's follow them
__attribute__((section(".vectors"), used)) static const struct {
  const void* stack;
  board_vector core[15];
} vectors = {board_stack_top,
             {board_reset, board_on_nmi, board_fault, board_fault, board_fault, board_fault, board_fault, board_fault,
              board_fault, board_fault, board_fault, board_fault, board_fault, board_fault, board_on_tick}};

// the FPU first: compiled code may use it anywhere; FPSCR 0: to nearest even, subnormals kept, NaNs as they are
__attribute__((naked, noreturn)) void board_reset(void) {
  __asm volatile(
      "ldr r0, =0xE000ED88\n"
      "ldr r1, [r0]\n"
      "orr r1, r1, #0xF00000\n"
      "str r1, [r0]\n"
      "dsb\n"
      "isb\n"
      "movs r0, #0\n"
      "vmsr fpscr, r0\n"
      "b board_begin\n");
}

// flash => data; 0 => the rest
__attribute__((noreturn, used)) void board_begin(void) {
  memcpy(board_data_begin, board_data_stored, (size_t)((uint8_t*)board_data_end - (uint8_t*)board_data_begin));
  memset(board_zero_begin, 0, (size_t)((uint8_t*)board_zero_end - (uint8_t*)board_zero_begin));
  board_reset_cause = board_state == DEAD ? board_reset_cause : SV_RESET_POWER;
  board_state = 0U;
  SCB_VTOR = (uint32_t)&vectors;
  (void)main();
  board_die(SV_RESET_FAULT);
}

// however deep the stack was, or wherever it was, it begins anew; cause => board_last_words
__attribute__((naked, noreturn)) void board_die(__attribute__((unused)) int32_t cause) {
  __asm volatile(
      "cpsid i\n"
      "ldr r1, =board_stack_top\n"
      "mov sp, r1\n"
      "b board_last_words\n");
}

__attribute__((naked, noreturn)) void board_fault(void) {
  __asm volatile(
      "movs r0, #2\n"  // SV_RESET_FAULT
      "b board_die\n");
}

void board_on_tick(void) {
  if (board_fed_ms > 0) {
    board_fed_ms--;
    if (board_fed_ms == 0) {
      board_die(SV_RESET_WATCHDOG);
    }
  }
}

__attribute__((noreturn, used)) void board_last_words(int32_t cause) {
  if (board_state != DEAD) {
    board_state = DEAD;
    board_reset_cause = cause;
    for (int32_t i = 0; i < ROUNDS; i++) {
      sv_robot_panic();
    }
  }
  __asm volatile("dsb" ::: "memory");
  SCB_AIRCR = 0x05FA0004U;
  for (;;) {
  }
}

int32_t sv_hal_reset_cause(void) { return board_reset_cause; }

// what compilers call where there is no libc; plain loops, which must not be turned into calls of themselves
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("no-tree-loop-distribute-patterns")
#endif

void* memcpy(void* restrict to, const void* restrict from, size_t n) {
  uint8_t* t = to;
  const uint8_t* f = from;
  for (size_t i = 0; i < n; i++) {
    t[i] = f[i];
  }
  return to;
}

void* memmove(void* to, const void* from, size_t n) {
  uint8_t* t = to;
  const uint8_t* f = from;
  for (size_t i = 0; i < n; i++) {
    const size_t j = t < f ? i : n - 1U - i;
    t[j] = f[j];
  }
  return to;
}

void* memset(void* to, int value, size_t n) {
  uint8_t* t = to;
  for (size_t i = 0; i < n; i++) {
    t[i] = (uint8_t)value;
  }
  return to;
}

int memcmp(const void* a, const void* b, size_t n) {
  const uint8_t* x = a;
  const uint8_t* y = b;
  for (size_t i = 0; i < n; i++) {
    if (x[i] != y[i]) {
      return x[i] < y[i] ? -1 : 1;
    }
  }
  return 0;
}
