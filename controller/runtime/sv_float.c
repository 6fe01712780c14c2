#include "sv_math.h"
#include "sv_program.h"

int32_t sv_check_float(void) {
  // volatile: computed here and now, not by the compiler
  volatile float smallest_normal = 1.17549435e-38F;
  volatile float subnormal = 1.40129846e-45F;
  volatile float half = 0.5F;
  volatile float large = 16777216.0F;
  volatile float one = 1.0F;
  volatile float above = 1.00024414F;    // 1 + 2^-12
  volatile float square = 1.00048828F;   // its square, rounded
  volatile float tie = 5.96046448e-08F;  // 2^-24
  volatile float result;

  // a subnormal result is kept, and a subnormal operand is not taken for 0
  result = smallest_normal * half;
  if (result == 0.0F) {
    return SV_ERROR_FLOAT;
  }
  result = subnormal * large;
  if (result == 0.0F) {
    return SV_ERROR_FLOAT;
  }
  // nearest, ties to even, for both signs
  result = one + tie;
  if (result != 1.0F) {
    return SV_ERROR_FLOAT;
  }
  result = above + tie * 3.0F;
  if (result != 1.00024438F) {
    return SV_ERROR_FLOAT;
  }
  result = -one - tie;
  if (result != -1.0F) {
    return SV_ERROR_FLOAT;
  }
  // a product rounds before the sum: fused, this leaves 2^-24
  const float x = above;
  const float y = square;
  const float product = x * x;
  result = product - y;
  if (result != 0.0F) {
    return SV_ERROR_FLOAT;
  }
  return SV_OK;
}
