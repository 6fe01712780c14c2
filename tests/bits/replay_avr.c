// A replay on an AVR: the record lies behind the code in flash; UART 0 tells the outcome and how much stack was used.

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>

#include "replay.h"

#define PAINT 0xA5

extern const uint8_t replay_bus[], replay_sensors[], replay_console[], replay_events[];
extern uint8_t _end;

// start-up code, which runs through: paint the memory between data and stack
void replay_paint(void) __attribute__((naked, used, section(".init3")));
void replay_paint(void) {
  for (uint8_t* byte = &_end; byte < (uint8_t*)SP; byte++) {
    *byte = PAINT;
  }
}

uint8_t replay_byte(int32_t stream, int32_t place) {
  uint32_t first;
  switch (stream) {
    case REPLAY_BUS:
      first = pgm_get_far_address(replay_bus);
      break;
    case REPLAY_SENSORS:
      first = pgm_get_far_address(replay_sensors);
      break;
    case REPLAY_CONSOLE:
      first = pgm_get_far_address(replay_console);
      break;
    default:
      first = pgm_get_far_address(replay_events);
      break;
  }
  return pgm_read_byte_far(first + (uint32_t)place);
}

int32_t replay_nevent(void) { return REPLAY_NEVENT; }

static void replay_say(uint32_t word) {
  for (int8_t shift = 28; shift >= 0; shift = (int8_t)(shift - 4)) {
    while (!(UCSR0A & (1 << UDRE0))) {
    }
    UDR0 = (uint8_t)"0123456789abcdef"[(word >> shift) & 0xFU];
  }
  while (!(UCSR0A & (1 << UDRE0))) {
  }
  UDR0 = '\n';
}

void replay_end(int32_t event, int32_t differs) {
  uint16_t unused = 0;
  while ((&_end)[unused] == PAINT) {
    unused++;
  }
  UCSR0B = 1 << TXEN0;
  replay_say((uint32_t)event);
  replay_say((uint32_t)differs);
  replay_say((uint32_t)((uintptr_t)RAMEND - (uintptr_t)&_end + 1U - unused));
  cli();
  sleep_enable();
  for (;;) {
    sleep_cpu();
  }
}
