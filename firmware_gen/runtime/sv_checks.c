#include "sv_checks.h"

#include "sv_hal.h"
#include "sv_io.h"
#include "sv_log.h"
#include "sv_period.h"
#include "sv_record.h"

#define SV_ATTEMPTS 3
#define SV_PATIENCE_US 100000  // for a servo that may only be slow
#define SV_LATE_US_MAX 3000
#define SV_DELAY_US_MAX 508  // the longest that a servo can be set to wait before it answers
#define SV_LISTEN_STEPS 30
#define SV_LISTEN_STEP_US 10000U

typedef struct {
  uint8_t bytes[2][SV_BLOCK_MAX];
} sv_tables;

// Tell of a finding; the first error ends the run, and the others are counted.
static void sv_find(sv_robot* robot, int32_t finding, int32_t joint, int32_t address, int32_t value) {
  sv_why* why = &robot->watch.why;
  sv_log_finding(robot, finding, joint, address, value);
  if (finding >= SV_FINDING_TORQUE) {
    return;  // a warning
  }
  if (why->reason != SV_REASON_NONE) {
    why->a++;
    return;
  }
  (void)sv_because(&robot->watch, SV_REASON_FINDING, joint, 0, 0);
}

static int32_t sv_ping(sv_robot* robot, int32_t joint, uint16_t* model) {
  sv_hal_feed_watchdog();
  return sv_bus_ping(&robot->bus, joint, model);
}

// Ask once more and wait for long; return how long the answer took, -1 if there is none [us].
static int32_t sv_patient_ping_us(sv_robot* robot, int32_t joint) {
  uint16_t model;
  const uint32_t asked_us = sv_hal_now_us();
  robot->bus.patience_us = SV_PATIENCE_US;
  const int32_t status = sv_ping(robot, joint, &model);
  robot->bus.patience_us = SV_RIG(robot)->patience_us;
  return status == SV_REPLY_DATA ? (int32_t)(robot->bus.reply.t_us - asked_us) : -1;
}

// Return whether the right servo is there.
static int32_t sv_is_there(sv_robot* robot, int32_t joint) {
  uint16_t model = 0;
  int32_t status = SV_REPLY_MISSING;
  for (int32_t i = 0; i < SV_ATTEMPTS && status != SV_REPLY_DATA; i++) {
    status = sv_ping(robot, joint, &model);
  }
  if (status == SV_REPLY_DATA) {
    const int32_t right = model == SV_SERVO(SV_RIG(robot), joint)->model;
    if (!right) {
      sv_find(robot, SV_FINDING_MODEL, joint, 0, model);
    }
    return right;
  }
  const int32_t slow_us = status == SV_REPLY_MISSING ? sv_patient_ping_us(robot, joint) : -1;
  const int32_t silent = status == SV_REPLY_MISSING ? SV_FINDING_ABSENT : SV_FINDING_CORRUPT;
  sv_find(robot, slow_us < 0 ? silent : SV_FINDING_LATE, joint, 0, slow_us);
  return 0;
}

// Return how long an answer took beyond what line and servo need [us].
static int32_t sv_waited_us(const sv_rig* rig, const sv_reply* reply, uint32_t asked_us, int32_t size) {
  const uint32_t around = SV_PROTOCOL(rig) == SV_DYNAMIXEL2 ? 22U : 12U;  // of question and answer
  const uint32_t line_us = (around + (uint32_t)size) * 10000000U / (uint32_t)rig->baud;
  return (int32_t)(reply->t_us - asked_us) - SV_DELAY_US_MAX - (int32_t)line_us;
}

// Read the tables of one servo: => tables, shortest wait beyond what line and servo need; return whether that went
// well.
static int32_t sv_read_tables(sv_robot* robot, int32_t joint, sv_tables* tables, int32_t* shortest_us) {
  for (int32_t n = 0; n < 2; n++) {
    const sv_block* block = SV_SERVO(SV_RIG(robot), joint)->tables + n;
    const uint32_t asked_us = sv_hal_now_us();
    sv_hal_feed_watchdog();
    int32_t status = sv_bus_read(&robot->bus, joint, block->address, block->size, tables->bytes[n]);
    if (status == SV_REPLY_DATA) {
      const int32_t waited_us = sv_waited_us(SV_RIG(robot), &robot->bus.reply, asked_us, block->size);
      *shortest_us = waited_us < *shortest_us ? waited_us : *shortest_us;
    }
    for (int32_t i = 1; i < SV_ATTEMPTS && status != SV_REPLY_DATA; i++) {
      status = sv_bus_read(&robot->bus, joint, block->address, block->size, tables->bytes[n]);
    }
    if (status != SV_REPLY_DATA) {
      sv_find(robot, status == SV_REPLY_CORRUPT ? SV_FINDING_GARBLED : SV_FINDING_UNREADABLE, joint, block->address,
              block->size);
      return 0;
    }
    sv_log_block(robot, SV_RECORD_READING, joint, block, tables->bytes[n]);
  }
  return 1;
}

// Return the count of a register in the tables, -1 where they do not hold it.
static int32_t sv_held(const sv_servo* servo, const sv_tables* tables, const sv_register* reg) {
  int32_t count = -1;
  for (int32_t n = 0; n < 2; n++) {
    (void)sv_in_block(servo->tables + n, tables->bytes[n], reg, &count);
  }
  return count;
}

// Compare one servo's registers with their rows.
static void sv_compare(sv_robot* robot, int32_t number, const sv_tables* tables) {
  const sv_servo* servo = SV_SERVO(SV_RIG(robot), number);
  const sv_joint* joint = SV_RIG(robot)->joints + number;
  for (int32_t i = 0; i < servo->ncheck; i++) {
    const sv_check* check = servo->checks + i;
    const int32_t held = sv_held(servo, tables, &check->reg);
    const int32_t meant = check->mask == 0 ? held : (int32_t)((uint32_t)held & check->mask);
    int32_t low = check->low;
    int32_t high = check->high;
    if (check->kind == SV_FINDING_POSITION) {
      low = joint->place_low;
      high = joint->place_high;
    } else if (check->kind == SV_FINDING_LOW_LIMIT) {
      high = joint->goal_low;
    } else if (check->kind == SV_FINDING_HIGH_LIMIT) {
      low = joint->goal_high;
      high = INT32_MAX;
    }
    if (meant < low || meant > high) {
      sv_find(robot, check->kind, number, check->reg.address, held);
    }
  }
}

// Tell of servos that nothing stops if this board dies.
static void sv_check_watchdogs(sv_robot* robot) {
  for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
    if (SV_SERVO(SV_RIG(robot), i)->watchdog.size == 0) {
      sv_find(robot, SV_FINDING_WATCHDOG, i, 0, 0);
      return;
    }
  }
}

static void sv_check_servos(sv_robot* robot) {
  sv_tables tables;
  int32_t shortest_us = INT32_MAX;
  for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
    if (sv_is_there(robot, i) && sv_read_tables(robot, i, &tables, &shortest_us)) {
      sv_compare(robot, i, &tables);
    }
  }
  if (shortest_us > SV_LATE_US_MAX && shortest_us < INT32_MAX) {
    sv_find(robot, SV_FINDING_SLOW, SV_NOBODY, 0, shortest_us);
  }
  sv_check_watchdogs(robot);
}

// Listen for a while, then compare what the sensor node has sent with what the rig promises.
static void sv_check_sensors(sv_robot* robot) {
  const sv_rig* rig = SV_RIG(robot);
  for (int32_t i = 0; i < SV_LISTEN_STEPS && rig->nsensor > 0; i++) {
    sv_wait_until(robot, sv_hal_now_us() + SV_LISTEN_STEP_US);
    sv_read_sensors(robot);
  }
  for (int32_t i = 0; i < rig->nsensor; i++) {
    const int32_t age_us = sv_lines_age_us(&robot->lines, SV_RIG(robot), i, sv_hal_now_us());
    const sv_sensor* sensor = rig->sensors + i;
    if (!sv_is_fresh(sensor, age_us)) {
      sv_find(robot, sensor->needed ? SV_FINDING_SENSOR : SV_FINDING_OLD, i, 0, age_us);
    }
  }
}

// Object to a derated run of servos that have no torque ceiling to lower.
static void sv_check_derating(sv_robot* robot) {
  for (int32_t i = 0; i < SV_RIG(robot)->njoint && robot->wish.derate < 1.0F; i++) {
    if (SV_SERVO(SV_RIG(robot), i)->ceiling.size == 0) {
      sv_find(robot, SV_FINDING_DERATE, i, 0, 0);
      return;
    }
  }
}

int32_t sv_check_rig(sv_robot* robot) {
  sv_check_servos(robot);
  sv_check_sensors(robot);
  sv_check_derating(robot);
  return sv_heed_stop(robot) || robot->watch.why.reason != SV_REASON_NONE;
}
