// A main program that tries a board: a line in from the bus is a command, or is sent back.
//
//   H  hang, heard by interrupts        I  hang, interrupts off
//   J  jump to where no code may be     R  use up the stack
//   Z  be busy for 100 ms, fed, but deaf
//   N  pend the NMI                     P  pend interrupt 1: the STM32F405's supply falls
//   U  pend interrupt 3, which nobody serves

#include <stdint.h>

#include "sv_hal.h"
#include "sv_rig.h"
#include "sv_time.h"

#define LINE_MAX 64
#define REG(address) (*(volatile uint32_t*)(address))
#define SCB_ICSR REG(0xE000ED04U)
#define NVIC_ISER REG(0xE000E100U)
#define NVIC_ISPR REG(0xE000E200U)

const sv_rig servolve_rig = {.baud = 1000000, .njoint = 1};

int main(void);
void sv_robot_panic(void);
int32_t deeper(int32_t n);

void sv_robot_panic(void) {
  static const uint8_t off[] = {'o', 'f', 'f', '!'};
  (void)sv_hal_write(SV_LINE_BUS, off, 4);
}

__attribute__((noinline)) int32_t deeper(int32_t n) {
  volatile int32_t here[64];
  here[n & 63] = n;
  return (n < 1000000 ? deeper(n + 1) : 0) + here[n & 63];
}

static void hang(void) {
  for (;;) {
  }
}

static void obey(uint8_t command) {
  if (command == 'H') {
    hang();
  } else if (command == 'I') {
    __asm volatile("cpsid i");
    hang();
  } else if (command == 'J') {
    ((void (*)(void))0xA0000001U)();
  } else if (command == 'R') {
    (void)deeper(0);
  } else if (command == 'N') {
    SCB_ICSR = 1U << 31;
  } else if (command == 'P') {
    NVIC_ISPR = 1U << 1;
  } else if (command == 'U') {
    NVIC_ISER = 1U << 3;
    NVIC_ISPR = 1U << 3;
  } else if (command == 'Z') {
    const uint32_t until_us = sv_hal_now_us() + 100000U;
    while (!sv_has_come(sv_hal_now_us(), until_us)) {
      sv_hal_feed_watchdog();
    }
  }
}

int main(void) {
  sv_hal_init();
  const uint8_t hello[] = {'h', (uint8_t)('0' + sv_hal_reset_cause())};
  (void)sv_hal_write(SV_LINE_CONSOLE, hello, 2);
  uint8_t line[LINE_MAX];
  int32_t n = 0;
  for (;;) {
    uint8_t byte;
    sv_hal_feed_watchdog();
    while (sv_hal_read(SV_LINE_BUS, &byte, 1) == 1) {
      n = n < LINE_MAX ? n : 0;
      line[n++] = byte;
      if (byte != '\n') {
        continue;
      }
      if (n == 2) {
        obey(line[0]);
      } else {
        (void)sv_hal_write(SV_LINE_BUS, line, n);
      }
      n = 0;
    }
    while (sv_hal_read(SV_LINE_CONSOLE, &byte, 1) == 1) {
      (void)sv_hal_write(SV_LINE_CONSOLE, &byte, 1);
    }
    sv_hal_wait(sv_hal_now_us() + 20000U);
  }
}
