#include "sv_rig.h"

// a register's bits beside its sign
static int32_t sv_nbit(const sv_register* reg) {
  return SV_HAS_SIGN_BIT(reg) ? reg->encoding : 8 * reg->size - (reg->encoding == SV_TWOS);
}

int32_t sv_register_decode(const sv_register* reg, const uint8_t* data) {
  const int32_t nbit = sv_nbit(reg);
  uint32_t bits = 0;
  for (int32_t i = reg->size - 1; i >= 0; i--) {
    bits = bits << 8 | data[i];
  }
  if (SV_HAS_SIGN_BIT(reg)) {
    // bits above the sign are ignored, and so is the sign of 0
    const int32_t magnitude = (int32_t)(bits & ((UINT32_C(1) << nbit) - 1U));
    return bits >> nbit & 1U ? -magnitude : magnitude;
  }
  if (reg->encoding == SV_TWOS) {
    const uint32_t sign = UINT32_C(1) << nbit;
    return (int32_t)((bits ^ sign) - sign);
  }
  return bits > INT32_MAX ? INT32_MAX : (int32_t)bits;
}

void sv_register_encode(const sv_register* reg, int32_t count, uint8_t* data) {
  const int32_t nbit = sv_nbit(reg);
  // what the register can not hold becomes the nearest that it can
  const int32_t high = nbit > 31 ? INT32_MAX : (int32_t)((UINT32_C(1) << nbit) - 1U);
  const int32_t low = reg->encoding == SV_UNSIGNED ? 0 : -high - (reg->encoding == SV_TWOS);
  count = count < low ? low : (count > high ? high : count);
  uint32_t bits = (uint32_t)count;
  if (SV_HAS_SIGN_BIT(reg) && count < 0) {
    bits = (uint32_t)-count | UINT32_C(1) << nbit;
  }
  for (int32_t i = 0; i < reg->size; i++) {
    data[i] = (uint8_t)(bits >> 8 * i);
  }
}
