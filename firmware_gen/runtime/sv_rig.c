#include "sv_rig.h"

static int32_t sv_sign_bit(uint8_t encoding) {
  return encoding == SV_SIGN15 ? 15 : encoding == SV_SIGN11 ? 11 : encoding == SV_SIGN10 ? 10 : -1;
}

int32_t sv_register_decode(const sv_register* reg, const uint8_t* data) {
  uint32_t bits = 0;
  for (int32_t i = reg->size - 1; i >= 0; i--) {
    bits = bits << 8 | data[i];
  }
  const int32_t sign = sv_sign_bit(reg->encoding);
  if (sign >= 0) {
    // bits above the sign are ignored, and so is the sign of 0
    const int32_t magnitude = (int32_t)(bits & ((UINT32_C(1) << sign) - 1U));
    return bits >> sign & 1U ? -magnitude : magnitude;
  }
  if (reg->encoding == SV_TWOS && reg->size > 0 && reg->size < 4) {
    const uint32_t top = UINT32_C(1) << (8 * reg->size - 1);
    return bits & top ? (int32_t)(bits - top) - (int32_t)top : (int32_t)bits;
  }
  if (bits > 0x7FFFFFFFU) {
    return reg->encoding == SV_TWOS ? -(int32_t)(~bits) - 1 : INT32_MAX;
  }
  return (int32_t)bits;
}

void sv_register_encode(const sv_register* reg, int32_t count, uint8_t* data) {
  const int32_t sign = sv_sign_bit(reg->encoding);
  // what the register can not hold becomes the nearest that it can
  int32_t low = 0;
  int32_t high = INT32_MAX;
  if (sign >= 0) {
    high = (int32_t)(UINT32_C(1) << sign) - 1;
    low = -high;
  } else if (reg->encoding == SV_TWOS) {
    high = reg->size < 4 ? (int32_t)(UINT32_C(1) << (8 * reg->size - 1)) - 1 : INT32_MAX;
    low = -high - 1;
  } else if (reg->size < 4) {
    high = (int32_t)(UINT32_C(1) << 8 * reg->size) - 1;
  }
  count = count < low ? low : (count > high ? high : count);
  uint32_t bits = (uint32_t)count;
  if (sign >= 0) {
    bits = count < 0 ? (uint32_t)-count | UINT32_C(1) << sign : bits;
  }
  for (int32_t i = 0; i < reg->size; i++) {
    data[i] = (uint8_t)(bits >> 8 * i);
  }
}
