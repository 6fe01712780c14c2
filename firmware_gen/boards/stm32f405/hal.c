// STM32F405 at 168 MHz: Olimex STM32-H405, Adafruit Feather STM32F405, WeAct F405 and their like.
//
//   bus      USART1  PB6 one wire, open drain; or (BUS_WIRES 2) PB6 TX, PB7 RX and PB8 direction of a buffer
//   sensors  USART3  PB11 RX
//   console  USART6  PC6 TX, PC7 RX
//   stop     PB9     contact to ground that opens in an emergency: a broken wire stops too
//   start    PC3     contact to ground that closes
//
// PB6 bears a pull-up to 5 V; the other inputs have pull-ups of their own and take 3.3 V. The same image runs under
// QEMU's netduinoplus2, which has neither RCC nor PWR, GPIO or IWDG: their registers read 0. Every wait for the
// hardware is bounded, and what is missing is gone without.
//
// The crystal's failure is an NMI, a supply below 2.9 V an interrupt: both take the torque and reset.
//
// Source: ST RM0090 (PWR, RCC, GPIO, EXTI, TIM2, IWDG, USART), ST DS8626 (pins and their alternate functions); ST's
// CMSIS header stm32f405xx.h (addresses, bits, interrupts); QEMU 7.2 hw/arm/netduinoplus2.c,
// hw/char/stm32f2xx_usart.c, hw/timer/stm32f2xx_timer.c.

#include <stdint.h>

#include "board.h"
#include "ring.h"
#include "sv_hal.h"
#include "sv_rig.h"

#ifndef BUS_WIRES
#define BUS_WIRES 1  // 1: one half-duplex wire; 2: TX and RX through a buffer that the direction pin turns
#endif
#ifndef HSE_MHZ
#define HSE_MHZ 8  // crystal: H405 8, Feather 12, WeAct 8
#endif
#define HSI_MHZ 16  // the chip's own oscillator
#define CORE_KHZ 168000U
#define APB1_HZ 42000000U  // its timers count twice as fast
#define APB2_HZ 84000000U
#define SENSOR_BAUD 115200U
#define CONSOLE_BAUD 1000000U

#define REG(address) (*(volatile uint32_t*)(address))
#define FLASH_ACR REG(0x40023C00U)
#define PWR_CR REG(0x40007000U)
#define EXTI_IMR REG(0x40013C00U)
#define EXTI_RTSR REG(0x40013C08U)
#define IWDG_KR REG(0x40003000U)
#define IWDG_PR REG(0x40003004U)
#define IWDG_RLR REG(0x40003008U)
#define TIM2_CR1 REG(0x40000000U)
#define TIM2_EGR REG(0x40000014U)
#define TIM2_CNT REG(0x40000024U)
#define TIM2_PSC REG(0x40000028U)
#define TIM2_ARR REG(0x4000002CU)
#define NVIC_ISER(n) REG(0xE000E100U + 4U * (n))

typedef struct {
  volatile uint32_t cr, pllcfgr, cfgr, cir, rstr[8], ahb1enr, ahb2enr, ahb3enr, unused1, apb1enr, apb2enr, unused2[2];
  volatile uint32_t lpenr[8], bdcr, csr;
} rcc;

typedef struct {
  volatile uint32_t sr, dr, brr, cr1, cr2, cr3;
} usart;

typedef struct {
  volatile uint32_t moder, otyper, ospeedr, pupdr, idr, odr, bsrr, lckr, afr[2];
} gpio;

#define RCC ((rcc*)0x40023800U)
#define USART1 ((usart*)0x40011000U)
#define USART3 ((usart*)0x40004800U)
#define USART6 ((usart*)0x40011400U)
#define GPIOB ((gpio*)0x40020400U)
#define GPIOC ((gpio*)0x40020800U)

#define CR_HSEON (1U << 16)
#define CR_HSERDY (1U << 17)
#define CR_CSSON (1U << 19)
#define CR_PLLON (1U << 24)
#define CR_PLLRDY (1U << 25)
#define PLLCFGR_HSE (1U << 22)
#define CFGR_PLL (2U << 0)
#define CFGR_PLL_USED (2U << 2)
#define CSR_RMVF (1U << 24)
#define CSR_IWDGRSTF (1U << 29)
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

#define PVD_IRQ 1
#define PVD_LINE (1U << 16)
#define USART1_IRQ 37
#define USART3_IRQ 39
#define USART6_IRQ 71

// rounds of a loop that asks the hardware, some ten cycles each, after which it is taken to be missing: two bytes at
// 9600 bit/s and 168 MHz
#define PATIENCE 65536

extern const sv_rig servolve_rig;

void board_on_supply(void);
void board_on_bus(void);
void board_on_sensors(void);
void board_on_console(void);

BOARD_EXTERNAL external[USART6_IRQ + 1] = {[0] = board_fault,
                                           [PVD_IRQ] = board_on_supply,
                                           [PVD_IRQ + 1 ... USART1_IRQ - 1] = board_fault,
                                           [USART1_IRQ] = board_on_bus,
                                           [USART1_IRQ + 1] = board_fault,
                                           [USART3_IRQ] = board_on_sensors,
                                           [USART3_IRQ + 1 ... USART6_IRQ - 1] = board_fault,
                                           [USART6_IRQ] = board_on_console};

typedef struct {
  volatile uint32_t* reg;
  uint32_t bits;
} setting;

// in this order; what stands beside is as a reset leaves it
static const setting kSettings[] = {
    // clocks of GPIOB and GPIOC, of TIM2, USART3 and PWR, of USART1 and USART6
    {&RCC->ahb1enr, 1U << 1 | 1U << 2},
    {&RCC->apb1enr, 1U << 0 | 1U << 18 | 1U << 28},
    {&RCC->apb2enr, 1U << 4 | 1U << 5},
    // the supply's detector, at its highest level: 2.9 V
    {&PWR_CR, 7U << 5 | 1U << 4},
    // AF 7 on PB6, PB7, PB11; AF 8 on PC6, PC7
    {&GPIOB->afr[0], 7U << 24 | 7U << 28},
    {&GPIOB->afr[1], 7U << 12},
    {&GPIOC->afr[0], 8U << 24 | 8U << 28},
    // pull-ups so that nothing that is open babbles, but for the wire to 5 V
    {&GPIOB->otyper, BUS_WIRES == 1 ? 1U << 6 : 0U},
    {&GPIOB->ospeedr, 2U << 12 | 2U << 16},
    {&GPIOB->pupdr, 1U << 14 | 1U << 18 | 1U << 22},
    {&GPIOC->pupdr, 1U << 14 | 1U << 6},
    {&GPIOB->moder, 2U << 12 | 2U << 14 | 1U << 16 | 2U << 22},
    {&GPIOC->moder, 2U << 12 | 2U << 14},
    {&USART1->cr3, BUS_WIRES == 1 ? CR3_HDSEL : 0U},
    {&USART3->brr, (APB1_HZ + SENSOR_BAUD / 2U) / SENSOR_BAUD},
    {&USART3->cr1, CR1_RUN},
    {&USART6->brr, (APB2_HZ + CONSOLE_BAUD / 2U) / CONSOLE_BAUD},
    {&USART6->cr1, CR1_RUN},
};

static const uint8_t kNoCrystal[] = "no crystal: clock within 4 %\r\n";

static uint8_t is_silicon;  // or an emulator without an RCC, and without pins

static int32_t wait_for(volatile uint32_t* reg, uint32_t bit) {
  for (int32_t round = 0; round < PATIENCE; round++) {
    if ((*reg & bit) != 0U) {
      return 1;
    }
  }
  return 0;
}

// the crystal, or else the chip's own oscillator => PLL => 168 MHz, APB2 84 MHz, APB1 42 MHz; return whether there is a
// crystal
static int32_t start_clock(void) {
  RCC->cr |= CR_HSEON;
  const int32_t crystal = wait_for(&RCC->cr, CR_HSERDY);
  // VCO 336 MHz from an input of 1 MHz, halved; bit 29 is reserved, and set by a reset; voltage scale 1 is the reset's
  RCC->pllcfgr = 1U << 29 | 7U << 24 | 336U << 6 | (crystal ? PLLCFGR_HSE | HSE_MHZ : HSI_MHZ);
  RCC->cr |= crystal ? CR_PLLON | CR_CSSON : CR_PLLON;
  // 5 wait states, prefetch, both caches: in force long before the PLL is
  FLASH_ACR = 0x705U;
  RCC->cfgr = 5U << 10 | 4U << 13;
  (void)wait_for(&RCC->cr, CR_PLLRDY);
  RCC->cfgr |= CFGR_PLL;
  (void)wait_for(&RCC->cfgr, CFGR_PLL_USED);
  return crystal;
}

void sv_hal_init(void) {
  // what this code has noticed is known already; the flags know of the watchdog that needs no code
  if (board_reset_cause == SV_RESET_POWER && (RCC->csr & CSR_IWDGRSTF) != 0U) {
    board_reset_cause = SV_RESET_WATCHDOG;
  }
  RCC->csr |= CSR_RMVF;
  // on silicon at least HSION is set
  is_silicon = RCC->cr != 0U;
  for (int32_t i = 0; i < (int32_t)(sizeof kSettings / sizeof *kSettings); i++) {
    *kSettings[i].reg |= kSettings[i].bits;
  }
  USART1->brr = (APB2_HZ + (uint32_t)SV_BAUD(&servolve_rig) / 2U) / (uint32_t)SV_BAUD(&servolve_rig);
  USART1->cr1 = CR1_RUN;
  const int32_t crystal = !is_silicon || start_clock();
  // microseconds, for ever; QEMU's timers count at 1 GHz
  TIM2_PSC = is_silicon ? 2U * APB1_HZ / 1000000U - 1U : 999U;
  TIM2_ARR = 0xFFFFFFFFU;
  TIM2_EGR = 1U;
  TIM2_CR1 = 1U;
  // the detector is awake by now: only a supply that falls from here on is an edge
  EXTI_RTSR = PVD_LINE;
  EXTI_IMR = PVD_LINE;
  NVIC_ISER(0) = 1U << PVD_IRQ;
  NVIC_ISER(1) = 1U << (USART1_IRQ - 32) | 1U << (USART3_IRQ - 32);
  NVIC_ISER(2) = 1U << (USART6_IRQ - 64);
  board_start_ticks(CORE_KHZ);
  if (!crystal) {
    (void)sv_hal_write(SV_LINE_CONSOLE, kNoCrystal, (int32_t)sizeof kNoCrystal - 1);
  }
}

uint32_t sv_hal_now_us(void) { return TIM2_CNT; }

// contacts to ground with pull-ups
uint32_t sv_hal_inputs(void) {
  if (!is_silicon) {
    return 0U;
  }
  const uint32_t stop = (GPIOB->idr >> PIN_STOP & 1U) != 0U ? SV_INPUT_STOP : 0U;
  const uint32_t start = (GPIOC->idr >> PIN_START & 1U) == 0U ? SV_INPUT_START : 0U;
  return stop | start;
}

// the buffer, where there is one: to the servos while sending
static void turn(int32_t sending) {
  if (BUS_WIRES == 2) {
    GPIOB->bsrr = sending ? 1U << PIN_DIRECTION : 1U << (PIN_DIRECTION + 16);
  }
}

// deaf meanwhile, since one wire hears what it says
__attribute__((noinline)) int32_t board_send_bus(const uint8_t* data, int32_t size) {
  int32_t n = 0;
  USART1->cr1 = CR1_UE | CR1_TE;
  turn(1);
  while (n < size && wait_for(&USART1->sr, SR_TXE)) {
    USART1->dr = data[n++];
  }
  (void)wait_for(&USART1->sr, SR_TC);
  turn(0);
  USART1->cr1 = CR1_RUN;
  return n;
}

void board_send_answers(void) {
  while (ring_count(&board_answers) != 0U && (USART6->sr & SR_TXE) != 0U) {
    USART6->dr = ring_take(&board_answers);
  }
  USART6->cr1 = ring_count(&board_answers) != 0U ? CR1_RUN | CR1_TXEIE : CR1_RUN;
}

// reading SR, then DR, clears what is wrong with a byte as well; a byte that another has overrun is wrong anyway
static void receive(usart* line, ring* r) {
  if ((line->sr & (SR_RXNE | SR_ORE)) != 0U) {
    ring_put(r, (uint8_t)line->dr);
  }
}

void board_on_bus(void) { receive(USART1, &board_received[SV_LINE_BUS]); }

void board_on_sensors(void) { receive(USART3, &board_received[SV_LINE_SENSORS]); }

void board_on_console(void) {
  receive(USART6, &board_received[SV_LINE_CONSOLE]);
  board_send_answers();
}

void board_on_supply(void) { board_die(SV_RESET_SUPPLY); }

// the clock is the chip's own by now, and the bus's bit rate wrong: what reaches the servos is sent at the next boot
void board_on_nmi(void) { board_die(SV_RESET_CLOCK); }

// LSI 17..47 kHz, divided by 16: 0.17 to 0.47 s, after the tick's own 0.1 s; once started it never stops. What PR and
// RLR are set to is taken over without being waited for
void sv_hal_feed_watchdog(void) {
  if (board_fed_ms == 0) {
    IWDG_KR = 0xCCCCU;
    IWDG_KR = 0x5555U;
    IWDG_PR = 2U;
    IWDG_RLR = 500U;
  }
  board_fed_ms = BOARD_FED_MS;
  IWDG_KR = 0xAAAAU;
}
