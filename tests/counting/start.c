// Vectors and start-up of a Cortex-M that counts instructions; its stack is at the end of the memory.

#include <stdint.h>

int main(void);
void reset(void);
extern uint32_t stack_top[];
extern uint32_t bss_start[];
extern uint32_t bss_end[];
extern uint32_t data_start[];
extern uint32_t data_end[];
extern const uint32_t data_image[];

static void stop(void) {
  for (;;) {
  }
}

void reset(void) {
  const uint32_t* from = data_image;
  for (uint32_t* to = data_start; to < data_end; to++) {
    *to = *from++;
  }
  for (uint32_t* to = bss_start; to < bss_end; to++) {
    *to = 0U;
  }
#if defined(__ARM_FP)
  *(volatile uint32_t*)0xE000ED88U |= 0x00f00000U;  // CPACR: the FPU
  __asm__ volatile("dsb\n isb");
#endif
  main();
  stop();
}

__attribute__((section(".vectors"), used)) static void* const vectors[16] = {
    (void*)stack_top,
    (void*)reset,
    (void*)stop,
    (void*)stop,
};
