// Bring the rig slowly to its neutral pose, then wait for rest and fresh sensors: deploy/homing.py.

#ifndef SV_HOME_H_
#define SV_HOME_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// Move every joint to neutral at the rig's homing speed until it rests there; return whether the run has ended instead.
int32_t sv_home(sv_robot* robot);

// Aim in period k of homing: => goals (njoint).
void sv_home_goals(const sv_robot* robot, int32_t k, int32_t* goals);

#ifdef __cplusplus
}
#endif

#endif  // SV_HOME_H_
