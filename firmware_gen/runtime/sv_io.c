#include "sv_io.h"

#include "sv_hal.h"
#include "sv_time.h"

#define SV_STATE_BYTES_MAX 16  // of the block that is read of every servo in a period
#define SV_CHUNKS_MAX 2048     // reads of the sensor line in one go: no babbling line holds it up

void sv_forget(sv_robot* robot) {
  sv_bus_init(&robot->bus, SV_RIG(robot));
  sv_lines_init(&robot->lines);
  sv_watch_init(&robot->watch);
  for (int32_t i = 0; i < SV_RAW_MAX; i++) {
    robot->raw[i] = 0;
  }
  robot->answered = 0;
}

// Take what the sensor line has given: => lines; or drop it.
static void sv_take_lines(sv_robot* robot, int32_t keep) {
  uint8_t bytes[32];
  const uint32_t now_us = sv_hal_now_us();
  for (int32_t i = 0; i < SV_CHUNKS_MAX; i++) {
    const int32_t n = sv_hal_read(SV_LINE_SENSORS, bytes, (int32_t)sizeof bytes);
    if (n <= 0) {
      return;
    }
    if (keep) {
      sv_lines_feed(&robot->lines, SV_RIG(robot), bytes, n, now_us, robot->raw + 3 * SV_RIG(robot)->njoint);
    }
  }
}

void sv_drop_sensors(sv_robot* robot) { sv_take_lines(robot, 0); }

void sv_read_sensors(sv_robot* robot) { sv_take_lines(robot, 1); }

int32_t sv_sensors_fresh(const sv_robot* robot) {
  const uint32_t now_us = sv_hal_now_us();
  for (int32_t i = 0; i < SV_RIG(robot)->nsensor; i++) {
    const sv_sensor* sensor = SV_RIG(robot)->sensors + i;
    const int32_t age_us = sv_lines_age_us(&robot->lines, SV_RIG(robot), i, now_us);
    if (sensor->needed && (age_us < 0 || age_us > sensor->age_us_max)) {
      return 0;
    }
  }
  return 1;
}

int32_t sv_in_block(const sv_block* block, const uint8_t* data, const sv_register* reg, int32_t* count) {
  const int32_t at = reg->address - block->address;
  if (reg->size == 0 || at < 0 || at + reg->size > block->size) {
    return 0;
  }
  *count = sv_register_decode(reg, data + at);
  return 1;
}

void sv_read_servos(sv_robot* robot, const sv_block* block) {
  uint8_t data[SV_JOINT_MAX * SV_STATE_BYTES_MAX];
  const int32_t njoint = SV_RIG(robot)->njoint;
  sv_bus_sync_read(&robot->bus, block->address, block->size, robot->replies, data);
  for (int32_t i = 0; i < njoint; i++) {
    if (robot->replies[i].status != SV_REPLY_DATA) {
      continue;
    }
    const sv_servo* servo = SV_SERVO(SV_RIG(robot), i);
    const uint8_t* from = data + i * block->size;
    robot->answered |= UINT32_C(1) << i;
    robot->answered_us[i] = robot->replies[i].t_us;
    (void)sv_in_block(block, from, &servo->position, robot->raw + i);
    (void)sv_in_block(block, from, &servo->velocity, robot->raw + njoint + i);
    (void)sv_in_block(block, from, &servo->load, robot->raw + 2 * njoint + i);
  }
}

int32_t sv_joint_age_us(const sv_robot* robot, int32_t joint, uint32_t now_us) {
  return (robot->answered >> joint & 1U) != 0 ? sv_age_us(now_us, robot->answered_us[joint]) : -1;
}

void sv_write_goals(sv_robot* robot, const sv_block* block, const int32_t* goals) {
  uint8_t data[SV_JOINT_MAX * 4];
  const sv_rig* rig = SV_RIG(robot);
  for (int32_t i = 0; i < rig->njoint; i++) {
    robot->goals[i] = goals[i];
    if (SV_VELOCITY_MODE(rig)) {
      const int32_t age_us = sv_joint_age_us(robot, i, sv_hal_now_us());
      robot->goals[i] = sv_speed_inside(rig->axes + i, robot->raw[i], goals[i], age_us, rig->period_us);
    }
    sv_register_encode(&SV_SERVO(rig, i)->goal, robot->goals[i], data + i * block->size);
  }
  sv_bus_sync_write(&robot->bus, block->address, block->size, data);
}
