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

#define NVIC_ISER0 REG(0xE000E100U)

extern const sv_rig servolve_rig;

void board_on_bus(void);
void board_on_sensors(void);
void board_on_console(void);

BOARD_EXTERNAL external[] = {[0] = board_on_bus, [1] = board_fault,      [2] = board_on_sensors,
                             [3] = board_fault,  [4] = board_on_console, [5] = board_send_answers};

static void start_line(uart* line, int32_t baud) {
  line->bauddiv = (uint32_t)((CORE_HZ + baud / 2) / baud);
  line->ctrl = CTRL_TX | CTRL_RX | CTRL_RXINT;
}

void sv_hal_init(void) {
  // the counter counts microseconds
  FPGAIO_PRESCALE = CORE_HZ / 1000000U - 1U;
  start_line(UART0, SV_BAUD(&servolve_rig));
  start_line(UART1, SENSOR_BAUD);
  start_line(UART2, CONSOLE_BAUD);
  NVIC_ISER0 = 1U << 0 | 1U << 2 | 1U << 4 | 1U << 5;
  board_start_ticks(CORE_HZ / 1000);
}

uint32_t sv_hal_now_us(void) { return FPGAIO_COUNTER; }

uint32_t sv_hal_inputs(void) {
  const uint32_t buttons = FPGAIO_BUTTON;
  return ((buttons & 2U) != 0U ? SV_INPUT_STOP : 0U) | ((buttons & 1U) != 0U ? SV_INPUT_START : 0U);
}

static int32_t wait_for_room(uart* line, int32_t patience) {
  while ((line->state & STATE_TXFULL) != 0U) {
    if (--patience < 0) {
      return 0;
    }
  }
  return 1;
}

// the UART does not tell when its last bit has left: that is waited for
__attribute__((noinline)) int32_t board_send_bus(const uint8_t* data, int32_t size) {
  // some ten cycles a round: more than 30 bits' time
  const int32_t patience = CORE_HZ / SV_BAUD(&servolve_rig) * 4 + 100;
  int32_t n = 0;
  while (n < size && wait_for_room(UART0, patience)) {
    UART0->data = data[n++];
  }
  (void)wait_for_room(UART0, patience);
  // the byte in the shift register: ten bits, at three cycles a round
  for (volatile int32_t i = CORE_HZ / SV_BAUD(&servolve_rig) * 4; i > 0; i--) {
  }
  return n;
}

void board_send_answers(void) {
  UART2->intstatus = 1U;
  while (ring_count(&board_answers) != 0U && (UART2->state & STATE_TXFULL) == 0U) {
    UART2->data = ring_take(&board_answers);
  }
  UART2->ctrl = CTRL_TX | CTRL_RX | CTRL_RXINT | (ring_count(&board_answers) != 0U ? CTRL_TXINT : 0U);
}

static void receive(uart* line, ring* r) {
  line->intstatus = 2U;
  if ((line->state & STATE_RXFULL) != 0U) {
    ring_put(r, (uint8_t)line->data);
  }
}

void board_on_bus(void) { receive(UART0, &board_received[SV_LINE_BUS]); }

void board_on_sensors(void) { receive(UART1, &board_received[SV_LINE_SENSORS]); }

void board_on_console(void) { receive(UART2, &board_received[SV_LINE_CONSOLE]); }

// the watchdog's warning
void board_on_nmi(void) { board_die(SV_RESET_WATCHDOG); }

// NMI after 0.2 s, behind the tick's own 0.1 s; a reset after as much again
void sv_hal_feed_watchdog(void) {
  WDOG_LOCK = 0x1ACCE551U;
  if (board_fed_ms == 0) {
    WDOG_LOAD = CORE_HZ / 5U;
    WDOG_INTCLR = 1U;
    WDOG_CONTROL = 3U;
  }
  board_fed_ms = BOARD_FED_MS;
  WDOG_INTCLR = 1U;
  WDOG_LOCK = 0U;
}
