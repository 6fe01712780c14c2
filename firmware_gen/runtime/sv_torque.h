// Give torque and take it: settings first, goals where the joints stand, and off for every servo whatever happens.
//
// Each returns whether the run has ended, as a servo did not take what it was given: => why. The same transactions as
// the host loop's (deploy/torque.py).

#ifndef SV_TORQUE_H_
#define SV_TORQUE_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// Write gains, torque ceiling and what else the loop needs of every servo, and read it back. RAM only.
int32_t sv_write_settings(sv_robot* robot);

// Set every goal to where its joint stands, or to rest, so that torque moves nothing.
int32_t sv_seed_goals(sv_robot* robot);

// Switch every servo's torque on, then arm its bus watchdog if it has one.
int32_t sv_torque_on(sv_robot* robot);

// Switch every servo's torque off and read it back, for a second at the longest; return the joints whose torque is not
// known to be off, a bit each.
uint32_t sv_release(sv_robot* robot);

// Leave every servo holding its last goal, or at rest, with nobody on the bus.
int32_t sv_hold(sv_robot* robot);

#ifdef __cplusplus
}
#endif

#endif  // SV_TORQUE_H_
