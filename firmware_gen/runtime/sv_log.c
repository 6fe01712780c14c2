#include "sv_log.h"

#include "sv_hal.h"
#include "sv_io.h"
#include "sv_record.h"

#define SV_ROOM_US 20000U  // how long a record may wait for room in the line's buffer while no servo has torque

void sv_log_time(sv_robot* robot, uint32_t now_us) { robot->log_us += (int32_t)(now_us - (uint32_t)robot->log_us); }

static void sv_begin(sv_robot* robot, sv_record* record, int32_t type, uint32_t t_us) {
  sv_log_time(robot, t_us);
  sv_record_begin(record, type);
  sv_record_i64(record, robot->log_us);
}

static void sv_send(sv_robot* robot, sv_record* record) {
  const int32_t slack = robot->state == SV_STATE_OFF || robot->state == SV_STATE_CHECKED;
  if (!sv_record_end(record, slack ? SV_ROOM_US : 0)) {
    robot->counts.dropped++;
  }
}

static void sv_put_reason(sv_record* record, const sv_why* why) {
  sv_record_u8(record, (uint32_t)why->reason);
  sv_record_u8(record, (uint32_t)why->joint);
  sv_record_i32(record, why->a);
  sv_record_i32(record, why->b);
}

void sv_log_hello(sv_robot* robot) {
  sv_record record;
  sv_record_begin(&record, SV_RECORD_HELLO);
  sv_record_u8(&record, SV_RECORD_FORMAT);
  sv_record_u32(&record, SV_RIG(robot)->fingerprint);
  sv_record_u32(&record, robot->program);
  sv_record_u8(&record, (uint32_t)sv_hal_reset_cause());
  sv_send(robot, &record);
}

void sv_log_start(sv_robot* robot) {
  sv_record record;
  sv_begin(robot, &record, SV_RECORD_START, sv_hal_now_us());
  sv_record_f32(&record, robot->wish.goal.goal_dist);
  sv_record_f32(&record, robot->wish.goal.goal_bearing);
  sv_record_i32(&record, robot->wish.periods);
  sv_record_f32(&record, robot->wish.derate);
  sv_record_u8(&record, robot->wish.arm);
  sv_send(robot, &record);
}

void sv_log_state(sv_robot* robot, int32_t left, const sv_why* why) {
  sv_record record;
  sv_begin(robot, &record, SV_RECORD_STATE, sv_hal_now_us());
  sv_record_u8(&record, (uint32_t)left);
  sv_record_u8(&record, robot->state);
  sv_put_reason(&record, why);
  sv_send(robot, &record);
}

void sv_log_finding(sv_robot* robot, int32_t level, int32_t finding, int32_t joint, int32_t address, int32_t value,
                    int32_t low, int32_t high) {
  sv_record record;
  sv_begin(robot, &record, SV_RECORD_FINDING, sv_hal_now_us());
  sv_record_u8(&record, (uint32_t)level);
  sv_record_u8(&record, (uint32_t)finding);
  sv_record_u8(&record, (uint32_t)joint);
  sv_record_u16(&record, (uint32_t)address);
  sv_record_i32(&record, value);
  sv_record_i32(&record, low);
  sv_record_i32(&record, high);
  sv_send(robot, &record);
}

void sv_log_cycle(sv_robot* robot, int32_t k) {
  const sv_period* done = &robot->done;
  const sv_rig* rig = SV_RIG(robot);
  const sv_program* program = servolve_cycle.program;
  uint32_t missed = 0;
  for (int32_t i = 0; i < rig->njoint; i++) {
    missed |= (uint32_t)(robot->replies[i].status != SV_REPLY_DATA) << i;
  }

  sv_record record;
  sv_begin(robot, &record, SV_RECORD_CYCLE, done->started_us);
  sv_record_varint(&record, k);
  sv_record_varint(&record, (int32_t)(done->started_us - robot->begin_us));
  sv_record_varint(&record, (int32_t)(done->read_us - done->started_us));
  sv_record_varint(&record, (int32_t)(done->aimed_us - done->read_us));
  sv_record_varint(&record, done->sent ? (int32_t)(done->ended_us - done->aimed_us) : -1);
  sv_record_u16(&record, missed);
  for (int32_t i = 0; i < servolve_cycle.nraw; i++) {
    sv_record_varint(&record, robot->raw[i]);
  }
  // ages when the cycle ran
  for (int32_t i = 0; i < rig->njoint; i++) {
    sv_record_varint(&record, sv_joint_age_us(robot, i, done->read_us));
  }
  for (int32_t i = 0; i < rig->nsensor; i++) {
    sv_record_varint(&record, sv_lines_age_us(&robot->lines, SV_RIG(robot), i, done->read_us));
  }
  for (int32_t i = 0; i < program->ninput; i++) {
    sv_record_f32(&record, robot->terminals[i]);
  }
  for (int32_t i = 0; i < program->noutput; i++) {
    sv_record_f32(&record, robot->outputs[i]);
  }
  for (int32_t i = 0; i < program->noutput; i++) {
    sv_record_varint(&record, done->aimed[i]);
  }
  sv_send(robot, &record);
}

void sv_log_block(sv_robot* robot, int32_t type, int32_t joint, const sv_block* block, const uint8_t* data) {
  sv_record record;
  sv_begin(robot, &record, type, sv_hal_now_us());
  sv_record_u8(&record, (uint32_t)joint);
  sv_record_u16(&record, (uint32_t)block->address);
  sv_record_u8(&record, (uint32_t)block->size);
  for (int32_t i = 0; i < block->size; i++) {
    sv_record_u8(&record, data[i]);
  }
  sv_send(robot, &record);
}

void sv_log_event(sv_robot* robot, int32_t event, int32_t a) {
  sv_record record;
  sv_begin(robot, &record, SV_RECORD_EVENT, sv_hal_now_us());
  sv_record_u8(&record, (uint32_t)event);
  sv_record_u8(&record, SV_NOBODY);
  sv_record_i32(&record, a);
  sv_record_i32(&record, 0);
  sv_send(robot, &record);
}

void sv_log_end(sv_robot* robot, uint32_t unsure) {
  sv_record record;
  sv_begin(robot, &record, SV_RECORD_END, sv_hal_now_us());
  sv_record_u8(&record, robot->state);
  sv_put_reason(&record, &robot->watch.why);
  sv_record_i32(&record, robot->counts.cycles);
  sv_record_i32(&record, robot->counts.missed_deadlines);
  sv_record_i32(&record, robot->counts.missed_replies);
  sv_record_u32(&record, robot->bus.nbyte);
  sv_record_u32(&record, robot->counts.dropped);
  sv_record_u16(&record, unsure);
  sv_send(robot, &record);
}

void sv_print(const char* text) {
  int32_t n = 0;
  while (text[n] != '\0') {
    n++;
  }
  (void)sv_hal_write(SV_LINE_CONSOLE, (const uint8_t*)text, n);
}

void sv_print_number(int32_t value) {
  char text[13];
  int32_t at = (int32_t)sizeof text - 1;
  uint32_t rest = value < 0 ? 0U - (uint32_t)value : (uint32_t)value;
  text[at] = '\0';
  do {
    text[--at] = (char)('0' + rest % 10U);
    rest /= 10U;
  } while (rest > 0U);
  if (value < 0) {
    text[--at] = '-';
  }
  text[--at] = ' ';
  sv_print(text + at);
}
