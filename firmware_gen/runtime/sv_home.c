#include "sv_home.h"

#include "sv_hal.h"
#include "sv_io.h"
#include "sv_period.h"

#define SV_REST_PERIODS 10

static const float kMicro = 1.0e-6F;

// Return in how many periods at the least the rig is in neutral; a speed has its own end.
static int32_t sv_plan(sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  int32_t nmove = SV_VELOCITY_MODE(rig) ? 1 : 0;
  for (int32_t i = 0; i < rig->njoint && !SV_VELOCITY_MODE(rig); i++) {
    const sv_joint* joint = rig->joints + i;
    const float step = rig->safety.homing_rad_s * ((float)rig->period_us * kMicro);
    const int32_t periods = sv_homing_periods(joint->angle_scale, robot->goals[i], joint->neutral, step);
    nmove = periods > nmove ? periods : nmove;
    robot->from[i] = robot->goals[i];
  }
  return nmove;
}

void sv_home_goals(const sv_robot* robot, int32_t k, int32_t* goals) {
  const sv_rig* rig = SV_RIG(robot);
  for (int32_t i = 0; i < rig->njoint; i++) {
    if (SV_VELOCITY_MODE(rig)) {
      goals[i] = sv_homing_speed(rig->axes + i, robot->raw[i], rig->safety.homing_rad_s);
    } else {
      goals[i] = sv_homing_goal(robot->from[i], rig->joints[i].neutral, k, robot->nmove);
    }
  }
}

static int32_t sv_at_rest(const sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  for (int32_t i = 0; i < rig->njoint; i++) {
    const int32_t speed = robot->raw[rig->njoint + i];
    const int32_t rest = SV_SERVO(rig, i)->rest_count;
    if (robot->replies[i].status != SV_REPLY_DATA || speed > rest || speed < -rest) {
      return 0;
    }
    if (SV_VELOCITY_MODE(rig) && !sv_homing_near(rig->axes + i, robot->raw[i])) {
      return 0;
    }
  }
  return sv_sensors_fresh(robot);
}

int32_t sv_home(sv_robot* robot) {
  int32_t resting = 0;
  robot->nmove = sv_plan(robot);
  robot->begin_us = sv_hal_now_us();
  robot->ended_us = robot->begin_us;
  for (int32_t k = 0; k < robot->nmove + SV_RIG(robot)->homing_periods_max; k++) {
    if (sv_walk(robot, k) || sv_heed_stop(robot)) {
      return 1;
    }
    resting = k >= robot->nmove && sv_at_rest(robot) ? resting + 1 : 0;
    if (resting == SV_REST_PERIODS) {
      return 0;
    }
  }
  return sv_end(robot, SV_REASON_NO_REST);
}
