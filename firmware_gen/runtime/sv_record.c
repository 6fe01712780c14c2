#include "sv_record.h"

#include "sv_hal.h"
#include "sv_packets2.h"
#include "sv_time.h"

#define SV_FIRST 2                         // bytes before the type: a zero, the first code byte
#define SV_END (SV_FIRST + SV_RECORD_MAX)  // where type, body and CRC end at the latest

void sv_record_begin(sv_record* record, int32_t type) {
  record->n = SV_FIRST;
  sv_record_u8(record, (uint32_t)type);
}

void sv_record_u8(sv_record* record, uint32_t value) {
  if (record->n < SV_END) {
    record->bytes[record->n] = (uint8_t)value;
  }
  record->n++;
}

void sv_record_u32(sv_record* record, uint32_t value) {
  for (int32_t i = 0; i < 4; i++) {
    sv_record_u8(record, value >> 8 * i);
  }
}

void sv_record_f32(sv_record* record, float value) {
  union {
    float f;
    uint32_t u;
  } word;
  word.f = value;
  sv_record_u32(record, word.u);
}

void sv_record_varint(sv_record* record, int32_t value) {
  uint32_t rest = (uint32_t)value << 1 ^ (value < 0 ? 0xFFFFFFFFU : 0U);
  while (rest > 0x7FU) {
    sv_record_u8(record, rest | 0x80U);
    rest >>= 7;
  }
  sv_record_u8(record, rest);
}

// Put the distance to the next zero in the place of each zero, the first one's before them all.
static void sv_record_code(sv_record* record) {
  int32_t last = SV_FIRST - 1;
  for (int32_t i = SV_FIRST; i < record->n; i++) {
    if (record->bytes[i] == 0U) {
      record->bytes[last] = (uint8_t)(i - last);
      last = i;
    }
  }
  record->bytes[last] = (uint8_t)(record->n - last);
}

int32_t sv_record_end(sv_record* record, uint32_t wait_us) {
  if (record->n + 2 > SV_END) {
    return 0;
  }
  const uint16_t crc = sv_packet2_crc(0, record->bytes + SV_FIRST, record->n - SV_FIRST);
  sv_record_u8(record, crc);
  sv_record_u8(record, crc >> 8);
  sv_record_code(record);
  record->bytes[0] = 0;
  record->bytes[record->n++] = 0;

  const uint32_t until_us = sv_hal_now_us() + wait_us;
  int32_t done = sv_hal_write(SV_LINE_CONSOLE, record->bytes, record->n);
  while (done < record->n && !sv_has_come(sv_hal_now_us(), until_us)) {
    sv_hal_feed_watchdog();  // each record waits for so long, one after another
    sv_hal_wait(until_us - sv_hal_now_us() < 1000U ? until_us : sv_hal_now_us() + 1000U);
    done += sv_hal_write(SV_LINE_CONSOLE, record->bytes + done, record->n - done);
  }
  return done == record->n;
}
