// Float32 mathematics that gives the same bits on every machine: sin, cos, atan, exp, log, tanh, sigmoid.
//
// Only binary32 additions, subtractions, multiplications, divisions and comparisons, one a statement, rounded to
// nearest even; no libm, no double, no tables. Valid C99 and C++. The largest error over all finite floats is measured
// in docs/float_math.md. Every function takes every input: NaN gives NaN, nothing traps, no conversion is out of range.
//
// Outside the range where the polynomials work:
//   sin, cos   |x| > 8192, infinities included: 0 and 1
//   exp        above 88.7228317: FLT_MAX, never infinite; subnormal results are gradual; below -103.972084: 0
//   log        x <= 0: 0; +infinity: +infinity
//   tanh       saturates at -1 and 1; sigmoid at 0 (after gradual underflow) and 1
//
// firmware_gen copies single functions out of this file: each begins after a blank line with its comment, and ends at
// the first line that is a closing brace alone.

#ifndef SV_MATH_H_
#define SV_MATH_H_

#include <stdint.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "servolve needs IEEE-754 arithmetic: compile without -ffast-math, -Ofast and -ffinite-math-only"
#endif
#if defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0 && __FLT_EVAL_METHOD__ != 16
#error "servolve needs float arithmetic rounded to float: compile with -msse2 -mfpmath=sse, or for an FPU that has it"
#endif

// a * b + c must round twice, also where the compiler's default is to fuse it (gcc -std=gnu11)
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

// Convert n to the float 2^n, -126 <= n <= 127.
static inline float sv_pow2(int32_t n) {
  union {
    uint32_t u;
    float f;
  } word;
  const int32_t exponent = n + 127;
  word.u = (uint32_t)exponent << 23;
  return word.f;
}

// Evaluate sin(x + turn * pi / 2) for |x| <= 8192: x = n pi / 2 + r, then a polynomial in r, |r| <= pi / 4.
static inline float sv_quarter_turn(float x, uint32_t turn) {
  float n;
  float r;
  float low;
  float w;
  float z;
  float y;
  uint32_t quadrant;
  // adding and subtracting 1.5 * 2^23 rounds to an integer
  n = x * 0.636619747F;
  n = n + 12582912.0F;
  n = n - 12582912.0F;
  quadrant = (uint32_t)(int32_t)n + turn;
  // pi / 2 in parts of 8, 11, 11 and 24 bits: with 13 bits of n the first three products are exact, the first two
  // differences too, and what the third one rounds off goes to low
  w = n * 1.5703125F;
  z = x - w;
  w = n * 0.000483751297F;
  z = z - w;
  w = n * 7.54953362e-08F;
  r = z - w;
  low = z - r;
  low = low - w;
  w = n * 2.56334407e-12F;
  low = low - w;
  z = r * r;
  if ((quadrant & 1U) != 0U) {
    // cos(r + low) = 1 - z / 2 + z^2 p(z) - r low
    y = z * 2.44323273e-05F;
    y = y - 0.00138873095F;
    y = y * z;
    y = y + 0.0416666456F;
    y = y * z;
    y = y - 0.5F;
    y = y * z;
    w = r * low;
    y = y - w;
    y = y + 1.0F;
  } else {
    // sin(r + low) = r + r z p(z) + low
    y = z * -0.000195180983F;
    y = y + 0.00833218824F;
    y = y * z;
    y = y - 0.166666552F;
    y = y * z;
    y = y * r;
    y = y + low;
    y = y + r;
  }
  if ((quadrant & 2U) != 0U) {
    y = -y;
  }
  return y;
}

// Sine of x [rad].
static inline float sv_sin(float x) {
  float magnitude;
  magnitude = x < 0.0F ? -x : x;
  if (!(magnitude <= 8192.0F)) {
    return x != x ? x : 0.0F;
  }
  if (magnitude < 0.000244140625F) {
    return x;
  }
  return sv_quarter_turn(x, 0U);
}

// Cosine of x [rad].
static inline float sv_cos(float x) {
  float magnitude;
  magnitude = x < 0.0F ? -x : x;
  if (!(magnitude <= 8192.0F)) {
    return x != x ? x : 1.0F;
  }
  return sv_quarter_turn(x, 1U);
}

// Arc tangent of x [rad]: atan x = pi / 2 - atan(1 / x) beyond 1.
static inline float sv_atan(float x) {
  float magnitude;
  float t;
  float z;
  float y;
  magnitude = x < 0.0F ? -x : x;
  if (!(magnitude >= 0.000244140625F)) {
    return x;
  }
  t = magnitude;
  if (magnitude > 1.0F) {
    t = 1.0F / magnitude;
  }
  z = t * t;
  // atan t = t + t z p(z), 0 <= t <= 1
  y = z * -0.0017827769F;
  y = y + 0.0108685615F;
  y = y * z;
  y = y - 0.0310968608F;
  y = y * z;
  y = y + 0.0578813367F;
  y = y * z;
  y = y - 0.0839930549F;
  y = y * z;
  y = y + 0.109508805F;
  y = y * z;
  y = y - 0.142640159F;
  y = y * z;
  y = y + 0.199985296F;
  y = y * z;
  y = y - 0.333332986F;
  y = y * z;
  y = y * t;
  if (magnitude > 1.0F) {
    // pi / 2 - atan t, pi / 2 in two parts
    y = y + 4.37113883e-08F;
    t = 1.57079637F - t;
    y = t - y;
  } else {
    y = y + t;
  }
  return x < 0.0F ? -y : y;
}

// e to the power x: x = n ln 2 + r, then a polynomial in r, |r| <= ln 2 / 2.
static inline float sv_exp(float x) {
  float n;
  float r;
  float w;
  float y;
  int32_t whole;
  int32_t half;
  if (x != x) {
    return x;
  }
  if (x > 88.7228317F) {
    return 3.40282347e+38F;
  }
  if (x < -103.972084F) {
    return 0.0F;
  }
  // adding and subtracting 1.5 * 2^23 rounds to an integer
  n = x * 1.44269502F;
  n = n + 12582912.0F;
  n = n - 12582912.0F;
  whole = (int32_t)n;
  // ln 2 in parts of 15 and 24 bits: the first product is exact
  w = n * 0.693145752F;
  r = x - w;
  w = n * 1.42860677e-06F;
  r = r - w;
  // exp r = 1 + r + r^2 p(r)
  y = r * 0.00138214533F;
  y = y + 0.00836866163F;
  y = y * r;
  y = y + 0.0416682549F;
  y = y * r;
  y = y + 0.166665211F;
  y = y * r;
  y = y + 0.49999994F;
  y = y * r;
  y = y * r;
  y = y + r;
  y = y + 1.0F;
  // 2^n in two factors: neither overflows, and only the second product rounds (a subnormal result)
  half = whole / 2;
  y = y * sv_pow2(half);
  y = y * sv_pow2(whole - half);
  return y;
}

// Natural logarithm of x, 0 where x <= 0: x = 2^k (1 + f), sqrt(1/2) <= 1 + f < sqrt(2).
static inline float sv_log(float x) {
  union {
    uint32_t u;
    float f;
  } word;
  uint32_t exponent;
  int32_t k;
  float f;
  float s;
  float z;
  float half;
  float y;
  float low;
  float high;
  if (x <= 0.0F) {
    return 0.0F;
  }
  if (!(x <= 3.40282347e+38F)) {
    return x;
  }
  k = -127;
  if (x < 1.17549435e-38F) {
    // a subnormal: 2^25 makes it normal
    x = x * 33554432.0F;
    k = -152;
  }
  // 0x3f3504f3 is sqrt(1/2), and 0x004afb0d more is 1
  word.f = x;
  word.u = word.u + 0x004afb0dU;
  exponent = word.u >> 23;
  k = k + (int32_t)exponent;
  word.u = (word.u & 0x007fffffU) + 0x3f3504f3U;
  f = word.f - 1.0F;
  // log(1 + f) = f - (f^2 / 2 - s (f^2 / 2 + z p(z))), s = f / (2 + f), z = s^2
  y = f + 2.0F;
  s = f / y;
  z = s * s;
  y = z * 0.298712373F;
  y = y + 0.399775743F;
  y = y * z;
  y = y + 0.666667759F;
  y = y * z;
  half = f * f;
  half = half * 0.5F;
  y = y + half;
  y = y * s;
  // ln 2 in parts of 15 and 24 bits: the first product is exact
  high = (float)k;
  low = high * 1.42860677e-06F;
  high = high * 0.693145752F;
  y = y + low;
  y = half - y;
  y = y - f;
  y = high - y;
  return y;
}

// Hyperbolic tangent of x.
static inline float sv_tanh(float x) {
  float magnitude;
  float z;
  float y;
  magnitude = x < 0.0F ? -x : x;
  if (!(magnitude >= 0.000244140625F)) {
    return x;
  }
  if (magnitude < 0.625F) {
    // tanh x = x + x z p(z), z = x^2
    z = x * x;
    y = z * -0.0056922962F;
    y = y + 0.0206281673F;
    y = y * z;
    y = y - 0.0537365153F;
    y = y * z;
    y = y + 0.133314058F;
    y = y * z;
    y = y - 0.333332807F;
    y = y * z;
    y = y * x;
    y = y + x;
    return y;
  }
  // tanh x = 1 - 2 / (exp(2 x) + 1), x > 0
  y = magnitude + magnitude;
  y = sv_exp(y);
  y = y + 1.0F;
  y = 2.0F / y;
  y = 1.0F - y;
  return x < 0.0F ? -y : y;
}

// Logistic function 1 / (1 + exp(-x)).
static inline float sv_sigmoid(float x) {
  float part;
  float whole;
  // exp of a negative number only: accurate in both tails
  part = x < 0.0F ? x : -x;
  part = sv_exp(part);
  whole = part + 1.0F;
  part = x < 0.0F ? part : 1.0F;
  if (x != x) {
    return x;
  }
  return part / whole;
}

#endif  // SV_MATH_H_
