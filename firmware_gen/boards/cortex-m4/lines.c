// The lines of a Cortex-M board as sv_hal.h has them: interrupts fill and empty rings, the main loop reads and sleeps.

#include "board.h"
#include "ring.h"
#include "sv_hal.h"
#include "sv_time.h"

#define TICKS_US 2000U  // of the last two ticks

static uint8_t bus_bytes[256], sensor_bytes[256], console_bytes[64], answer_bytes[512];

ring board_received[3] = {{bus_bytes, sizeof bus_bytes - 1U, 0U, 0U, 0U},
                          {sensor_bytes, sizeof sensor_bytes - 1U, 0U, 0U, 0U},
                          {console_bytes, sizeof console_bytes - 1U, 0U, 0U, 0U}};
ring board_answers = {answer_bytes, sizeof answer_bytes - 1U, 0U, 0U, 0U};

static int32_t is_idle(uint32_t inputs, uint32_t until_us) {
  for (int32_t line = 0; line < 3; line++) {
    if (ring_count(&board_received[line]) != 0U) {
      return 0;
    }
  }
  return sv_hal_inputs() == inputs && !sv_has_come(sv_hal_now_us(), until_us);
}

// asleep for all but the last two ticks, which are too coarse to end on
__attribute__((noinline)) void sv_hal_wait(uint32_t until_us) {
  const uint32_t inputs = sv_hal_inputs();
  while (is_idle(inputs, until_us)) {
    __asm volatile("cpsid i" ::: "memory");
    if (is_idle(inputs, until_us - TICKS_US)) {
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

int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  if (line == SV_LINE_BUS) {
    return board_send_bus(data, size);
  }
  // a line has room for one byte: handlers may not wait until a whole record is copied
  int32_t n = 0;
  while (n < size && ring_put(&board_answers, data[n])) {
    n++;
  }
  __asm volatile("cpsid i" ::: "memory");
  board_send_answers();
  __asm volatile("cpsie i" ::: "memory");
  return n;
}
