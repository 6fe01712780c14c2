#include "sv_period.h"

#include "sv_bus_line.h"
#include "sv_console.h"
#include "sv_guard.h"
#include "sv_hal.h"
#include "sv_home.h"
#include "sv_io.h"
#include "sv_time.h"

void sv_wait_until(sv_robot* robot, uint32_t until_us) {
  sv_console_listen(robot);
  while (!sv_has_come(sv_hal_now_us(), until_us)) {
    sv_doze(until_us);
    sv_console_listen(robot);
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

// A period that is more than one period late makes all later ones late by whole periods: no catching up.
static void sv_await_period(sv_robot* robot) {
  const int32_t period_us = SV_RIG(robot)->period_us;
  robot->begin_us += (uint32_t)period_us;
  const int32_t behind_us = (int32_t)(sv_hal_now_us() - robot->begin_us);
  if (behind_us > period_us) {
    robot->begin_us += (uint32_t)(behind_us / period_us * period_us);
  }
  sv_wait_until(robot, robot->begin_us);
}

static void sv_aim(sv_robot* robot, int32_t k, int32_t* goals) {
  if (robot->state != SV_STATE_RUNNING) {
    sv_home_goals(robot, k, goals);
    return;
  }
  sv_cycle_step(&servolve_cycle, &robot->wish.goal, &robot->cycle, robot->registers, robot->memory, robot->raw,
                robot->terminals, robot->outputs, goals);
}

// Do one thing that is due, unless a fault keeps it from being done; return whether it shows a fault.
static int32_t sv_do(sv_robot* robot, int32_t k, const sv_transaction* due, int32_t faulty) {
  sv_period* done = &robot->done;
  switch (due->kind) {
    case SV_READ_STATE:
      sv_read_servos(robot, due->block);
      sv_read_sensors(robot);
      done->read_us = sv_hal_now_us();
      return 0;
    case SV_RUN_CYCLE:
      sv_aim(robot, k, done->aimed);
      done->aimed_us = sv_hal_now_us();
      return !faulty && sv_judge_period(robot);
    case SV_WRITE_GOALS:
      done->sent = !faulty && !sv_judge_goals(SV_RIG(robot), &robot->watch, robot->state == SV_STATE_RUNNING,
                                              robot->goals, done->aimed);
      if (done->sent) {
        sv_write_goals(robot, due->block, done->aimed);
      }
      done->ended_us = sv_hal_now_us();
      return !done->sent;
    default:
      return !faulty && sv_look_after_health(robot, due->servo, due->block);
  }
}

int32_t sv_walk(sv_robot* robot, int32_t k) {
  sv_period* done = &robot->done;
  sv_transaction due;
  sv_await_period(robot);
  done->started_us = sv_hal_now_us();
  int32_t faulty = sv_stalled(robot, done->started_us);
  for (int32_t i = 0; sv_schedule_due(&servolve_schedule, k, i, &due); i++) {
    faulty = sv_do(robot, k, &due, faulty) || faulty;
  }
  robot->ended_us = sv_hal_now_us();
  done->overran = robot->ended_us - robot->begin_us > (uint32_t)SV_RIG(robot)->period_us;
  return faulty || sv_judge_timing(SV_RIG(robot), &robot->watch, done->overran);
}
