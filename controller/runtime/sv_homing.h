// The arithmetic that decides goals beside the control cycle: homing, a speed's last look at its joint's end, derating.
//
// Host loop and firmware call the same functions, so the same counts in give the same goals out.

#ifndef SV_HOMING_H_
#define SV_HOMING_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SV_MOVE_MAX 8388608  // periods of the longest move to neutral: 46 hours of 20 ms

typedef struct {
  int32_t zero;       // encoder counts at angle 0
  float angle_scale;  // rad per count, sign included
  float speed_scale;  // rad/s per velocity count, sign included
  float speed_max;    // fastest velocity that may be commanded [rad/s]
  float neutral_rad;
  float low_rad;  // -+3.4e38 or infinite for an unlimited joint
  float high_rad;
  int32_t unlimited;
} sv_axis;

// Return how many periods a straight move takes at a rate [rad] per period, at most SV_MOVE_MAX; angle_scale: rad per
// count.
int32_t sv_homing_periods(float angle_scale, int32_t start, int32_t neutral, float step_rad);

// Return the goal of period k >= 0 of a straight move in nmove periods, rounded half to even: start => neutral
// [counts], which are less than 65536 apart.
int32_t sv_homing_goal(int32_t start, int32_t neutral, int32_t k, int32_t nmove);

// Return whether a joint that is driven by its speed is in neutral: friction, or the load that it bears, may stop it a
// little earlier.
int32_t sv_homing_near(const sv_axis* axis, int32_t count);

// Return the speed that brings a joint to neutral, slower as it comes near [velocity counts].
int32_t sv_homing_speed(const sv_axis* axis, int32_t count, float rate_rad_s);

// Return a speed, or 0 where it may have carried the joint to an end of its travel since its angle was read age_us ago
// (< 0: never), or will within this period [velocity counts].
int32_t sv_speed_inside(const sv_axis* axis, int32_t count, int32_t speed, int32_t age_us, int32_t period_us);

// Return a part of a torque ceiling, rounded half to even [counts].
int32_t sv_derate(int32_t ceiling, float part);

#ifdef __cplusplus
}
#endif

#endif  // SV_HOMING_H_
