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

// Sleep until a time; hear meanwhile that a person wants the run to stop.
void sv_wait_until(sv_robot* robot, uint32_t until_us);

// Return whether a person wants the run to stop: => why.
int32_t sv_heed_stop(sv_robot* robot);

// End the run for a reason that is about nobody; return 1.
int32_t sv_end(sv_robot* robot, int32_t reason);

// Wait for the next period's time and do what is due in period k; a fault keeps the goals from being written. Return
// whether there was one: => done.
int32_t sv_walk(sv_robot* robot, int32_t k);

#ifdef __cplusplus
}
#endif

#endif  // SV_PERIOD_H_
