// Any bytes at any times as sensor lines: whatever has come, no sample is from the future.

#include "fuzz_input.h"
#include "sv_lines.h"

#define NSENSOR 8

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const sv_sensor kSensors[NSENSOR] = {
      {'P', 0, 1, 0, 1.0F, 5000, 100000}, {'P', 1, 1, 0, 1.0F, 5000, 100000}, {'P', 5, 1, 0, 1.0F, 5000, 100000},
      {'F', 0, 1, 0, 1.0F, 0, 100000},    {'Q', 3, 1, 0, 1.0F, 1, 100000},    {'Q', 3, 1, 0, 1.0F, 70, 100000},
      {'Z', 19, 0, 0, 1.0F, 9, 100000},   {'E', 0, 0, 0, 1.0F, 9, 100000},
  };
  sv_rig rig = {.nsensor = NSENSOR, .sensors = kSensors};
  sv_lines lines;
  fuzz_input input = {data, size};
  uint32_t now_us = fuzz_number(&input, 4) << (fuzz_byte(&input) & 15);
  sv_lines_init(&lines, &rig);
  while (input.n > 0) {
    uint8_t bytes[64];
    now_us += fuzz_number(&input, 1 + (fuzz_byte(&input) & 3));
    const int32_t n = fuzz_take(&input, bytes, fuzz_byte(&input) & 63);
    sv_lines_feed(&lines, &rig, bytes, n, now_us);
    for (int32_t i = 0; i < NSENSOR; i++) {
      int32_t raw = 0;
      const int32_t age_us = sv_lines_age_us(&lines, i, now_us);
      REQUIRE(sv_lines_raw(&lines, i, &raw) ? age_us >= 0 : age_us == -1);
    }
  }
  return 0;
}
