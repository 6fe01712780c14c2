#include "sv_cycle.h"

#include "sv_math.h"

#define SV_HAS(kinds, kind) (((kinds) >> (kind) & 1U) != 0U)

static const float kGoalRadius = 0.015F;  // [m]
static const float kWhole = 8388608.0F;   // 2^23: floats from here on are whole
static const float kPi = 3.14159274F;
static const float kHalfPi = 1.57079637F;

static int32_t sv_clamp_count(int32_t count, int32_t low, int32_t high) {
  return count < low ? low : (count > high ? high : count);
}

int32_t sv_round(float x) {
  float size = x < 0.0F ? -x : x;
  if (!(size < (float)SV_COUNT_MAX)) {
    size = x == x ? (float)SV_COUNT_MAX : 0.0F;
  }
  // a sum with 2^23 has no bits left for a part
  if (size < kWhole) {
    size = size + kWhole;
    size = size - kWhole;
  }
  return (int32_t)(x < 0.0F ? -size : size);
}

static int32_t sv_is_finite(float x) { return x - x == 0.0F; }

// a saturated count minus or plus it must stay in 32 bits
static int32_t sv_is_zero_count(int32_t zero) { return zero > -SV_COUNT_MAX && zero < SV_COUNT_MAX; }

static int32_t sv_verify_terminal(const sv_terminal* terminal, int32_t nraw) {
  if (terminal->kind != SV_TERMINAL_RAW) {
    return terminal->kind >= SV_TERMINAL_TIME && terminal->kind <= SV_TERMINAL_HEADING_ERROR;
  }
  return terminal->channel < nraw && sv_is_zero_count(terminal->zero) && sv_is_finite(terminal->scale) &&
         terminal->scale != 0.0F;
}

// a channel that may be missing: channel < 0
static int32_t sv_verify_optional(const sv_terminal* terminal, int32_t nraw) {
  return terminal->kind == SV_TERMINAL_RAW && (terminal->channel < 0 || sv_verify_terminal(terminal, nraw));
}

static int32_t sv_verify_output(const sv_output* output) {
  return sv_is_finite(output->low) && sv_is_finite(output->high) && output->low <= output->neutral &&
         output->neutral <= output->high && sv_is_finite(output->unit_scale) && sv_is_finite(output->count_scale) &&
         sv_is_zero_count(output->zero) && output->count_low <= output->count_high;
}

static int32_t sv_verify_guard(const sv_guard* guard, int32_t nraw) {
  return sv_verify_optional(&guard->angle, nraw) && guard->low <= guard->high;
}

int32_t sv_cycle_verify(const sv_cycle* cycle) {
  const int32_t error = sv_verify(cycle->program);
  if (error != SV_OK) {
    return error;
  }
  if (cycle->nraw < 0 || cycle->nraw > SV_RAW_MAX || !sv_is_finite(cycle->period_s) || !(cycle->period_s > 0.0F) ||
      !(cycle->filter > 0.0F && cycle->filter <= 1.0F) || !sv_is_finite(cycle->slew_step) ||
      !(cycle->slew_step >= 0.0F)) {
    return SV_ERROR_CYCLE;
  }
  for (int32_t i = 0; i < cycle->program->ninput; i++) {
    const sv_terminal* terminal = cycle->terminals + i;
    if (!sv_verify_terminal(terminal, cycle->nraw) || (terminal->kind == SV_TERMINAL_RAW && terminal->channel < 0)) {
      return SV_ERROR_CYCLE;
    }
  }
  const sv_terminal* pose[4] = {&cycle->x, &cycle->y, &cycle->heading, &cycle->facing};
  for (int32_t i = 0; i < 4; i++) {
    if (!sv_verify_optional(pose[i], cycle->nraw)) {
      return SV_ERROR_CYCLE;
    }
  }
  for (int32_t i = 0; i < cycle->program->noutput; i++) {
    if (!sv_verify_output(cycle->outputs + i) || (cycle->guards && !sv_verify_guard(cycle->guards + i, cycle->nraw))) {
      return SV_ERROR_CYCLE;
    }
  }
  return SV_OK;
}

void sv_cycle_reset(const sv_cycle* cycle, sv_cycle_state* state, float* registers, float* program_state) {
  sv_reset(cycle->program, registers, program_state);
  state->k = 0;
  state->goal_met = 0;
  state->goal_x = 0.0F;
  state->goal_y = 0.0F;
  for (int32_t i = 0; i < SV_OUTPUT_MAX; i++) {
    state->held[i] = 0.0F;
  }
  for (int32_t i = 0; i < cycle->program->noutput; i++) {
    state->held[i] = cycle->outputs[i].neutral * cycle->outputs[i].unit_scale;
  }
}

// raw => SI; 0 where there is no such channel
static float sv_decode(const sv_terminal* terminal, const int32_t* raw) {
  if (terminal->channel < 0) {
    return 0.0F;
  }
  const int32_t count = sv_clamp_count(raw[terminal->channel], -SV_COUNT_MAX, SV_COUNT_MAX);
  return (float)(count - terminal->zero) * terminal->scale;
}

int32_t sv_encode(const sv_terminal* terminal, float value) {
  return terminal->zero + sv_round(value / terminal->scale);
}

// direction of (x, y) from the x axis, within +-pi; 0 at the origin
static float sv_direction(float x, float y) {
  if (x > 0.0F) {
    return sv_atan(y / x);
  }
  if (x < 0.0F) {
    const float angle = sv_atan(y / x);
    return y < 0.0F ? angle - kPi : angle + kPi;
  }
  if (y > 0.0F) {
    return kHalfPi;
  }
  return y < 0.0F ? -kHalfPi : 0.0F;
}

// (goal, pose) => goal seen from the base: along and across the direction that the rig looks in [m]
static void sv_locate_goal(const sv_cycle* cycle, const sv_goal* goal, sv_cycle_state* state, const int32_t* raw,
                           float* px, float* py) {
  const float x = sv_decode(&cycle->x, raw);
  const float y = sv_decode(&cycle->y, raw);
  float heading = sv_decode(&cycle->heading, raw);
  float along;
  float across;

  // the goal stays where it was at the start
  if (state->k == 0) {
    const float bearing = heading + goal->goal_bearing;
    along = goal->goal_dist * sv_cos(bearing);
    across = goal->goal_dist * sv_sin(bearing);
    state->goal_x = x + along;
    state->goal_y = y + across;
  }

  if (cycle->facing.channel >= 0) {
    heading += sv_decode(&cycle->facing, raw);
  }
  const float c = sv_cos(heading);
  const float s = sv_sin(heading);
  const float dx = state->goal_x - x;
  const float dy = state->goal_y - y;
  along = dx * c;
  across = dy * s;
  *px = along + across;
  along = dy * c;
  across = dx * s;
  *py = along - across;

  if (*px <= kGoalRadius && *px >= -kGoalRadius) {
    state->goal_met = 1;
  }
}

// program output => the output's own unit, clamped; never NaN
static float sv_clamp_output(const sv_output* output, float value) {
  if (value != value) {
    return output->neutral;
  }
  return value < output->low ? output->low : (value > output->high ? output->high : value);
}

// SI target => filtered, then limited in rate
static float sv_follow(const sv_cycle* cycle, float held, float target) {
  if (cycle->filter != 1.0F) {
    const float step = target - held;
    const float part = cycle->filter * step;
    target = held + part;
  }
  if (cycle->slew_step > 0.0F) {
    const float step = target - held;
    if (step > cycle->slew_step) {
      target = held + cycle->slew_step;
    } else if (step < -cycle->slew_step) {
      target = held - cycle->slew_step;
    }
  }
  return target;
}

// whether a velocity would carry a limited joint beyond its limits within this period
static int32_t sv_is_beyond(const sv_cycle* cycle, int32_t number, float velocity, const int32_t* raw) {
  if (!cycle->guards || cycle->guards[number].angle.channel < 0) {
    return 0;
  }
  const sv_guard* guard = cycle->guards + number;
  const float way = velocity * cycle->period_s;
  const float angle = sv_decode(&guard->angle, raw) + way;
  return (velocity > 0.0F && angle > guard->high) || (velocity < 0.0F && angle < guard->low);
}

void sv_cycle_step(const sv_cycle* cycle, const sv_goal* goal, sv_cycle_state* state, float* registers,
                   float* program_state, const int32_t* raw, float* terminals, float* outputs, int32_t* goal_counts) {
  const sv_program* program = cycle->program;
  float px;
  float py;
  sv_locate_goal(cycle, goal, state, raw, &px, &py);

  // terminals
  for (int32_t i = 0; i < program->ninput; i++) {
    switch (cycle->terminals[i].kind) {
      case SV_TERMINAL_TIME:
        terminals[i] = (float)state->k * cycle->period_s;
        break;
      case SV_TERMINAL_RAW:
        terminals[i] = sv_decode(cycle->terminals + i, raw);
        break;
      case SV_TERMINAL_GOAL_DIST:
        terminals[i] = goal->goal_dist;
        break;
      case SV_TERMINAL_PX:
        terminals[i] = px;
        break;
      case SV_TERMINAL_PY:
        terminals[i] = SV_HAS(SV_TERMINAL_KINDS, SV_TERMINAL_PY) ? py : 0.0F;
        break;
      case SV_TERMINAL_GOAL_MET:
        terminals[i] = state->goal_met ? 1.0F : 0.0F;
        break;
      case SV_TERMINAL_HEADING_ERROR:
        terminals[i] = SV_HAS(SV_TERMINAL_KINDS, SV_TERMINAL_HEADING_ERROR) ? sv_direction(px, py) : 0.0F;
        break;
      default:
        terminals[i] = 0.0F;
        break;
    }
  }

  // program
  sv_step(program, cycle->period_s, terminals, registers, program_state, outputs);

  // clamp, filter, slew, guard, counts
  for (int32_t i = 0; i < program->noutput; i++) {
    const sv_output* output = cycle->outputs + i;
    outputs[i] = sv_clamp_output(output, outputs[i]);
    state->held[i] = sv_follow(cycle, state->held[i], outputs[i] * output->unit_scale);
    const float command = sv_is_beyond(cycle, i, state->held[i], raw) ? 0.0F : state->held[i];
    const int32_t count = output->zero + sv_round(command * output->count_scale);
    goal_counts[i] = sv_clamp_count(count, output->count_low, output->count_high);
  }
  if (state->k < INT32_MAX) {
    state->k++;
  }
}
