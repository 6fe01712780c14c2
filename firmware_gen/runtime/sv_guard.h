// What one period shows of the rig's health. Each returns whether that ends the run: => why. After deploy/period.py.

#ifndef SV_GUARD_H_
#define SV_GUARD_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// Judge whether this board was silent for so long that the servos' bus watchdogs have tripped.
int32_t sv_stalled(sv_robot* robot, uint32_t now_us);

// Judge what this period's data show; servos that report something are asked what.
int32_t sv_judge_period(sv_robot* robot);

// Read one servo's health registers, and judge them.
int32_t sv_look_after_health(sv_robot* robot, int32_t number, const sv_block* block);

#ifdef __cplusplus
}
#endif

#endif  // SV_GUARD_H_
