// The board of a replay: sv_hal.h out of the record.

#include "replay.h"

#include "sv_hal.h"

#define EVENT_BYTES 15

static int32_t event;
static uint32_t now_us;
static uint32_t inputs;
static uint32_t sums[3];  // of waits, bus and console: FNV-1a
static int32_t come[3];
static int32_t taken[3];

static void replay_add(int32_t sum, uint8_t byte) { sums[sum] = (sums[sum] ^ byte) * 16777619UL; }

static uint32_t replay_number(int32_t place, int32_t size) {
  uint32_t number = 0;
  for (int32_t i = size - 1; i >= 0; i--) {
    number = number << 8 | replay_byte(REPLAY_EVENTS, event * EVENT_BYTES + place + i);
  }
  return number;
}

void sv_hal_init(void) {
  for (int32_t i = 0; i < 3; i++) {
    sums[i] = 2166136261UL;
  }
}

uint32_t sv_hal_now_us(void) { return now_us; }

void sv_hal_wait(uint32_t until_us) {
  if (event == replay_nevent()) {
    replay_end(event, 0);
  }
  // the twin's first wait is not in the record
  for (int32_t i = 0; i < 4 && event > 0; i++) {
    replay_add(0, (uint8_t)(until_us >> (8 * i)));
  }
  if (event > 0 && replay_number(0, 4) != (sums[0] ^ sums[1] ^ sums[2])) {
    replay_end(event, 1);
  }
  now_us = replay_number(4, 4);
  inputs = replay_number(8, 1);
  for (int32_t line = 0; line < 3; line++) {
    come[line] += (int32_t)replay_number(9 + 2 * line, 2);
  }
  event++;
}

int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) {
  int32_t n = 0;
  while (n < size && taken[line] < come[line]) {
    data[n++] = replay_byte(line, taken[line]++);
  }
  return n;
}

int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  for (int32_t i = 0; i < size; i++) {
    replay_add(line == SV_LINE_BUS ? 1 : 2, data[i]);
  }
  return size;
}

uint32_t sv_hal_inputs(void) { return inputs; }

void sv_hal_feed_watchdog(void) {}

int32_t sv_hal_reset_cause(void) { return 0; }
