#include "sv_math_apply.h"

#include "sv_math.h"

#define APPLY(function)             \
  for (int64_t i = 0; i < n; i++) { \
    y[i] = function(x[i]);          \
  }                                 \
  return 0

int32_t sv_math_apply(int32_t function, int64_t n, const float* x, float* y) {
  switch (function) {
    case SV_MATH_SIN:
      APPLY(sv_sin);
    case SV_MATH_COS:
      APPLY(sv_cos);
    case SV_MATH_ATAN:
      APPLY(sv_atan);
    case SV_MATH_EXP:
      APPLY(sv_exp);
    case SV_MATH_LOG:
      APPLY(sv_log);
    case SV_MATH_TANH:
      APPLY(sv_tanh);
    case SV_MATH_SIGMOID:
      APPLY(sv_sigmoid);
    default:
      return -1;
  }
}
