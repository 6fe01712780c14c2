#include "sv_guard.h"

#include "sv_hal.h"
#include "sv_io.h"
#include "sv_log.h"
#include "sv_record.h"
#include "sv_time.h"

#define SV_TRIPPED 255          // what the bus watchdog register reads once it has stopped its servo
#define SV_HEALTH_BYTES_MAX 16  // of a health block
#define SV_ATTEMPTS 3

// Return the count of a register, or other where it can not be read.
static int32_t sv_ask(sv_robot* robot, int32_t joint, const sv_register* reg, int32_t attempts, int32_t other) {
  int32_t count;
  const int32_t status = sv_bus_read_register(&robot->bus, joint, reg, attempts, &count);
  return status == SV_REPLY_DATA ? count : other;
}

// Look into what servos report. A byte may have been damaged, so what is wrong is asked again; an alert that is not
// answered for comes again with the next reply.
static int32_t sv_alerts(sv_robot* robot) {
  for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
    const sv_servo* servo = SV_SERVO(SV_RIG(robot), i);
    if (sv_judge_alert(SV_RIG(robot), &robot->watch, i, robot->replies + i)) {
      const int32_t status = sv_ask(robot, i, &servo->hardware_error, SV_ATTEMPTS, 0);
      const int32_t shutdown = sv_ask(robot, i, &servo->shutdown, 1, -1);
      if (sv_judge_hardware_error(SV_RIG(robot), &robot->watch, i, status, shutdown)) {
        return 1;
      }
    }
  }
  return 0;
}

// Judge whether joints do what they are told; nobody knows where one is that has never answered.
static int32_t sv_tracking(sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  if (robot->answered != (UINT32_C(1) << rig->njoint) - 1U) {
    return 0;
  }
  const uint32_t now_us = sv_hal_now_us();
  return SV_VELOCITY_MODE(rig)
             ? sv_judge_speeds(rig, &robot->watch, now_us, robot->goals, robot->raw + rig->njoint, robot->raw)
             : sv_judge_tracking(rig, &robot->watch, now_us, robot->goals, robot->raw);
}

// Judge how the base stands; an old pose says nothing about now.
static int32_t sv_tilt(sv_robot* robot, const int32_t* ages_us) {
  const sv_rig* rig = SV_RIG(robot);
  const int32_t* raw = robot->raw + 3 * rig->njoint;
  if (rig->roll < 0 || !sv_is_fresh(rig->sensors + rig->roll, ages_us[rig->roll]) ||
      !sv_is_fresh(rig->sensors + rig->pitch, ages_us[rig->pitch])) {
    return 0;
  }
  return sv_judge_tilt(rig, &robot->watch, raw[rig->roll], raw[rig->pitch]);
}

int32_t sv_judge_period(sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  sv_watch* watch = &robot->watch;
  int32_t ages_us[SV_SENSOR_MAX];
  for (int32_t i = 0; i < rig->nsensor; i++) {
    ages_us[i] = sv_lines_age_us(&robot->lines, SV_RIG(robot), i, sv_hal_now_us());
  }
  return sv_judge_replies(rig, watch, robot->replies) || sv_alerts(robot) ||
         sv_judge_encoders(rig, watch, robot->begin_us, sv_hal_now_us(), robot->replies, robot->raw) ||
         sv_judge_sensors(rig, watch, ages_us) || sv_tracking(robot) || sv_tilt(robot, ages_us);
}

int32_t sv_stalled(sv_robot* robot, uint32_t now_us) {
  const int32_t silent_us = sv_age_us(now_us, robot->ended_us);
  const int32_t watchdog_us = SV_RIG(robot)->safety.watchdog_us;
  for (int32_t i = 0; i < SV_RIG(robot)->njoint && watchdog_us > 0 && silent_us > watchdog_us; i++) {
    const sv_register* watchdog = &SV_SERVO(SV_RIG(robot), i)->watchdog;
    if (watchdog->size > 0 && sv_ask(robot, i, watchdog, SV_ATTEMPTS, 0) == SV_TRIPPED) {
      return sv_because(&robot->watch, SV_REASON_WATCHDOG, SV_NOBODY, silent_us, 0);
    }
  }
  return 0;
}

int32_t sv_look_after_health(sv_robot* robot, int32_t number, const sv_block* block) {
  uint8_t data[SV_HEALTH_BYTES_MAX];
  const sv_servo* servo = SV_SERVO(SV_RIG(robot), number);
  int32_t count = 0;
  int32_t temperature = 0;
  if (sv_bus_read(&robot->bus, number, block->address, block->size, data) != SV_REPLY_DATA) {
    return 0;
  }
  sv_log_block(robot, SV_RECORD_HEALTH, number, block, data);
  // elsewhere each reply tells a hardware error, and it comes and goes with its cause
  if (SV_PROTOCOL(SV_RIG(robot)) == SV_DYNAMIXEL2 && sv_in_block(block, data, &servo->hardware_error, &count) &&
      count != 0) {
    return sv_judge_hardware_error(SV_RIG(robot), &robot->watch, number, count,
                                   sv_ask(robot, number, &servo->shutdown, 1, -1));
  }
  if (sv_in_block(block, data, &servo->torque, &count) && sv_judge_torque(&robot->watch, number, count)) {
    return 1;
  }
  return sv_in_block(block, data, &servo->voltage, &count) &&
         sv_in_block(block, data, &servo->temperature, &temperature) &&
         sv_judge_health(SV_RIG(robot), &robot->watch, number, count, temperature);
}
