// A joint as the arithmetic of homing sees it.

#ifndef SV_AXIS_H_
#define SV_AXIS_H_

#include "sv_homing.h"
#include "sv_rig.h"

static inline sv_axis sv_axis_of(const sv_joint* joint) {
  const sv_axis axis = {joint->zero,        joint->angle_scale, joint->speed_scale, joint->speed_max,
                        joint->neutral_rad, joint->low_rad,     joint->high_rad,    joint->unlimited};
  return axis;
}

#endif  // SV_AXIS_H_
