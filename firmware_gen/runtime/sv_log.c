#include "sv_log.h"

#include "sv_hal.h"
#include "sv_io.h"
#include "sv_record.h"

#define SV_ROOM_US 20000U  // how long a record may wait for room in the line's buffer while no servo has torque

void sv_log_time(sv_robot* robot, uint32_t now_us) { robot->log_us += (int32_t)(now_us - (uint32_t)robot->log_us); }

static void sv_begin(sv_robot* robot, sv_record* record, int32_t type, uint32_t t_us) {
  sv_log_time(robot, t_us);
  sv_record_begin(record, type);
  sv_record_u32(record, (uint32_t)robot->log_us);
  sv_record_u32(record, (uint32_t)((uint64_t)robot->log_us >> 32));
}

static void sv_put(sv_record* record, const int32_t* numbers, int32_t n) {
  for (int32_t i = 0; i < n; i++) {
    sv_record_varint(record, numbers[i]);
  }
}

static void sv_put_floats(sv_record* record, const float* numbers, int32_t n) {
  for (int32_t i = 0; i < n; i++) {
    sv_record_f32(record, numbers[i]);
  }
}

static void sv_send(sv_robot* robot, sv_record* record) {
  const int32_t slack = robot->state == SV_STATE_OFF || robot->state == SV_STATE_CHECKED;
  if (!sv_record_end(record, slack ? SV_ROOM_US : 0)) {
    robot->counts.dropped++;
  }
}

// Write a record of numbers.
static void sv_tell(sv_robot* robot, int32_t type, const int32_t* numbers, int32_t n) {
  sv_record record;
  sv_begin(robot, &record, type, sv_hal_now_us());
  sv_put(&record, numbers, n);
  sv_send(robot, &record);
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
  const sv_wish* wish = &robot->wish;
  const float floats[] = {wish->goal.goal_dist, wish->goal.goal_bearing, wish->derate};
  const int32_t numbers[] = {wish->periods, wish->arm};
  sv_record record;
  sv_begin(robot, &record, SV_RECORD_START, sv_hal_now_us());
  sv_put_floats(&record, floats, 3);
  sv_put(&record, numbers, 2);
  sv_send(robot, &record);
}

void sv_log_state(sv_robot* robot, int32_t left, const sv_why* why) {
  const int32_t numbers[] = {left, robot->state, why->reason, why->joint, why->a, why->b};
  sv_tell(robot, SV_RECORD_STATE, numbers, 6);
}

void sv_log_finding(sv_robot* robot, int32_t finding, int32_t joint, int32_t address, int32_t value) {
  const int32_t numbers[] = {finding, joint, address, value};
  sv_tell(robot, SV_RECORD_FINDING, numbers, 4);
}

void sv_log_cycle(sv_robot* robot, int32_t k) {
  const sv_period* done = &robot->done;
  const sv_rig* rig = SV_RIG(robot);
  const sv_program* program = servolve_cycle.program;
  uint32_t missed = 0;
  for (int32_t i = 0; i < rig->njoint; i++) {
    missed |= (uint32_t)(robot->replies[i].status != SV_REPLY_DATA) << i;
  }

  const int32_t numbers[] = {k,
                             (int32_t)(done->started_us - robot->begin_us),
                             (int32_t)(done->read_us - done->started_us),
                             (int32_t)(done->aimed_us - done->read_us),
                             done->sent ? (int32_t)(done->ended_us - done->aimed_us) : -1,
                             (int32_t)missed};

  sv_record record;
  sv_begin(robot, &record, SV_RECORD_CYCLE, done->started_us);
  sv_put(&record, numbers, 6);
  sv_put(&record, robot->raw, servolve_cycle.nraw);
  // ages when the cycle ran
  for (int32_t i = 0; i < rig->njoint; i++) {
    sv_record_varint(&record, sv_joint_age_us(robot, i, done->read_us));
  }
  for (int32_t i = 0; i < rig->nsensor; i++) {
    sv_record_varint(&record, sv_lines_age_us(&robot->lines, rig, i, done->read_us));
  }
  sv_put_floats(&record, robot->terminals, program->ninput);
  sv_put_floats(&record, robot->outputs, program->noutput);
  sv_put(&record, done->aimed, program->noutput);
  sv_send(robot, &record);
}

void sv_log_block(sv_robot* robot, int32_t type, int32_t joint, const sv_block* block, const uint8_t* data) {
  const int32_t numbers[] = {joint, block->address, block->size};
  sv_record record;
  sv_begin(robot, &record, type, sv_hal_now_us());
  sv_put(&record, numbers, 3);
  for (int32_t i = 0; i < block->size; i++) {
    sv_record_u8(&record, data[i]);
  }
  sv_send(robot, &record);
}

void sv_log_event(sv_robot* robot, int32_t event, int32_t a) {
  const int32_t numbers[] = {event, a};
  sv_tell(robot, SV_RECORD_EVENT, numbers, 2);
}

void sv_log_end(sv_robot* robot, uint32_t unsure) {
  const sv_why* why = &robot->watch.why;
  const sv_counts* counts = &robot->counts;
  const int32_t numbers[] = {robot->state,
                             why->reason,
                             why->joint,
                             why->a,
                             why->b,
                             counts->cycles,
                             counts->missed_deadlines,
                             counts->missed_replies,
                             (int32_t)robot->bus.nbyte,
                             (int32_t)counts->dropped,
                             (int32_t)unsure};
  sv_tell(robot, SV_RECORD_END, numbers, 11);
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
