// Evaluate one generated function on a table of inputs, and print its outputs' bits and the instructions that it took.

#include <stdint.h>

#include "table.h"

void evaluate(const float* in, float* out);

#if defined(__arm__)
#define SYST_CSR (*(volatile uint32_t*)0xE000E010U)
#define SYST_RVR (*(volatile uint32_t*)0xE000E014U)
#define SYST_CVR (*(volatile uint32_t*)0xE000E018U)

static void semihost(uint32_t operation, const void* argument) {
  register uint32_t r0 __asm__("r0") = operation;
  register const void* r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void print(const char* text) { semihost(4U, text); }
static uint32_t now(void) { return 0x00ffffffU - SYST_CVR; }
static void begin(void) {
  SYST_RVR = 0x00ffffffU;
  SYST_CSR = 5U;
}
static void end(void) { semihost(0x18U, (const void*)0x20026U); }
#else
#include <stdio.h>
static void print(const char* text) { fputs(text, stdout); }
static uint32_t now(void) { return 0U; }
static void begin(void) {}
static void end(void) {}
#endif

static void print_word(uint32_t value) {
  char text[10];
  for (int32_t i = 0; i < 8; i++) {
    text[i] = "0123456789abcdef"[(value >> (28 - 4 * i)) & 15U];
  }
  text[8] = '\n';
  text[9] = 0;
  print(text);
}

int main(void) {
  union {
    uint32_t u[NIN];
    float f[NIN];
  } in;
  union {
    uint32_t u[NOUT];
    float f[NOUT];
  } out;
  begin();
  for (int32_t k = 0; k < NSTEP; k++) {
    uint32_t start;
    uint32_t ticks;
    for (int32_t i = 0; i < NIN; i++) {
      in.u[i] = table[k][i];
    }
    start = now();
    evaluate(in.f, out.f);
    ticks = (now() - start) & 0x00ffffffU;
    for (int32_t i = 0; i < NOUT; i++) {
      print_word(out.u[i]);
    }
    print_word(ticks);
  }
  end();
  return 0;
}
