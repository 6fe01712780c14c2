// Start-up of a bare Cortex-M and its line to the host: semihosting, which QEMU answers on every board.

#include "batch.h"

#define SYS_OPEN 0x01
#define SYS_WRITE 0x05
#define SYS_READ 0x06
#define SYS_EXIT_EXTENDED 0x20

#define OPEN_RB 1
#define OPEN_WB 5

#define APPLICATION_EXIT 0x20026U

extern uint32_t batch_stack_top[];
extern uint32_t batch_bss[];
extern uint32_t batch_bss_end[];

static uint32_t batch_in;
static uint32_t batch_out;

static uint32_t batch_call(uint32_t operation, const uint32_t* block) {
  register uint32_t r0 __asm__("r0") = operation;
  register const uint32_t* r1 __asm__("r1") = block;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

static uint32_t batch_open_file(const char* name, uint32_t length, uint32_t mode) {
  const uint32_t block[3] = {(uint32_t)name, mode, length};
  return batch_call(SYS_OPEN, block);
}

void batch_open(void) {
  batch_in = batch_open_file("jobs", 4, OPEN_RB);
  batch_out = batch_open_file("answers", 7, OPEN_WB);
}

void batch_exit(int32_t status) {
  const uint32_t block[2] = {APPLICATION_EXIT, (uint32_t)status};
  batch_call(SYS_EXIT_EXTENDED, block);
  for (;;) {
  }
}

int32_t batch_read(void* words, int32_t n) {
  const uint32_t block[3] = {batch_in, (uint32_t)words, 4U * (uint32_t)n};
  return batch_call(SYS_READ, block) == 0;
}

void batch_write(const void* words, int32_t n) {
  const uint32_t block[3] = {batch_out, (uint32_t)words, 4U * (uint32_t)n};
  if (batch_call(SYS_WRITE, block) != 0) {
    batch_exit(3);
  }
}

static void batch_fault(void) { batch_exit(4); }

static void batch_reset(void) {
  for (uint32_t* word = batch_bss; word < batch_bss_end; word++) {
    *word = 0;
  }
#ifdef __ARM_FP
  // full access to the FPU, before its first instruction
  volatile uint32_t* const cpacr = (volatile uint32_t*)0xE000ED88U;
  *cpacr |= 0xFU << 20;
  __asm__ volatile("dsb\n\tisb");
#endif
  batch_exit(main());
}

typedef void (*batch_vector)(void);

__attribute__((section(".vectors"), used)) static const batch_vector kVectors[16] = {
    (batch_vector)batch_stack_top, batch_reset, batch_fault, batch_fault, batch_fault, batch_fault, batch_fault};
