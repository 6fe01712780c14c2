// Operations that take more than one C expression; their table is controller/operations.py.
//
// One rounded operation a statement, no libm, valid C99 and C++. s points to the operation's own state, all 0 at the
// start; dt is the period [s].
//
// firmware_gen copies single functions out of this file: each begins after a blank line with its comment, and ends at
// the first line that is a closing brace alone.

#ifndef SV_OPERATIONS_H_
#define SV_OPERATIONS_H_

#include <stdint.h>

#include "sv_math.h"

// Hold w within 0 and 1; a NaN stays one.
static inline float sv_clamp01(float w) {
  if (w < 0.0F) {
    return 0.0F;
  }
  return w > 1.0F ? 1.0F : w;
}

// a + (b - a) * w, w held within 0 and 1.
static inline float sv_interpolate(float a, float b, float w) {
  float y;
  y = b - a;
  y = y * sv_clamp01(w);
  y = a + y;
  return y;
}

// x - floor(x), kept in [0, 1): 0 from 2^23 on, where every float is an integer; NaN for infinities and NaN.
static inline float sv_frac(float x) {
  float y;
  if (!(x > -8388608.0F && x < 8388608.0F)) {
    return x - x;
  }
  y = (float)(int32_t)x;
  if (y > x) {
    y = y - 1.0F;
  }
  y = x - y;
  // a tiny negative x: the difference rounds to 1
  return y < 1.0F ? y : 0.99999994F;
}

// The value of a the step before.
static inline float sv_delay(float* s, float a) {
  float y;
  y = s[0];
  s[0] = a;
  return y;
}

// Running sum of dt * a.
static inline float sv_integrate(float* s, float dt, float a) {
  float y;
  y = dt * a;
  y = s[0] + y;
  s[0] = y;
  return y;
}

// Change of a since the step before, per second; 0 at the first step, which s[1] remembers.
static inline float sv_differentiate(float* s, float dt, float a) {
  float y;
  y = 0.0F;
  if (s[1] != 0.0F) {
    y = a - s[0];
    y = y / dt;
  }
  s[0] = a;
  s[1] = 1.0F;
  return y;
}

// s moved towards a by the part r, held within 0 and 1.
static inline float sv_smooth(float* s, float a, float r) {
  float y;
  y = a - s[0];
  y = sv_clamp01(r) * y;
  y = s[0] + y;
  s[0] = y;
  return y;
}

// The value of a at the latest step where w > 0.
static inline float sv_memory(float* s, float a, float w) {
  if (w > 0.0F) {
    s[0] = a;
  }
  return s[0];
}

// Phase of an oscillator of f [Hz], p turns ahead, in [0, 1).
static inline float sv_phase(float* s, float dt, float f, float p) {
  float y;
  y = dt * f;
  y = s[0] + y;
  y = sv_frac(y);
  s[0] = y;
  y = y + p;
  return sv_frac(y);
}

// Sine wave of f [Hz], p turns ahead.
static inline float sv_osc_wave(float* s, float dt, float f, float p) {
  float y;
  y = sv_phase(s, dt, f, p);
  y = y * 6.28318548F;
  return sv_sin(y);
}

// Saw tooth of f [Hz], p turns ahead, rising from -1 to 1.
static inline float sv_osc_saw(float* s, float dt, float f, float p) {
  float y;
  y = sv_phase(s, dt, f, p);
  y = y * 2.0F;
  y = y - 1.0F;
  return y;
}

// Triangle of f [Hz], p turns ahead: -1 at phase 0, 1 at phase 1/2.
static inline float sv_osc_tri(float* s, float dt, float f, float p) {
  float x;
  float y;
  x = sv_phase(s, dt, f, p);
  y = x * 4.0F;
  if (x < 0.5F) {
    y = y - 1.0F;
  } else {
    y = 3.0F - y;
  }
  return y;
}

// Keep a for the next step.
static inline float sv_store(float* s, float a) {
  s[0] = a;
  return a;
}

#endif  // SV_OPERATIONS_H_
