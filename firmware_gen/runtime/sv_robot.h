// The robot: the states of a run and all that happens in them, from torque off to torque off.
//
//   off -> checked -> armed -> homing -> running -> stopping -> off, and fault
//
// The same states, transactions and rules, in the same order and at the same times, as the host loop
// (deploy/host_loop.py). A board's main calls sv_robot_init once and sv_robot_poll for ever.

#ifndef SV_ROBOT_H_
#define SV_ROBOT_H_

#include <stdint.h>

#include "sv_bus.h"
#include "sv_lines.h"
#include "sv_reason.h"
#include "sv_record.h"
#include "sv_rig.h"
#include "sv_safety.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_COMMAND_MAX 64  // characters of a command

// What a run is asked to do; commands set it.
typedef struct {
  sv_goal goal;
  int32_t periods;  // length of the run
  float derate;     // part of the torque ceiling that is allowed, in (0, 1]
  uint8_t arm;      // whether torque may be switched on, for one run
} sv_wish;

typedef struct {
  const sv_rig* rig;
  int32_t (*selftest)(void);  // the controller's
  uint32_t program;           // its fingerprint
  sv_bus bus;
  sv_lines lines;
  sv_watch watch;
  sv_wish wish;
  int32_t state;  // sv_state
  int32_t raw[SV_RAW_MAX];
  int64_t answered_us[SV_JOINT_MAX];  // when each joint last answered; < 0: never
  sv_reply replies[SV_JOINT_MAX];
  int32_t goals[SV_JOINT_MAX];  // in force [counts]
  int64_t begin_us;             // of this period
  int64_t ended_us;             // of the last one's bus traffic
  sv_cycle_state cycle;
  float* registers;  // the controller's memory, from the board's main
  float* program_state;
  float terminals[SV_INPUT_MAX];
  float outputs[SV_OUTPUT_MAX];
  char command[SV_COMMAND_MAX];
  int32_t ncommand;
  uint8_t stop;      // a person wants the run to stop: sv_reason
  uint32_t dropped;  // records that did not fit
  int32_t cycles;
  int32_t missed_deadlines;
  int32_t missed_replies;
} sv_robot;

// Set up; say hello on the console; after a reset by watchdog or fault handler, first take the torque of every servo.
void sv_robot_init(sv_robot* robot, const sv_rig* rig, int32_t (*selftest)(void), uint32_t program, float* registers,
                   float* program_state);

// Take what has come from the console, and make the run that it starts: returns when that has ended, with torque off.
void sv_robot_poll(sv_robot* robot);

// Send torque off to every servo without reading anything: for fault handlers and the watchdog's warning. Reentrant.
void sv_robot_panic(const sv_rig* rig);

#ifdef __cplusplus
}
#endif

#endif  // SV_ROBOT_H_
