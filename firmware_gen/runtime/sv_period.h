// One period of a run: wait for its time, then read, aim, judge, write in the schedule's order.
//
// Homing and running differ only in who aims. The same as the host loop's (deploy/period.py).

#ifndef SV_PERIOD_H_
#define SV_PERIOD_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// What happened in one period.
typedef struct {
  int64_t started_us;
  int64_t read_us;               // when everything had been read
  int64_t aimed_us;              // when the goals were known
  int64_t ended_us;              // when they had been written
  int32_t sent;                  // whether they were
  int32_t overran;               // whether it was not done in its time
  int32_t aimed[SV_OUTPUT_MAX];  // goals [counts]
} sv_period;

// Sleep until a time; hear meanwhile that a person wants the run to stop.
void sv_wait_until(sv_robot* robot, int64_t until_us);

// Return whether a person wants the run to stop: => why.
int32_t sv_heed_stop(sv_robot* robot);

// End the run for a reason that is about nobody; return 1.
int32_t sv_end(sv_robot* robot, int32_t reason);

// Forget what a run before this one has read.
void sv_forget(sv_robot* robot);

// Take the lines that have come from the sensor node.
void sv_read_sensors(sv_robot* robot);

// Wait for the next period's time and do what is due in period k; a fault keeps the goals from being written. Return
// whether there was one.
int32_t sv_walk(sv_robot* robot, int32_t k, sv_period* done);

// Return whether every sensor that is needed is fresh.
int32_t sv_sensors_fresh(const sv_robot* robot);

#ifdef __cplusplus
}
#endif

#endif  // SV_PERIOD_H_
