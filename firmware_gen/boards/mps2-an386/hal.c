// Arm MPS2 with the FPGA image AN386: a Cortex-M4F at 25 MHz; QEMU's machine mps2-an386.
//
//   bus      UART 0, with a half-duplex buffer that does not give back what is sent
//   sensors  UART 1
//   console  UART 2
//   stop     user button 1
//   start    user button 0
//
// The watchdog warns by NMI, which takes the torque and resets, and resets by itself if that is not done: QEMU has it.
//
// Source: Arm AN386 (DAI 0386) memory map and FPGAIO; Cortex-M System Design Kit TRM (DDI 0479) 4.3 UART, 4.5 watchdog;
// QEMU 7.2 hw/arm/mps2.c, hw/char/cmsdk-apb-uart.c, hw/misc/mps2-fpgaio.c, hw/watchdog/cmsdk-apb-watchdog.c.

#include <stdint.h>

#include "board.h"
#include "ring.h"
#include "sv_hal.h"
#include "sv_rig.h"
#include "sv_time.h"

#define CORE_HZ 25000000
#define SENSOR_BAUD 115200
#define CONSOLE_BAUD 1000000

#define REG(address) (*(volatile uint32_t*)(address))
#define FPGAIO_BUTTON REG(0x40028008U)
#define FPGAIO_COUNTER REG(0x40028018U)
#define FPGAIO_PRESCALE REG(0x4002801CU)
#define WDOG_LOAD REG(0x40008000U)
#define WDOG_CONTROL REG(0x40008008U)
#define WDOG_INTCLR REG(0x4000800CU)
#define WDOG_LOCK REG(0x40008C00U)

typedef struct {
  volatile uint32_t data, state, ctrl, intstatus, bauddiv;
} uart;

#define UART0 ((uart*)0x40004000U)
#define UART1 ((uart*)0x40005000U)
#define UART2 ((uart*)0x40006000U)

#define STATE_TXFULL (1U << 0)
#define STATE_RXFULL (1U << 1)
#define CTRL_TX (1U << 0)
#define CTRL_RX (1U << 1)
#define CTRL_TXINT (1U << 2)
#define CTRL_RXINT (1U << 3)

extern const sv_rig servolve_rig;

static uint8_t bus_bytes[256], sensor_bytes[256], console_bytes[64], answer_bytes[512];

// what has come on each line, by sv_line; a debugger may append to them
ring board_received[3] = {{bus_bytes, sizeof bus_bytes - 1U, 0U, 0U, 0U},
                          {sensor_bytes, sizeof sensor_bytes - 1U, 0U, 0U, 0U},
                          {console_bytes, sizeof console_bytes - 1U, 0U, 0U, 0U}};
static ring answers = {answer_bytes, sizeof answer_bytes - 1U, 0U, 0U, 0U};

static int32_t reset_cause;
static uint8_t watched;

int32_t board_send_bus(const uint8_t* data, int32_t size);

static void start_line(uart* line, int32_t baud) {
  line->bauddiv = (uint32_t)((CORE_HZ + baud / 2) / baud);
  line->ctrl = CTRL_TX | CTRL_RX | CTRL_RXINT;
}

void sv_hal_init(void) {
  reset_cause = board_died_of();
  // the counter counts microseconds
  FPGAIO_PRESCALE = CORE_HZ / 1000000U - 1U;
  start_line(UART0, servolve_rig.baud);
  start_line(UART1, SENSOR_BAUD);
  start_line(UART2, CONSOLE_BAUD);
  board_enable_interrupt(0);
  board_enable_interrupt(2);
  board_enable_interrupt(4);
  board_enable_interrupt(5);
  board_start_ticks(CORE_HZ);
}

uint32_t sv_hal_now_us(void) { return FPGAIO_COUNTER; }

uint32_t sv_hal_inputs(void) {
  const uint32_t buttons = FPGAIO_BUTTON;
  return ((buttons & 2U) != 0U ? SV_INPUT_STOP : 0U) | ((buttons & 1U) != 0U ? SV_INPUT_START : 0U);
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

static int32_t wait_for_room(uart* line, int32_t patience) {
  while ((line->state & STATE_TXFULL) != 0U) {
    if (--patience < 0) {
      return 0;
    }
  }
  return 1;
}

// by polling, so that fault handlers can; the UART does not tell when its last bit has left: that is waited for
__attribute__((noinline)) int32_t board_send_bus(const uint8_t* data, int32_t size) {
  // some ten cycles a round: more than 30 bits' time
  const int32_t patience = CORE_HZ / servolve_rig.baud * 4 + 100;
  int32_t n = 0;
  while (n < size && wait_for_room(UART0, patience)) {
    UART0->data = data[n++];
  }
  (void)wait_for_room(UART0, patience);
  // the byte in the shift register: ten bits, at three cycles a round
  for (volatile int32_t i = CORE_HZ / servolve_rig.baud * 4; i > 0; i--) {
  }
  return n;
}

// as much as the line takes now; its interrupt takes the rest
static void send_answers(void) {
  UART2->intstatus = 1U;
  while (ring_count(&answers) != 0U && (UART2->state & STATE_TXFULL) == 0U) {
    UART2->data = ring_take(&answers);
  }
  UART2->ctrl = CTRL_TX | CTRL_RX | CTRL_RXINT | (ring_count(&answers) != 0U ? CTRL_TXINT : 0U);
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

static void receive(uart* line, ring* r) {
  line->intstatus = 2U;
  if ((line->state & STATE_RXFULL) != 0U) {
    ring_put(r, (uint8_t)line->data);
  }
}

void board_interrupt(int32_t number) {
  if (number == 0) {
    receive(UART0, &board_received[SV_LINE_BUS]);
  } else if (number == 2) {
    receive(UART1, &board_received[SV_LINE_SENSORS]);
  } else if (number == 4) {
    receive(UART2, &board_received[SV_LINE_CONSOLE]);
  } else if (number == 5) {
    send_answers();
  } else {
    board_die(SV_RESET_FAULT);
  }
}

// NMI after 0.2 s, behind the tick's own 0.1 s; a reset after as much again
void sv_hal_feed_watchdog(void) {
  board_fed();
  WDOG_LOCK = 0x1ACCE551U;
  if (!watched) {
    watched = 1U;
    WDOG_LOAD = CORE_HZ / 5U;
    WDOG_INTCLR = 1U;
    WDOG_CONTROL = 3U;
  }
  WDOG_INTCLR = 1U;
  WDOG_LOCK = 0U;
}

int32_t sv_hal_reset_cause(void) { return reset_cause; }
