// Start-up code of a Cortex-M4F: vectors, memory, FPU, and what happens when all is lost.
//
// A fault, a hung main loop (no sv_hal_feed_watchdog for BOARD_FED_MS) and a vector that nobody serves all end in
// board_die: torque-off packets to every servo, sent by polling with interrupts off, on a stack of its own, then a
// reset. The board's own watchdog stands behind that: it needs neither this code nor the core's interrupts. The stack
// lies at the bottom of the RAM, so that its overflow is a fault and not another variable's end.
//
// Source: Armv7-M Architecture Reference Manual (DDI 0403E) B1.5, B3.2, B3.3.

#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "sv_hal.h"
#include "sv_rig.h"

#define REG(address) (*(volatile uint32_t*)(address))
#define SYST_CSR REG(0xE000E010U)
#define SYST_RVR REG(0xE000E014U)
#define SYST_CVR REG(0xE000E018U)
#define NVIC_ISER(n) REG(0xE000E100U + 4U * (n))
#define NVIC_IPR(n) (*(volatile uint8_t*)(0xE000E400U + (n)))
#define PRIORITY 0x40U  // of all lines, below the tick: at most one handler and the tick stand upon the main loop
#define SCB_VTOR REG(0xE000ED08U)
#define SCB_AIRCR REG(0xE000ED0CU)

#define EXTERNAL 82  // interrupts beside the core's own, of the larger board
#define ROUNDS 3     // torque off is said so often: a servo that was answering talked over the first
#define MAGIC 0x746F7271U

extern const sv_rig servolve_rig;
extern uint32_t board_stack_top[], board_data_begin[], board_data_end[], board_data_stored[];
extern uint32_t board_zero_begin[], board_zero_end[];

void sv_robot_panic(const sv_rig* rig);  // of sv_robot.h
void board_reset(void);
void board_begin(void);
void board_fault(void);
void board_bitten(void);
void board_last_words(int32_t cause);
void board_external(void);
void board_systick(void);
int main(void);
void* memcpy(void* restrict to, const void* restrict from, size_t n);
void* memmove(void* to, const void* from, size_t n);
void* memset(void* to, int value, size_t n);
int memcmp(const void* a, const void* b, size_t n);

// survives a reset: why the board died, and its complement
static uint32_t board_cause[2] __attribute__((section(".noinit")));

static volatile int32_t fed_ms;  // how long the main loop may still be silent; 0: it has never been heard
static volatile uint8_t dying;

typedef void (*vector)(void);

// the first sixteen are the core's: stack, reset, NMI (a watchdog, where there is one), faults, …, SysTick
__attribute__((section(".vectors"), used)) static const struct {
  const void* stack;
  vector core[15];
  vector external[EXTERNAL];
} vectors = {board_stack_top,
             {board_reset, board_bitten, board_fault, board_fault, board_fault, board_fault, board_fault, board_fault,
              board_fault, board_fault, board_fault, board_fault, board_fault, board_fault, board_systick},
             {[0 ... EXTERNAL - 1] = board_external}};

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
  const uint32_t* from = board_data_stored;
  for (uint32_t* to = board_data_begin; to < board_data_end; to++) {
    *to = *from++;
  }
  for (uint32_t* to = board_zero_begin; to < board_zero_end; to++) {
    *to = 0U;
  }
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

__attribute__((naked, noreturn)) void board_bitten(void) {
  __asm volatile(
      "movs r0, #1\n"  // SV_RESET_WATCHDOG
      "b board_die\n");
}

void board_external(void) {
  uint32_t number;
  __asm volatile("mrs %0, ipsr" : "=r"(number));
  board_interrupt((int32_t)number - 16);
}

void board_systick(void) {
  if (fed_ms > 0) {
    fed_ms--;
    if (fed_ms == 0) {
      board_die(SV_RESET_WATCHDOG);
    }
  }
}

__attribute__((noreturn, used)) void board_last_words(int32_t cause) {
  if (!dying) {
    dying = 1U;
    board_cause[0] = MAGIC ^ (uint32_t)cause;
    board_cause[1] = ~board_cause[0];
    for (int32_t i = 0; i < ROUNDS; i++) {
      sv_robot_panic(&servolve_rig);
    }
  }
  __asm volatile("dsb" ::: "memory");
  SCB_AIRCR = 0x05FA0004U;
  for (;;) {
  }
}

int32_t board_died_of(void) {
  const uint32_t cause = board_cause[0] ^ MAGIC;
  const uint32_t valid = board_cause[1] == ~board_cause[0];
  board_cause[0] = 0U;
  board_cause[1] = 0U;
  return valid && (cause == SV_RESET_WATCHDOG || cause == SV_RESET_FAULT) ? (int32_t)cause : SV_RESET_POWER;
}

void board_start_ticks(uint32_t core_hz) {
  SYST_RVR = core_hz / 1000U - 1U;
  SYST_CVR = 0U;
  SYST_CSR = 7U;
}

void board_fed(void) { fed_ms = BOARD_FED_MS; }

void board_enable_interrupt(int32_t number) {
  const uint32_t n = (uint32_t)number;
  NVIC_IPR(n) = PRIORITY;
  NVIC_ISER(n / 32U) = 1U << (n % 32U);
}

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
