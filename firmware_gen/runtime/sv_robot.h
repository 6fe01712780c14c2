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
#include "sv_cycle.h"
#include "sv_lines.h"
#include "sv_reason.h"
#include "sv_rig.h"
#include "sv_safety.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_COMMAND_MAX 40  // characters of a command

// What a run is asked to do; commands set it.
typedef struct {
  sv_goal goal;
  int32_t periods;  // length of the run
  float derate;     // part of the torque ceiling that is allowed, in (0, 1]
  uint8_t arm;      // whether torque may be switched on, for one run
  uint8_t start;    // whether to run
  uint8_t stop;     // why a person wants the run to stop: sv_reason
} sv_wish;

typedef struct {
  int32_t cycles;
  int32_t missed_deadlines;
  int32_t missed_replies;
  uint32_t dropped;  // records that did not fit the console's line
} sv_counts;

// What happened in one period.
typedef struct {
  uint32_t started_us;
  uint32_t read_us;              // when everything had been read
  uint32_t aimed_us;             // when the goals were known
  uint32_t ended_us;             // when they had been written
  int32_t sent;                  // whether they were
  int32_t overran;               // whether it was not done in its time
  int32_t aimed[SV_OUTPUT_MAX];  // goals [counts]
} sv_period;

typedef struct {
  const sv_rig* rig;
  float* registers;  // the controller's memory
  float* memory;
  uint8_t state;    // sv_state
  uint8_t closed;   // whether the start input was active when last looked at
  uint8_t pressed;  // whether it was when it had last been steady
  uint8_t holding;  // whether a run has left torque on and none has taken it since: a stop does
  uint8_t ncommand;
  uint32_t turned_us;  // when `closed` last changed
  sv_wish wish;
  sv_counts counts;
  uint32_t program;             // its fingerprint
  int32_t selftest;             // what the controller's has returned
  uint32_t begin_us;            // of this period
  uint32_t ended_us;            // of the last one's traffic
  int64_t log_us;               // the log's clock, which does not begin anew: see sv_log_time
  int32_t nmove;                // periods of its move
  sv_period done;               // this period
  int32_t goals[SV_JOINT_MAX];  // in force [counts]
  int32_t raw[SV_RAW_MAX];
  sv_reply replies[SV_JOINT_MAX];      // of this period
  uint32_t answered;                   // which joints ever have, a bit each,
  uint32_t answered_us[SV_JOINT_MAX];  // and when last
  int32_t from[SV_JOINT_MAX];          // where homing begins [counts]
  sv_cycle_state cycle;
  float terminals[SV_INPUT_MAX];
  float outputs[SV_OUTPUT_MAX];
  char command[SV_COMMAND_MAX];
  sv_watch watch;
  sv_lines lines;
  sv_bus bus;
} sv_robot;

// Set up, with what the controller's selftest returned, its fingerprint and its memory: take the torque of every servo
// without waiting for anybody, say hello on the console; after a reset by watchdog or fault handler, see that it is
// off.
void sv_robot_init(sv_robot* robot, const sv_rig* rig, int32_t selftest, uint32_t program, float* registers,
                   float* memory);

// Take what has come from the console, and make the run that it starts: returns when that has ended, with torque off.
void sv_robot_poll(sv_robot* robot);

// Send torque off to every servo of the project's rig without reading anything: for fault handlers and the watchdog's
// warning. Reentrant.
void sv_robot_panic(void);

#ifdef __cplusplus
}
#endif

#endif  // SV_ROBOT_H_
