// The one control cycle: raw counts => terminals => program => clamp, filter, slew => goal counts.
//
// Simulation, host loop and firmware all call sv_cycle_step once a period, so the same counts in give the same counts
// out, bit for bit. Raw counts are what came over the wire (encoder ticks, sensor-node integers); every conversion to
// SI happens here, in float32.

#ifndef SV_CYCLE_H_
#define SV_CYCLE_H_

#include <stdint.h>

#include "sv_program.h"

#define SV_COUNT_MAX 1073741824  // 2^30: sums and differences of two counts stay in 32 bits

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
  SV_TERMINAL_TIME = 0,          // t = k * period [s]
  SV_TERMINAL_RAW = 1,           // (raw[channel] - zero) * scale
  SV_TERMINAL_GOAL_DIST = 2,     // the task's goal distance [m]
  SV_TERMINAL_PX = 3,            // goal - base along the direction that the rig looks in [m]
  SV_TERMINAL_PY = 4,            // goal - base across it, to the left [m]
  SV_TERMINAL_GOAL_MET = 5,      // 1 once |px| <= 0.015 m has held, latched, else 0
  SV_TERMINAL_HEADING_ERROR = 6  // bearing to the goal - that direction, wrapped to +-pi [rad]
} sv_terminal_kind;

typedef struct {
  int16_t kind;     // sv_terminal_kind
  int16_t channel;  // raw channel, for SV_TERMINAL_RAW
  int32_t zero;     // counts at 0 SI
  float scale;      // SI per count, sign included
} sv_terminal;

typedef struct {
  float low;  // clamp, in the output's own unit
  float high;
  float neutral;      // what a NaN becomes, and where a position starts, in the output's own unit
  float unit_scale;   // SI per unit: pi / 180 for degrees, 1 for radians
  float count_scale;  // counts per SI, sign included
  int32_t zero;       // counts at 0 SI
  int32_t count_low;  // the rig's own limits, in counts
  int32_t count_high;
} sv_output;

typedef struct {
  sv_terminal angle;  // of a limited joint that a velocity drives: SV_TERMINAL_RAW; channel < 0: not guarded
  float low;          // a velocity that would carry the joint beyond these within a period commands 0 [rad]
  float high;
} sv_guard;

typedef struct {
  const sv_program* program;
  const sv_terminal* terminals;  // (program->ninput)
  const sv_output* outputs;      // (program->noutput)
  const sv_guard* guards;        // (program->noutput), 0: no output is guarded
  float period_s;
  float filter;     // first-order filter y += filter * (u - y); 1: none
  float slew_step;  // largest change of an output per period [SI]; 0: no limit
  int32_t nraw;     // raw channels
  sv_terminal x;    // base pose [m], [m], [rad]: SV_TERMINAL_RAW, or channel < 0 where the rig has none (reads 0)
  sv_terminal y;
  sv_terminal heading;
  sv_terminal facing;  // angle of the direction that the rig looks in from the heading [rad], likewise
} sv_cycle;

typedef struct {
  float goal_dist;     // distance of the goal from the base at k = 0 [m]
  float goal_bearing;  // its direction from the heading at k = 0 [rad]
} sv_goal;

typedef struct {
  int32_t k;         // periods since the start
  int32_t goal_met;  // latched
  float goal_x;      // goal in the frame of the pose, latched at k = 0 [m]
  float goal_y;
  float held[SV_OUTPUT_MAX];  // the filter's and the slew limit's memory [SI]
} sv_cycle_state;

// Check a configuration and its program; return SV_OK or the first error found.
int32_t sv_cycle_verify(const sv_cycle* cycle);

// Start a run: zero the state, copy the program's constants, hold every output at its neutral.
void sv_cycle_reset(const sv_cycle* cycle, sv_cycle_state* state, float* registers, float* program_state);

// Run one period: raw (nraw) => terminals (ninput), clamped outputs in their own units (noutput), goal counts
// (noutput).
void sv_cycle_step(const sv_cycle* cycle, const sv_goal* goal, sv_cycle_state* state, float* registers,
                   float* program_state, const int32_t* raw, float* terminals, float* outputs, int32_t* goal_counts);

// Round half to even, saturate at +-SV_COUNT_MAX; NaN => 0.
int32_t sv_round(float x);

// Encode an SI value as counts, round half to even, as a sensor with this terminal's scale would: SI => raw.
int32_t sv_encode(const sv_terminal* terminal, float value);

#ifdef __cplusplus
}
#endif

#endif  // SV_CYCLE_H_
