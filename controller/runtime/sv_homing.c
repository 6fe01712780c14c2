#include "sv_homing.h"

#include "sv_cycle.h"

static const float kPi = 3.14159274F;
static const float kTwoPi = 6.28318548F;
static const float kApproach = 4.0F;  // speed by distance [1/s]: slower over the last quarter of a second
static const float kNear = 0.08F;     // how near to neutral is near enough [rad]
static const float kMicro = 1.0e-6F;

static float sv_limit(float x, float limit) { return x > limit ? limit : (x < -limit ? -limit : x); }

int32_t sv_homing_periods(float angle_scale, int32_t start, int32_t neutral, float step_rad) {
  const float way = (float)(neutral - start) * angle_scale;
  const float periods = (way < 0.0F ? -way : way) / step_rad;
  if (!(periods < (float)SV_MOVE_MAX)) {
    return SV_MOVE_MAX;
  }
  const int32_t whole = (int32_t)periods;
  return (float)whole < periods ? whole + 1 : whole;
}

int32_t sv_homing_goal(int32_t start, int32_t neutral, int32_t k, int32_t nmove) {
  if (k + 1 >= nmove) {
    return neutral;
  }
  // from the lower end, whichever way: low + way * done / all in 32 bits, way in two bytes
  const int32_t low = start < neutral ? start : neutral;
  const uint32_t way = (uint32_t)(start < neutral ? neutral - start : start - neutral) & 0xFFFFU;
  const uint32_t done = (uint32_t)(start < neutral ? k + 1 : nmove - (k + 1));
  const uint32_t all = (uint32_t)nmove;
  const uint32_t high = (way >> 8) * done;
  const uint32_t rest = ((high % all) << 8) + (way & 0xFFU) * done;
  const int32_t goal = low + (int32_t)(((high / all) << 8) + rest / all);
  const uint32_t twice = 2U * (rest % all);
  return goal + (twice > all || (twice == all && goal % 2 != 0));
}

// Return how far a joint is from neutral, by the shorter way where it may turn for ever [rad].
static float sv_away(const sv_axis* axis, int32_t count) {
  if (!axis->unlimited) {
    const float angle = (float)(count - axis->zero) * axis->angle_scale;
    return axis->neutral_rad - angle;
  }
  // whole turns go first, as counts
  const float scale = axis->angle_scale < 0.0F ? -axis->angle_scale : axis->angle_scale;
  const int32_t turn = sv_round(kTwoPi / scale);
  const float angle = (float)((count - axis->zero) % turn) * axis->angle_scale;
  float away = axis->neutral_rad - angle;
  while (away > kPi) {
    away = away - kTwoPi;
  }
  while (away < -kPi) {
    away = away + kTwoPi;
  }
  return away;
}

int32_t sv_homing_near(const sv_axis* axis, int32_t count) {
  const float away = sv_away(axis, count);
  return away <= kNear && away >= -kNear;
}

int32_t sv_homing_speed(const sv_axis* axis, int32_t count, float rate_rad_s) {
  const float wanted = sv_limit(kApproach * sv_away(axis, count), rate_rad_s);
  return sv_round(sv_limit(wanted, axis->speed_max) / axis->speed_scale);
}

int32_t sv_speed_inside(const sv_axis* axis, int32_t count, int32_t speed, int32_t age_us, int32_t period_us) {
  const float rate = (float)speed * axis->speed_scale;
  // older than half an hour is never
  float ahead = 3.0e38F;
  if (age_us >= 0 && age_us < INT32_MAX - period_us) {
    ahead = (float)(age_us + period_us) * kMicro;
  }
  const float way = rate * ahead;
  const float end = (float)(count - axis->zero) * axis->angle_scale + way;
  return (rate > 0.0F && end > axis->high_rad) || (rate < 0.0F && end < axis->low_rad) ? 0 : speed;
}

int32_t sv_derate(int32_t ceiling, float part) { return sv_round((float)ceiling * part); }
