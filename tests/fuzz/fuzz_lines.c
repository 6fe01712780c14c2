// Any bytes at any times as sensor lines: whatever has come, no sample is from the future, but for those that are so
// old that their age has run over.

#include "fuzz_input.h"
#include "sv_lines.h"

#define NSENSOR 8
#define NMESSAGE 5

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const sv_message kMessages[NMESSAGE] = {{'P', 6, 5000}, {'F', 1, 0}, {'Q', 4, 70}, {'Z', 20, 9}, {'E', 1, 9}};
  static const sv_sensor kSensors[NSENSOR] = {
      {0, 0, 1, 0, 1.0F, 100000}, {0, 1, 1, 0, 1.0F, 100000}, {0, 5, 1, 0, 1.0F, 100000},  {1, 0, 1, 0, 1.0F, 100000},
      {2, 3, 1, 0, 1.0F, 100000}, {2, 3, 1, 0, 1.0F, 100000}, {3, 19, 0, 0, 1.0F, 100000}, {4, 0, 0, 0, 1.0F, 100000},
  };
  sv_rig rig = {.nsensor = NSENSOR, .sensors = kSensors, .nmessage = NMESSAGE, .messages = kMessages};
  int32_t raw[NSENSOR] = {0};
  uint32_t seen = 0;
  int64_t oldest_us[NSENSOR] = {0};
  sv_lines lines;
  fuzz_input input = {data, size};
  uint32_t now_us = fuzz_number(&input, 4) << (fuzz_byte(&input) & 15);
  sv_lines_init(&lines);
  while (input.n > 0) {
    uint8_t bytes[64];
    const uint32_t step_us = fuzz_number(&input, 1 + (fuzz_byte(&input) & 3));
    now_us += step_us;
    const int32_t n = fuzz_take(&input, bytes, fuzz_byte(&input) & 63);
    sv_lines_feed(&lines, &rig, bytes, n, now_us, raw);
    for (int32_t i = 0; i < NSENSOR; i++) {
      const int32_t age_us = sv_lines_age_us(&lines, &rig, i, now_us);
      seen |= (uint32_t)(age_us >= 0) << i;
      oldest_us[i] = age_us >= 0 ? age_us : oldest_us[i] + step_us;
      REQUIRE((seen >> i & 1U) != 0U ? age_us >= 0 || oldest_us[i] > INT32_MAX : age_us == -1 && raw[i] == 0);
    }
  }
  return 0;
}
