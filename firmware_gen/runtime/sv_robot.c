#include "sv_robot.h"

#include "sv_checks.h"
#include "sv_console.h"
#include "sv_hal.h"
#include "sv_home.h"
#include "sv_io.h"
#include "sv_log.h"
#include "sv_period.h"
#include "sv_torque.h"

#define SV_IDLE_US 10000U
#define SV_SECONDS 10  // length of a run, if nobody says another

static int32_t sv_is_fault(const sv_robot* robot) { return robot->watch.why.reason >= SV_REASON_FINDING; }

static void sv_enter_because(sv_robot* robot, int32_t state, const sv_why* why) {
  const int32_t left = robot->state;
  robot->state = (uint8_t)state;
  sv_log_state(robot, left, why);
}

static void sv_enter(sv_robot* robot, int32_t state, int32_t reason) {
  const sv_why why = {reason, SV_NOBODY, 0, 0};
  sv_enter_because(robot, state, &why);
}

// Enter a state because the run has ended.
static void sv_enter_after(sv_robot* robot, int32_t state) { sv_enter_because(robot, state, &robot->watch.why); }

// Write settings and seed the goals; then torque on.
static int32_t sv_arm(sv_robot* robot) {
  if (sv_write_settings(robot) || sv_heed_stop(robot) || sv_seed_goals(robot)) {
    return 1;
  }
  sv_enter(robot, SV_STATE_ARMED, SV_REASON_WRITTEN);
  return sv_torque_on(robot);
}

// Step the controller until the time is over.
static void sv_control(sv_robot* robot) {
  sv_cycle_reset(&servolve_cycle, &robot->cycle, robot->registers, robot->memory);
  // the cycle's slew starts at rest, at whatever speed homing ended
  for (int32_t i = 0; i < SV_RIG(robot)->njoint && SV_VELOCITY_MODE(SV_RIG(robot)); i++) {
    robot->goals[i] = 0;
  }
  sv_enter(robot, SV_STATE_RUNNING, SV_REASON_RESTED);
  for (int32_t k = 0; k < robot->wish.periods; k++) {
    const int32_t faulty = sv_walk(robot, k);
    sv_log_cycle(robot, k);
    robot->counts.cycles = k + 1;
    robot->counts.missed_deadlines += robot->done.overran;
    for (int32_t i = 0; i < SV_RIG(robot)->njoint; i++) {
      robot->counts.missed_replies += robot->replies[i].status != SV_REPLY_DATA;
    }
    if (faulty || sv_heed_stop(robot)) {
      return;
    }
  }
  // the end of the last period
  sv_wait_until(robot, robot->begin_us + (uint32_t)SV_RIG(robot)->period_us);
  sv_read_sensors(robot);
  if (!sv_heed_stop(robot)) {
    (void)sv_end(robot, SV_REASON_TIME);
  }
}

// Go through the states until something ends the run; return whether anything may have been written.
static int32_t sv_go(sv_robot* robot) {
  if (robot->selftest != 0) {
    (void)sv_because(&robot->watch, SV_REASON_SELFTEST, SV_NOBODY, robot->selftest, 0);
    return 0;
  }
  if (sv_check_rig(robot)) {
    return 0;
  }
  sv_enter(robot, SV_STATE_CHECKED, SV_REASON_WELL);
  if (!robot->wish.arm) {
    (void)sv_end(robot, SV_REASON_DRY_RUN);
    return 0;
  }
  if (!sv_arm(robot)) {
    sv_enter(robot, SV_STATE_HOMING, SV_REASON_TORQUE_ON);
    if (!sv_home(robot)) {
      sv_control(robot);
    }
  }
  return 1;
}

// Take torque from every servo; return who is unsure.
static uint32_t sv_let_go(sv_robot* robot) {
  const uint32_t unsure = sv_release(robot);
  sv_log_event(robot, unsure != 0U ? SV_EVENT_UNSURE : SV_EVENT_RELEASED, (int32_t)unsure);
  return unsure;
}

// Take torque from every servo, or hand it over to hold after a run that was done; return who is unsure.
static uint32_t sv_unload(sv_robot* robot) {
  if (robot->watch.why.reason == SV_REASON_TIME && SV_RIG(robot)->safety.stop_holds && !sv_hold(robot)) {
    sv_log_event(robot, SV_EVENT_HELD, 0);
    robot->holding = 1;
    return 0;
  }
  return sv_let_go(robot);
}

// End a run, or what a reset has left of one.
static void sv_leave(sv_robot* robot, int32_t touched) {
  uint32_t unsure = 0;
  if (sv_is_fault(robot)) {
    sv_enter_after(robot, SV_STATE_FAULT);
  } else if (robot->state != SV_STATE_OFF && robot->state != SV_STATE_CHECKED) {
    sv_enter_after(robot, SV_STATE_STOPPING);
  }
  if (touched) {
    robot->holding = 0;
    unsure = sv_unload(robot);
  }
  if (unsure != 0U && !sv_is_fault(robot)) {
    (void)sv_because(&robot->watch, SV_REASON_TORQUE_UNSURE, SV_NOBODY, (int32_t)unsure, 0);
  }
  if (sv_is_fault(robot) && robot->state != SV_STATE_FAULT) {
    sv_enter_after(robot, SV_STATE_FAULT);
  } else if (robot->state == SV_STATE_STOPPING || robot->state == SV_STATE_CHECKED) {
    sv_enter_after(robot, SV_STATE_OFF);
  }
  sv_log_end(robot, unsure);
}

// A fault is left by starting again.
static void sv_begin_run(sv_robot* robot) {
  const sv_counts none = {0, 0, 0, 0};
  robot->state = SV_STATE_OFF;
  robot->counts = none;
  sv_forget(robot);
  sv_log_start(robot);
}

void sv_robot_poll(sv_robot* robot) {
  sv_hal_feed_watchdog();
  sv_log_time(robot, sv_hal_now_us());
  sv_console_listen(robot);
  if (!robot->wish.start) {
    if (robot->holding && robot->wish.stop != SV_REASON_NONE) {
      robot->holding = 0;
      (void)sv_let_go(robot);
    }
    robot->wish.stop = SV_REASON_NONE;
    sv_drop_sensors(robot);
    sv_hal_wait(sv_hal_now_us() + SV_IDLE_US);
    return;
  }
  sv_begin_run(robot);
  sv_leave(robot, sv_go(robot));
  robot->wish.arm = 0;
  robot->wish.start = 0;
  sv_print(sv_is_fault(robot) ? "fault" : "ended by");
  sv_print_number(robot->watch.why.reason);
  sv_print("\r\n");
}

void sv_robot_init(sv_robot* robot, const sv_rig* rig, int32_t selftest, uint32_t program, float* registers,
                   float* memory) {
  const sv_wish wish = {{0.0F, 0.0F}, SV_SECONDS * 1000000 / rig->period_us, 1.0F, 0, 0, SV_REASON_NONE};
  const sv_counts none = {0, 0, 0, 0};
  const int32_t cause = sv_hal_reset_cause();
  SV_SET_RIG(robot, rig);
  robot->program = program;
  robot->selftest = selftest;
  robot->registers = registers;
  robot->memory = memory;
  robot->log_us = sv_hal_now_us();
  robot->state = SV_STATE_OFF;
  robot->closed = 1;
  robot->pressed = 1;
  robot->holding = 0;
  robot->ncommand = 0;
  robot->wish = wish;
  robot->counts = none;
  sv_forget(robot);
  // whatever has reset the board, servos may bear the torque of a run that nobody ends any more
  sv_robot_panic();
  sv_log_hello(robot);
  if (cause != SV_RESET_POWER) {
    (void)sv_because(&robot->watch, SV_REASON_RESET, SV_NOBODY, cause, 0);
    sv_leave(robot, 1);
  }
  sv_print("servolve: try help\r\n");
}

// values (njoint, size) of zeros => a packet to every servo
static void sv_zero_all(const sv_rig* rig, const sv_register* reg) {
  const uint8_t zeros[SV_JOINT_MAX * 4] = {0};
  uint8_t frame[SV_FRAME_MAX];
  const int32_t n = sv_bus_sync_write_frame(rig, reg->address, reg->size, zeros, frame);
  (void)sv_hal_write(SV_LINE_BUS, frame, n);
}

void sv_robot_panic(void) {
  const sv_rig* rig = &servolve_rig;
  if (SV_VELOCITY_MODE(rig)) {
    sv_zero_all(rig, &SV_SERVO(rig, 0)->goal);
  }
  sv_zero_all(rig, &SV_SERVO(rig, 0)->torque);
}
