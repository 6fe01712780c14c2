// STM32F405 at 168 MHz: Olimex STM32-H405, Adafruit Feather STM32F405, WeAct F405 and their like.
//
//   bus      USART1  PB6 one wire, open drain; or (BUS_WIRES 2) PB6 TX, PB7 RX and PB8 direction of a buffer
//   sensors  USART3  PB11 RX
//   console  USART6  PC6 TX, PC7 RX
//   stop     PB9     contact to ground that opens in an emergency: a broken wire stops too
//   start    PC3     contact to ground that closes
//
// PB6 bears a pull-up to 5 V; the other inputs have pull-ups of their own and take 3.3 V. The same image runs under
// QEMU's netduinoplus2, which has neither RCC nor GPIO nor IWDG: their registers read 0. Every wait for the hardware is
// bounded, and what is missing is gone without.
//
// Source: ST RM0090 (RCC 7.3, GPIO 8.4, TIM2 18.4, IWDG 21.4, USART 30.3.10, 30.6), ST DS8626 tables 7 and 9; QEMU 7.2
// hw/arm/netduinoplus2.c, hw/char/stm32f2xx_usart.c, hw/timer/stm32f2xx_timer.c.

#include <stdint.h>

#include "board.h"
#include "ring.h"
#include "sv_hal.h"
#include "sv_rig.h"
#include "sv_time.h"

#ifndef BUS_WIRES
#define BUS_WIRES 1  // 1: one half-duplex wire; 2: TX and RX through a buffer that the direction pin turns
#endif
#ifndef HSE_MHZ
#define HSE_MHZ 8  // crystal: H405 8, Feather 12, WeAct 8
#endif
#define SENSOR_BAUD 115200
#define CONSOLE_BAUD 1000000

#define REG(address) (*(volatile uint32_t*)(address))
#define RCC_CR REG(0x40023800U)
#define RCC_PLLCFGR REG(0x40023804U)
#define RCC_CFGR REG(0x40023808U)
#define RCC_AHB1ENR REG(0x40023830U)
#define RCC_APB1ENR REG(0x40023840U)
#define RCC_APB2ENR REG(0x40023844U)
#define RCC_CSR REG(0x40023874U)
#define FLASH_ACR REG(0x40023C00U)
#define IWDG_KR REG(0x40003000U)
#define IWDG_PR REG(0x40003004U)
#define IWDG_RLR REG(0x40003008U)
#define TIM2_CR1 REG(0x40000000U)
#define TIM2_EGR REG(0x40000014U)
#define TIM2_CNT REG(0x40000024U)
#define TIM2_PSC REG(0x40000028U)
#define TIM2_ARR REG(0x4000002CU)

typedef struct {
  volatile uint32_t sr, dr, brr, cr1, cr2, cr3;
} usart;

typedef struct {
  volatile uint32_t moder, otyper, ospeedr, pupdr, idr, odr, bsrr, lckr, afr[2];
} gpio;

#define USART1 ((usart*)0x40011000U)
#define USART3 ((usart*)0x40004800U)
#define USART6 ((usart*)0x40011400U)
#define GPIOB ((gpio*)0x40020400U)
#define GPIOC ((gpio*)0x40020800U)

#define SR_ORE (1U << 3)
#define SR_RXNE (1U << 5)
#define SR_TC (1U << 6)
#define SR_TXE (1U << 7)
#define CR1_RE (1U << 2)
#define CR1_TE (1U << 3)
#define CR1_RXNEIE (1U << 5)
#define CR1_TXEIE (1U << 7)
#define CR1_UE (1U << 13)
#define CR1_RUN (CR1_UE | CR1_RXNEIE | CR1_TE | CR1_RE)
#define CR3_HDSEL (1U << 3)

#define PIN_DIRECTION 8
#define PIN_STOP 9
#define PIN_START 3

// rounds of a loop that asks the hardware, some ten cycles each, after which it is taken to be missing
#define PATIENCE_START 40000

extern const sv_rig servolve_rig;

static uint8_t bus_bytes[256], sensor_bytes[256], console_bytes[64], answer_bytes[512];

// what has come on each line, by sv_line; a debugger may append to them
ring board_received[3] = {{bus_bytes, sizeof bus_bytes - 1U, 0U, 0U, 0U},
                          {sensor_bytes, sizeof sensor_bytes - 1U, 0U, 0U, 0U},
                          {console_bytes, sizeof console_bytes - 1U, 0U, 0U, 0U}};
static ring answers = {answer_bytes, sizeof answer_bytes - 1U, 0U, 0U, 0U};

static int32_t clock_mhz;  // of the core
static int32_t reset_cause;
static uint8_t watched;

// prototypes of what a debugger stops at
int32_t board_send_bus(const uint8_t* data, int32_t size);

static int32_t wait_for(volatile uint32_t* reg, uint32_t mask, uint32_t value, int32_t patience) {
  while ((*reg & mask) != value) {
    if (--patience < 0) {
      return 0;
    }
  }
  return 1;
}

// HSE => PLL => 168 MHz, APB2 84 MHz, APB1 42 MHz; without a crystal the 16 MHz of reset stay: => core clock [MHz]
static int32_t start_clock(void) {
  // an emulator without an RCC: on silicon at least HSION is set
  if (RCC_CR == 0U) {
    return 0;
  }
  RCC_CR |= 1U << 16;
  if (!wait_for(&RCC_CR, 1U << 17, 1U << 17, PATIENCE_START)) {
    RCC_CR &= ~(1U << 16);
    return 16;
  }
  // voltage scale 1 is the reset's; VCO 336 MHz from an input of 1 MHz, halved
  RCC_PLLCFGR = (uint32_t)HSE_MHZ | 336U << 6 | 0U << 16 | 1U << 22 | 7U << 24;
  RCC_CR |= 1U << 24;
  if (!wait_for(&RCC_CR, 1U << 25, 1U << 25, PATIENCE_START)) {
    RCC_CR &= ~(1U << 24);
    return 16;
  }
  // 5 wait states, prefetch, both caches
  FLASH_ACR = 0x705U;
  if (!wait_for(&FLASH_ACR, 7U, 5U, PATIENCE_START)) {
    return 16;
  }
  RCC_CFGR = 5U << 10 | 4U << 13;
  RCC_CFGR |= 2U;
  if (!wait_for(&RCC_CFGR, 3U << 2, 2U << 2, PATIENCE_START)) {
    RCC_CFGR = 0U;
    return 16;
  }
  return 168;
}

// TIM2 counts microseconds: APB1's timers run at half the core's clock behind its prescaler; QEMU's at 1 GHz
static void start_timer(void) {
  const uint32_t mhz = clock_mhz == 168 ? 84U : 16U;
  TIM2_PSC = RCC_CR == 0U ? 999U : mhz - 1U;
  TIM2_ARR = 0xFFFFFFFFU;
  TIM2_EGR = 1U;
  TIM2_CR1 = 1U;
}

static void start_line(usart* line, int32_t bus_mhz, int32_t baud, uint32_t cr3) {
  line->brr = (uint32_t)((bus_mhz * 1000000 + baud / 2) / baud);
  line->cr3 = cr3;
  line->cr1 = CR1_RUN;
}

// AF 7 on PB6, PB7, PB11; AF 8 on PC6, PC7; pull-ups so that nothing that is open babbles, but for the wire to 5 V
static void start_pins(void) {
  GPIOB->afr[0] |= 7U << 24 | 7U << 28;
  GPIOB->afr[1] |= 7U << 12;
  GPIOC->afr[0] |= 8U << 24 | 8U << 28;
  GPIOB->otyper |= BUS_WIRES == 1 ? 1U << 6 : 0U;
  GPIOB->ospeedr |= 2U << 12 | 2U << 16;
  GPIOB->pupdr |= 1U << 14 | 1U << 18 | 1U << 22;
  GPIOC->pupdr |= 1U << 14 | 1U << 6;
  GPIOB->bsrr = 1U << (PIN_DIRECTION + 16);
  GPIOB->moder |= 2U << 12 | 2U << 14 | 1U << 16 | 2U << 22;
  GPIOC->moder |= 2U << 12 | 2U << 14;
}

void sv_hal_init(void) {
  // why: the board's own memory knows of faults, the flags of the watchdog that needs no code
  reset_cause = board_died_of();
  if (reset_cause == SV_RESET_POWER && (RCC_CSR & 1U << 29) != 0U) {
    reset_cause = SV_RESET_WATCHDOG;
  }
  RCC_CSR |= 1U << 24;
  clock_mhz = start_clock();
  RCC_AHB1ENR |= 1U << 1 | 1U << 2;
  RCC_APB1ENR |= 1U << 0 | 1U << 18;
  RCC_APB2ENR |= 1U << 4 | 1U << 5;
  start_timer();
  start_pins();
  // an emulator's lines take no time
  const int32_t fast_mhz = clock_mhz == 168 ? 84 : 16;
  const int32_t slow_mhz = clock_mhz == 168 ? 42 : 16;
  start_line(USART1, fast_mhz, servolve_rig.baud, BUS_WIRES == 1 ? CR3_HDSEL : 0U);
  start_line(USART3, slow_mhz, SENSOR_BAUD, 0U);
  start_line(USART6, fast_mhz, CONSOLE_BAUD, 0U);
  board_enable_interrupt(37);
  board_enable_interrupt(39);
  board_enable_interrupt(71);
  board_start_ticks((clock_mhz == 0 ? 168U : (uint32_t)clock_mhz) * 1000000U);
}

uint32_t sv_hal_now_us(void) { return TIM2_CNT; }

// contacts to ground with pull-ups; where PUPDR does not keep what was written there are no pins
uint32_t sv_hal_inputs(void) {
  if (GPIOB->pupdr == 0U) {
    return 0U;
  }
  const uint32_t stop = (GPIOB->idr >> PIN_STOP & 1U) != 0U ? SV_INPUT_STOP : 0U;
  const uint32_t start = (GPIOC->idr >> PIN_START & 1U) == 0U ? SV_INPUT_START : 0U;
  return stop | start;
}

static int32_t is_idle(uint32_t inputs, uint32_t until_us) {
  return ring_count(&board_received[0]) == 0U && ring_count(&board_received[1]) == 0U &&
         ring_count(&board_received[2]) == 0U && sv_hal_inputs() == inputs && !sv_has_come(sv_hal_now_us(), until_us);
}

// asleep for all but the last two ticks, which are too coarse to end on
__attribute__((noinline)) void sv_hal_wait(uint32_t until_us) {
  const uint32_t inputs = sv_hal_inputs();
  while (is_idle(inputs, until_us)) {
    __asm volatile("cpsid i" ::: "memory");
    if (is_idle(inputs, until_us - 2000U)) {
      __asm volatile("wfi" ::: "memory");
    }
    __asm volatile("cpsie i" ::: "memory");
  }
}

int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) {
  ring* r = &board_received[line];
  int32_t n = 0;
  while (n < size && ring_count(r) != 0U) {
    data[n++] = ring_take(r);
  }
  return n;
}

// by polling, so that fault handlers can; deaf meanwhile, since one wire hears what it says
__attribute__((noinline)) int32_t board_send_bus(const uint8_t* data, int32_t size) {
  // some ten cycles a round: more than 30 bits' time
  const int32_t patience = 168000000 / servolve_rig.baud * 4;
  int32_t n = 0;
  USART1->cr1 = CR1_UE | CR1_TE;
  GPIOB->bsrr = 1U << PIN_DIRECTION;
  while (n < size && wait_for(&USART1->sr, SR_TXE, SR_TXE, patience)) {
    USART1->dr = data[n++];
  }
  (void)wait_for(&USART1->sr, SR_TC, SR_TC, patience);
  GPIOB->bsrr = 1U << (PIN_DIRECTION + 16);
  USART1->cr1 = CR1_RUN;
  return n;
}

// as much as the line takes now; its interrupt, where there is one, takes the rest
static void send_answers(void) {
  while (ring_count(&answers) != 0U && (USART6->sr & SR_TXE) != 0U) {
    USART6->dr = ring_take(&answers);
  }
  USART6->cr1 = ring_count(&answers) != 0U ? CR1_RUN | CR1_TXEIE : CR1_RUN;
}

int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  if (line == SV_LINE_BUS) {
    return board_send_bus(data, size);
  }
  if (line != SV_LINE_CONSOLE) {
    return 0;
  }
  // a line has room for one byte: handlers may not wait until a whole record is copied
  int32_t n = 0;
  while (n < size && ring_space(&answers) != 0U) {
    ring_put(&answers, data[n++]);
  }
  uint32_t mask;
  __asm volatile("mrs %0, primask\ncpsid i" : "=r"(mask)::"memory");
  send_answers();
  __asm volatile("msr primask, %0" ::"r"(mask) : "memory");
  return n;
}

// reading SR, then DR, clears what is wrong with a byte as well
static void receive(usart* line, ring* r) {
  const uint32_t status = line->sr;
  if ((status & (SR_RXNE | SR_ORE)) != 0U) {
    const uint8_t byte = (uint8_t)line->dr;
    if ((status & SR_RXNE) != 0U) {
      ring_put(r, byte);
    }
  }
}

void board_interrupt(int32_t number) {
  if (number == 37) {
    receive(USART1, &board_received[SV_LINE_BUS]);
  } else if (number == 39) {
    receive(USART3, &board_received[SV_LINE_SENSORS]);
  } else if (number == 71) {
    receive(USART6, &board_received[SV_LINE_CONSOLE]);
    send_answers();
  } else {
    board_die(SV_RESET_FAULT);
  }
}

// LSI 17..47 kHz, divided by 16: 0.17 to 0.47 s, after the tick's own 0.1 s; once started it never stops
void sv_hal_feed_watchdog(void) {
  board_fed();
  if (!watched) {
    watched = 1U;
    IWDG_KR = 0xCCCCU;
    IWDG_KR = 0x5555U;
    IWDG_PR = 2U;
    IWDG_RLR = 500U;
  }
  IWDG_KR = 0xAAAAU;
}

int32_t sv_hal_reset_cause(void) { return reset_cause; }
