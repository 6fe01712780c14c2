#include "sv_period.h"

#include "sv_axis.h"
#include "sv_console.h"
#include "sv_hal.h"
#include "sv_home.h"
#include "sv_log.h"
#include "sv_record.h"

#define SV_TRIPPED 255         // what the bus watchdog register reads once it has stopped its servo
#define SV_STATE_BYTES_MAX 16  // of the block that is read of every servo in a period
#define SV_HEALTH_BYTES_MAX 16
#define SV_ATTEMPTS 3
#define SV_WAIT_US_MAX 50000  // the watchdog is fed so often

void sv_wait_until(sv_robot* robot, int64_t until_us) {
  int64_t seen_us = -1;
  for (;;) {
    sv_console_listen(robot);
    const int64_t now_us = sv_hal_now_us();
    // a clock that stands still is no reason to feed
    if (now_us != seen_us) {
      sv_hal_feed_watchdog();
    }
    if (now_us >= until_us) {
      return;
    }
    seen_us = now_us;
    sv_hal_wait(until_us - now_us > SV_WAIT_US_MAX ? now_us + SV_WAIT_US_MAX : until_us);
  }
}

int32_t sv_heed_stop(sv_robot* robot) {
  sv_console_listen(robot);
  if (robot->wish.stop == SV_REASON_NONE && robot->lines.emergency_stop) {
    robot->wish.stop = SV_REASON_STOP_LINE;
  }
  return robot->wish.stop != SV_REASON_NONE && sv_end(robot, robot->wish.stop);
}

int32_t sv_end(sv_robot* robot, int32_t reason) { return sv_because(&robot->watch, reason, SV_NOBODY, 0, 0); }

void sv_forget(sv_robot* robot) {
  sv_bus_init(&robot->bus, robot->rig);
  sv_lines_init(&robot->lines, robot->rig);
  sv_watch_init(&robot->watch);
  for (int32_t i = 0; i < SV_RAW_MAX; i++) {
    robot->raw[i] = 0;
  }
  for (int32_t i = 0; i < SV_JOINT_MAX; i++) {
    robot->answered_us[i] = -1;
  }
}

// sensor line => raw
void sv_read_sensors(sv_robot* robot) {
  uint8_t bytes[32];
  const int64_t now_us = sv_hal_now_us();
  // as many bytes as a buffer may hold, so that no babbling line holds it up
  for (int32_t i = 0; i < 2048; i++) {
    const int32_t n = sv_hal_read(SV_LINE_SENSORS, bytes, (int32_t)sizeof bytes);
    if (n <= 0) {
      break;
    }
    sv_lines_feed(&robot->lines, robot->rig, bytes, n, now_us);
  }
  for (int32_t i = 0; i < robot->rig->nsensor; i++) {
    (void)sv_lines_raw(&robot->lines, i, robot->raw + 3 * robot->rig->njoint + i);
  }
}

int32_t sv_sensors_fresh(const sv_robot* robot) {
  const int64_t now_us = sv_hal_now_us();
  for (int32_t i = 0; i < robot->rig->nsensor; i++) {
    const sv_sensor* sensor = robot->rig->sensors + i;
    const int64_t age_us = sv_lines_age_us(&robot->lines, i, now_us);
    if (sensor->needed && (age_us < 0 || age_us > sensor->age_us_max)) {
      return 0;
    }
  }
  return 1;
}

// Return whether a block holds a register: => its count.
static int32_t sv_in_block(const sv_block* block, const uint8_t* data, const sv_register* reg, int32_t* count) {
  const int32_t at = reg->address - block->address;
  if (reg->size == 0 || at < 0 || at + reg->size > block->size) {
    return 0;
  }
  *count = sv_register_decode(reg, data + at);
  return 1;
}

// servos => raw; the last counts of one that does not answer are held
static void sv_read_servos(sv_robot* robot, const sv_block* block) {
  uint8_t data[SV_JOINT_MAX * SV_STATE_BYTES_MAX];
  const int32_t njoint = robot->rig->njoint;
  sv_bus_sync_read(&robot->bus, block->address, block->size, robot->replies, data);
  for (int32_t i = 0; i < njoint; i++) {
    if (robot->replies[i].status != SV_REPLY_DATA) {
      continue;
    }
    const sv_joint* joint = robot->rig->joints + i;
    const uint8_t* from = data + i * block->size;
    robot->answered_us[i] = robot->replies[i].t_us;
    (void)sv_in_block(block, from, &joint->position, robot->raw + i);
    (void)sv_in_block(block, from, &joint->velocity, robot->raw + njoint + i);
    (void)sv_in_block(block, from, &joint->load, robot->raw + 2 * njoint + i);
  }
}

// Return how old a joint's counts are [us], -1: it has never answered.
static int64_t sv_joint_age_us(const sv_robot* robot, int32_t joint) {
  return robot->answered_us[joint] < 0 ? -1 : sv_hal_now_us() - robot->answered_us[joint];
}

// Return the count of a register, or other where it can not be read.
static int32_t sv_ask(sv_robot* robot, int32_t joint, const sv_register* reg, int32_t attempts, int32_t other) {
  int32_t count = other;
  const sv_reply reply = sv_bus_read_register(&robot->bus, joint, reg, attempts, &count);
  return reply.status == SV_REPLY_DATA ? count : other;
}

// Look into what servos report. A byte may have been damaged, so what is wrong is asked again; an alert that is not
// answered for comes again with the next reply.
static int32_t sv_alerts(sv_robot* robot) {
  for (int32_t i = 0; i < robot->rig->njoint; i++) {
    const sv_joint* joint = robot->rig->joints + i;
    if (sv_judge_alert(robot->rig, &robot->watch, i, robot->replies + i)) {
      const int32_t status = sv_ask(robot, i, &joint->hardware_error, SV_ATTEMPTS, 0);
      const int32_t shutdown = sv_ask(robot, i, &joint->shutdown, 1, -1);
      if (sv_judge_hardware_error(robot->rig, &robot->watch, i, status, shutdown)) {
        return 1;
      }
    }
  }
  return 0;
}

// Judge whether joints do what they are told.
static int32_t sv_tracking(sv_robot* robot) {
  const sv_rig* rig = robot->rig;
  const int64_t now_us = sv_hal_now_us();
  return SV_VELOCITY_MODE(rig)
             ? sv_judge_speeds(rig, &robot->watch, now_us, robot->goals, robot->raw + rig->njoint, robot->raw)
             : sv_judge_tracking(rig, &robot->watch, now_us, robot->goals, robot->raw);
}

static float sv_sensor_value(const sv_robot* robot, int32_t sensor) {
  const sv_sensor* line = robot->rig->sensors + sensor;
  return (float)(robot->raw[3 * robot->rig->njoint + sensor] - line->zero) * line->scale;
}

// Judge how the base stands; an old pose says nothing about now.
static int32_t sv_tilt(sv_robot* robot, const int32_t* ages_us) {
  const sv_rig* rig = robot->rig;
  const int32_t places[2] = {rig->roll, rig->pitch};
  for (int32_t i = 0; i < 2; i++) {
    if (places[i] < 0 || ages_us[places[i]] < 0 || ages_us[places[i]] > rig->sensors[places[i]].age_us_max) {
      return 0;
    }
  }
  return sv_judge_tilt(rig, &robot->watch, sv_sensor_value(robot, rig->roll), sv_sensor_value(robot, rig->pitch));
}

// Judge what this period's data show.
static int32_t sv_judge_period(sv_robot* robot) {
  const sv_rig* rig = robot->rig;
  sv_watch* watch = &robot->watch;
  int32_t ages_us[SV_SENSOR_MAX];
  for (int32_t i = 0; i < rig->nsensor; i++) {
    ages_us[i] = sv_clip_us(sv_lines_age_us(&robot->lines, i, sv_hal_now_us()));
  }
  return sv_judge_replies(rig, watch, robot->replies) || sv_alerts(robot) ||
         sv_judge_encoders(rig, watch, sv_hal_now_us(), robot->replies, robot->raw) ||
         sv_judge_sensors(rig, watch, ages_us) || sv_tracking(robot) || sv_tilt(robot, ages_us);
}

// Take a last look at limits and rate, which those who aim should have kept.
static int32_t sv_refuse(sv_robot* robot, const int32_t* goals) {
  const sv_rig* rig = robot->rig;
  const float homing = SV_VELOCITY_MODE(rig) ? 0.0F : rig->safety.homing_rad_s;
  const float rate = robot->state == SV_STATE_RUNNING ? rig->slew_rad_s : homing;
  for (int32_t i = 0; i < rig->njoint; i++) {
    const sv_joint* joint = rig->joints + i;
    const int32_t last = robot->goals[i];
    if (goals[i] < joint->goal_low || goals[i] > joint->goal_high) {
      return sv_because(&robot->watch, SV_REASON_LIMIT, i, goals[i], 0);
    }
    if (SV_VELOCITY_MODE(rig) && !joint->unlimited && (goals[i] == 0 || last == 0)) {
      continue;  // near an end of its travel a joint is stopped at once, and let go at once
    }
    const float scale = SV_VELOCITY_MODE(rig) ? joint->speed_scale : joint->angle_scale;
    const float unit = scale < 0.0F ? -scale : scale;
    const float step = (float)(goals[i] < last ? last - goals[i] : goals[i] - last) * unit;
    const float allowed = rate * ((float)rig->period_us * 1.0e-6F) + unit;
    if (rate > 0.0F && step > 1.001F * allowed) {
      return sv_because(&robot->watch, SV_REASON_RATE, i, goals[i], last);
    }
  }
  return 0;
}

// Write the goals, without the speed of a joint that it may have carried to an end of its travel.
static void sv_write_goals(sv_robot* robot, const sv_block* block, const int32_t* goals) {
  uint8_t data[SV_JOINT_MAX * 4];
  const sv_rig* rig = robot->rig;
  for (int32_t i = 0; i < rig->njoint; i++) {
    robot->goals[i] = goals[i];
    if (SV_VELOCITY_MODE(rig)) {
      const sv_axis axis = sv_axis_of(rig->joints + i);
      robot->goals[i] = sv_speed_inside(&axis, robot->raw[i], goals[i], sv_joint_age_us(robot, i), rig->period_us);
    }
    sv_register_encode(&rig->joints[i].goal, robot->goals[i], data + i * block->size);
  }
  sv_bus_sync_write(&robot->bus, block->address, block->size, data);
}

// Judge whether this board was silent for so long that the servos' bus watchdogs have tripped.
static int32_t sv_stalled(sv_robot* robot, int64_t now_us) {
  const int64_t silent_us = now_us - robot->ended_us;
  const int32_t watchdog_us = robot->rig->safety.watchdog_us;
  for (int32_t i = 0; i < robot->rig->njoint && watchdog_us > 0 && silent_us > watchdog_us; i++) {
    const sv_register* watchdog = &robot->rig->joints[i].watchdog;
    if (watchdog->size > 0 && sv_ask(robot, i, watchdog, SV_ATTEMPTS, 0) == SV_TRIPPED) {
      return sv_because(&robot->watch, SV_REASON_WATCHDOG, SV_NOBODY, sv_clip_us(silent_us), 0);
    }
  }
  return 0;
}

// Read one servo's health registers.
static int32_t sv_look_after_health(sv_robot* robot, int32_t number, const sv_block* block) {
  uint8_t data[SV_HEALTH_BYTES_MAX];
  const sv_joint* joint = robot->rig->joints + number;
  int32_t count = 0;
  int32_t temperature = 0;
  if (sv_bus_read(&robot->bus, number, block->address, block->size, data).status != SV_REPLY_DATA) {
    return 0;
  }
  sv_log_block(robot, SV_RECORD_HEALTH, number, block, data);
  // elsewhere each reply tells a hardware error, and it comes and goes with its cause
  if (SV_PROTOCOL(robot->rig) == SV_DYNAMIXEL2 && sv_in_block(block, data, &joint->hardware_error, &count) &&
      count != 0) {
    return sv_judge_hardware_error(robot->rig, &robot->watch, number, count,
                                   sv_ask(robot, number, &joint->shutdown, 1, -1));
  }
  if (sv_in_block(block, data, &joint->torque, &count) && sv_judge_torque(&robot->watch, number, count)) {
    return 1;
  }
  return sv_in_block(block, data, &joint->voltage, &count) &&
         sv_in_block(block, data, &joint->temperature, &temperature) &&
         sv_judge_health(robot->rig, &robot->watch, number, count, temperature);
}

// A period that is more than one period late makes all later ones late by whole periods: no catching up.
static void sv_await_period(sv_robot* robot) {
  const int32_t period_us = robot->rig->period_us;
  robot->begin_us += period_us;
  const int64_t now_us = sv_hal_now_us();
  if (now_us - robot->begin_us > period_us) {
    const int64_t behind_us = now_us - robot->begin_us;
    robot->begin_us += behind_us < INT32_MAX ? (int32_t)behind_us / period_us * period_us : behind_us;
  }
  sv_wait_until(robot, robot->begin_us);
}

static void sv_aim(sv_robot* robot, int32_t k, int32_t* goals) {
  if (robot->state != SV_STATE_RUNNING) {
    sv_home_goals(robot, k, goals);
    return;
  }
  sv_cycle_step(robot->rig->cycle, &robot->wish.goal, &robot->cycle, robot->registers, robot->memory, robot->raw,
                robot->terminals, robot->outputs, goals);
}

// Do one thing that is due, unless a fault keeps it from being done; return whether it shows a fault.
static int32_t sv_do(sv_robot* robot, int32_t k, const sv_transaction* due, int32_t faulty, sv_period* done) {
  switch (due->kind) {
    case SV_READ_STATE:
      sv_read_servos(robot, &due->block);
      sv_read_sensors(robot);
      done->read_us = sv_hal_now_us();
      return 0;
    case SV_RUN_CYCLE:
      sv_aim(robot, k, done->aimed);
      done->aimed_us = sv_hal_now_us();
      return !faulty && sv_judge_period(robot);
    case SV_WRITE_GOALS:
      done->sent = !faulty && !sv_refuse(robot, done->aimed);
      if (done->sent) {
        sv_write_goals(robot, &due->block, done->aimed);
      }
      done->ended_us = sv_hal_now_us();
      return !done->sent;
    default:
      return !faulty && sv_look_after_health(robot, due->servo, &due->block);
  }
}

int32_t sv_walk(sv_robot* robot, int32_t k, sv_period* done) {
  sv_transaction due[SV_TRANSACTION_MAX];
  sv_await_period(robot);
  done->started_us = sv_hal_now_us();
  int32_t faulty = sv_stalled(robot, done->started_us);
  const int32_t ndue = sv_schedule_period(&robot->rig->schedule, k, due);
  for (int32_t i = 0; i < ndue; i++) {
    faulty = sv_do(robot, k, due + i, faulty, done) || faulty;
  }
  robot->ended_us = sv_hal_now_us();
  done->overran = robot->ended_us > robot->begin_us + robot->rig->period_us;
  return faulty || sv_judge_timing(robot->rig, &robot->watch, done->overran);
}
