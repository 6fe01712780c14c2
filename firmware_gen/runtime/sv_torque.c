#include "sv_torque.h"

#include "sv_hal.h"
#include "sv_homing.h"
#include "sv_period.h"
#include "sv_time.h"

#define SV_ATTEMPTS 3
#define SV_RELEASE_US_MAX 1000000U
#define SV_RELEASE_PAUSE_US 50000U
#define SV_RELEASE_PATIENCE_US 60000

// Say that a register was not taken, or could not be read.
static int32_t sv_not_taken(sv_robot* robot, int32_t joint, const sv_register* reg, int32_t status, int32_t held) {
  const int32_t b = status == SV_REPLY_DATA ? held : status << 16 | robot->bus.reply.error;
  return sv_because(&robot->watch, SV_REASON_SETTING, joint, reg->address, b);
}

// Read one register: => count.
static int32_t sv_get(sv_robot* robot, int32_t joint, const sv_register* reg, int32_t* count) {
  const int32_t status = sv_bus_read_register(&robot->bus, joint, reg, SV_ATTEMPTS, count);
  return status != SV_REPLY_DATA && sv_not_taken(robot, joint, reg, status, 0);
}

// Write one register and read it back, if the servo has it.
static int32_t sv_set(sv_robot* robot, int32_t joint, const sv_register* reg, int32_t count) {
  if (reg->size == 0) {
    return 0;
  }
  int32_t held = 0;
  sv_hal_feed_watchdog();
  const int32_t status = sv_bus_write_register(&robot->bus, joint, reg, count, SV_ATTEMPTS, &held);
  return (status != SV_REPLY_DATA || held != count) && sv_not_taken(robot, joint, reg, status, held);
}

int32_t sv_write_settings(sv_robot* robot) {
  for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
    const sv_servo* servo = SV_SERVO(SV_RIG(robot), i);
    for (int32_t n = 0; n < servo->nsetting; n++) {
      if (sv_set(robot, i, &servo->settings[n].reg, servo->settings[n].value)) {
        return 1;
      }
    }
    if (sv_set(robot, i, &servo->ceiling, sv_derate(servo->ceiling_count, robot->wish.derate))) {
      return 1;
    }
  }
  return 0;
}

int32_t sv_seed_goals(sv_robot* robot) {
  for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
    const sv_joint* joint = SV_RIG(robot)->joints + i;
    const sv_servo* servo = SV_SERVO(SV_RIG(robot), i);
    int32_t goal = 0;
    if (!SV_VELOCITY_MODE(SV_RIG(robot)) && sv_get(robot, i, &servo->position, &goal)) {
      return 1;
    }
    goal = goal > joint->goal_low ? goal : joint->goal_low;
    goal = goal < joint->goal_high ? goal : joint->goal_high;
    robot->goals[i] = goal;
    if (sv_set(robot, i, &servo->goal, goal)) {
      return 1;
    }
  }
  return 0;
}

int32_t sv_torque_on(sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  for (int32_t i = 0; i < rig->njoint; i++) {
    if (sv_set(robot, i, &SV_SERVO(rig, i)->torque, 1)) {
      return 1;
    }
  }
  for (int32_t i = 0; i < rig->njoint && rig->safety.watchdog_us > 0; i++) {
    if (sv_set(robot, i, &SV_SERVO(rig, i)->watchdog, rig->safety.watchdog_count)) {
      return 1;
    }
  }
  return 0;
}

// Set the same register of every servo to 0, without waiting for anybody.
static void sv_clear_all(sv_robot* robot, const sv_register* reg) {
  uint8_t zeros[SV_JOINT_MAX * 4] = {0};
  sv_bus_sync_write(&robot->bus, reg->address, reg->size, zeros);
}

// Ask once for a register; return whether it reads 0.
static int32_t sv_is_zero(sv_robot* robot, int32_t joint, const sv_register* reg) {
  int32_t count = 1;
  sv_hal_feed_watchdog();
  return sv_bus_read_register(&robot->bus, joint, reg, 1, &count) == SV_REPLY_DATA && count == 0;
}

// Set a register to 0, once, if the servo has it; return whether it reads so.
static int32_t sv_clear(sv_robot* robot, int32_t joint, const sv_register* reg) {
  int32_t held = 0;
  sv_hal_feed_watchdog();
  return reg->size == 0 || (sv_bus_write_register(&robot->bus, joint, reg, 0, 1, &held) == SV_REPLY_DATA && held == 0);
}

// Switch one servo's torque and watchdog off and let its velocity be 0; return whether it reads so.
static int32_t sv_switch_off(sv_robot* robot, int32_t number) {
  const sv_servo* servo = SV_SERVO(SV_RIG(robot), number);
  // a goal velocity may switch torque on
  return sv_clear(robot, number, &servo->torque) && sv_clear(robot, number, &servo->watchdog) &&
         (!SV_VELOCITY_MODE(SV_RIG(robot)) ||
          (sv_clear(robot, number, &servo->goal) && sv_is_zero(robot, number, &servo->torque)));
}

uint32_t sv_release(sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  const uint32_t until_us = sv_hal_now_us() + SV_RELEASE_US_MAX;
  uint32_t left = (UINT32_C(1) << rig->njoint) - 1U;
  if (SV_VELOCITY_MODE(rig)) {
    sv_clear_all(robot, &SV_SERVO(rig, 0)->goal);
  }
  sv_clear_all(robot, &SV_SERVO(rig, 0)->torque);
  for (;;) {
    for (int32_t i = 0; i < rig->njoint; i++) {
      if ((left >> i & 1U) != 0U && sv_switch_off(robot, i)) {
        left &= ~(UINT32_C(1) << i);
      }
    }
    if (left == 0U || sv_has_come(sv_hal_now_us(), until_us)) {
      break;
    }
    sv_wait_until(robot, sv_hal_now_us() + SV_RELEASE_PAUSE_US);
    robot->bus.patience_us = rig->patience_us > SV_RELEASE_PATIENCE_US ? rig->patience_us : SV_RELEASE_PATIENCE_US;
  }
  robot->bus.patience_us = rig->patience_us;
  return left;
}

int32_t sv_hold(sv_robot* robot) {
  for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
    const sv_servo* servo = SV_SERVO(SV_RIG(robot), i);
    int32_t torque = 0;
    if ((SV_VELOCITY_MODE(SV_RIG(robot)) && sv_set(robot, i, &servo->goal, 0)) ||
        sv_set(robot, i, &servo->watchdog, 0) || sv_get(robot, i, &servo->torque, &torque) ||
        sv_judge_torque(&robot->watch, i, torque == 1)) {
      return 1;
    }
  }
  return 0;
}
