// One transpiled controller on an AVR: rows from flash, its selftest's answer and the outputs' bits to UART 0, as hex.
//
// The host writes rows.h: kRows, kRowCount, kSteps (rows until it starts anew), and names the controller's parts.

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include <stdint.h>

#include "rows.h"

static void avr_put(char c) {
  while (!(UCSR0A & (1 << UDRE0))) {
  }
  UDR0 = (uint8_t)c;
}

static void avr_put_word(uint32_t word) {
  for (int8_t shift = 28; shift >= 0; shift = (int8_t)(shift - 4)) {
    avr_put("0123456789abcdef"[(word >> shift) & 0xFU]);
  }
  avr_put('\n');
}

static float avr_input(uint16_t row, uint16_t column) {
  union {
    uint32_t word;
    float value;
  } input = {pgm_read_dword(&kRows[row][column])};
  return input.value;
}

int main(void) {
  static ROWS_STATE state;
  float inputs[ROWS_NINPUT + 1];
  union {
    float values[ROWS_NOUTPUT];
    uint32_t words[ROWS_NOUTPUT];
  } outputs;
  UCSR0B = 1 << TXEN0;
  avr_put_word((uint32_t)ROWS_SELFTEST());
  for (uint16_t row = 0; row < kRowCount; row++) {
    if (row % kSteps == 0) {
      ROWS_INIT(&state);
    }
    for (uint16_t i = 0; i < ROWS_NINPUT; i++) {
      inputs[i] = avr_input(row, i);
    }
    ROWS_STEP(&state, inputs, outputs.values);
    for (uint16_t i = 0; i < ROWS_NOUTPUT; i++) {
      avr_put_word(outputs.words[i]);
    }
  }
  // simavr ends where nothing can wake the core
  cli();
  sleep_enable();
  sleep_cpu();
  return 0;
}
