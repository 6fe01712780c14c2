// Count the instructions of a controller's functions on random and hard inputs, by the emulator's clock.
//
// Under `-icount shift=N` an instruction takes 2^N ns of the emulated time that SysTick counts, so the difference of
// two readings is a number of instructions. The functions are called through pointers with the same code around them
// as an empty function, whose count is taken off.

#include <stdint.h>

#include "counted.h"

#define PAINTED 256U
#define SYST_CSR (*(volatile uint32_t*)0xE000E010U)
#define SYST_RVR (*(volatile uint32_t*)0xE000E014U)
#define SYST_CVR (*(volatile uint32_t*)0xE000E018U)

// the ABI passes pointers alike whatever they point to, and what a function does not take it does not look at
typedef void (*counted)(void* a, void* b, void* c);

static COUNTED_state state;
static float inputs[COUNTED_NINPUT + 1];
static float outputs[COUNTED_noutput];
static float command[COUNTED_noutput];
static uint32_t seed = 1U;

// ticks of init, step, clamp and command, then bytes of stack
static uint32_t most[8];

// one instruction: the return
static void empty(void* a, void* b, void* c) {
  (void)a;
  (void)b;
  (void)c;
}

static void semihost(uint32_t operation, const void* argument) {
  register uint32_t r0 __asm__("r0") = operation;
  register const void* r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void print(const char* text) { semihost(4U, text); }

static void print_number(uint32_t value) {
  char digits[12];
  char* at = digits + 11;
  *at = 0;
  do {
    *--at = (char)('0' + (char)(value % 10U));
    value /= 10U;
  } while (value != 0U);
  print(at);
  print(" ");
}

static uint32_t random_word(void) {
  seed ^= seed << 13;
  seed ^= seed >> 17;
  seed ^= seed << 5;
  return seed;
}

static float as_float(uint32_t bits) {
  union {
    uint32_t u;
    float f;
  } word;
  word.u = bits;
  return word.f;
}

// uniform within a range, a hard bit pattern, or any bit pattern
static float draw(float low, float high) {
  static const uint32_t hard[] = {COUNTED_HARD};
  const uint32_t word = random_word();
  switch (random_word() % 8U) {
    case 0:
      return as_float(hard[word % (sizeof hard / sizeof hard[0])]);
    case 1:
      return as_float(word);
    case 2:
      return as_float(word & 0x807fffffU);
    case 3:
      return (float)(int32_t)(word >> 8) * (32768.0F / 16777216.0F) - 16384.0F;
    default:
      return low + (high - low) * ((float)(int32_t)(word >> 8) / 16777216.0F);
  }
}

__attribute__((noinline)) static uint32_t ticks(counted volatile* function, void* a, void* b, void* c) {
  const counted called = *function;
  const uint32_t before = SYST_CVR;
  called(a, b, c);
  return (before - SYST_CVR) & 0x00ffffffU;
}

// bytes of stack that a call leaves other than they were painted
__attribute__((noinline)) static uint32_t depth(counted volatile* function, void* a, void* b, void* c) {
  volatile uint32_t* top;
  uint32_t words = PAINTED;
  __asm__ volatile("mov %0, sp" : "=r"(top));
  for (uint32_t i = 1; i <= PAINTED; i++) {
    top[-(int32_t)i] = 0xa5a5a5a5U;
  }
  (*function)(a, b, c);
  while (words > 0U && top[-(int32_t)words] == 0xa5a5a5a5U) {
    words--;
  }
  return 4U * words;
}

static uint32_t nothing;
static uint32_t nothing_deep;

static uint32_t larger(uint32_t a, uint32_t b) { return a > b ? a : b; }

// ticks and stack beyond those of a function that only returns
static void count(int32_t place, counted volatile function, void* a, void* b, void* c) {
  most[place] = larger(most[place], ticks(&function, a, b, c) - nothing);
  most[place + 4] = larger(most[place + 4], depth(&function, a, b, c) - nothing_deep);
}

int main(void) {
  static const float ranges[][2] = {COUNTED_RANGES{0.0F, 0.0F}};
  SYST_RVR = 0x00ffffffU;
  SYST_CVR = 0U;
  SYST_CSR = 5U;
  {
    counted volatile function = empty;
    nothing = ticks(&function, 0, 0, 0);
    nothing_deep = depth(&function, 0, 0, 0);
  }
  for (uint32_t k = 0; k < COUNTED_TRIALS; k++) {
    // most steps go on from the state that they reached, some from any other one
    if (k % 64U == 0U) {
      count(0, (counted)COUNTED_init, &state, 0, 0);
    }
    if (k % 4U == 3U) {
      for (uint32_t i = 0; i < sizeof state / sizeof(float); i++) {
        ((float*)&state)[i] = draw(-1.0F, 1.0F);
      }
    }
    for (uint32_t i = 0; i < COUNTED_NINPUT; i++) {
      inputs[i] = draw(ranges[i][0], ranges[i][1]);
    }
    count(1, (counted)COUNTED_step, &state, inputs, outputs);
    count(3, (counted)COUNTED_command, &state, outputs, command);
    for (uint32_t i = 0; i < COUNTED_noutput; i++) {
      outputs[i] = draw(-100.0F, 100.0F);
    }
    count(3, (counted)COUNTED_command, &state, outputs, command);
    count(2, (counted)COUNTED_clamp, outputs, 0, 0);
  }
  for (uint32_t i = 0; i < 8U; i++) {
    print_number(most[i]);
  }
  {
    counted volatile function = (counted)COUNTED_selftest;
    print_number(depth(&function, 0, 0, 0) - nothing_deep);
  }
  semihost(0x18U, (const void*)0x20026U);
  return 0;
}
