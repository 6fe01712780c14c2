// The float32 mathematics over arrays, for tests and measurements.

#ifndef SV_MATH_APPLY_H_
#define SV_MATH_APPLY_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
  SV_MATH_SIN = 0,
  SV_MATH_COS = 1,
  SV_MATH_ATAN = 2,
  SV_MATH_EXP = 3,
  SV_MATH_LOG = 4,
  SV_MATH_TANH = 5,
  SV_MATH_SIGMOID = 6
} sv_math_function;

// Apply a function: x (n) => y (n); return 0, or -1 where there is no such function.
int32_t sv_math_apply(int32_t function, int64_t n, const float* x, float* y);

#ifdef __cplusplus
}
#endif

#endif  // SV_MATH_APPLY_H_
