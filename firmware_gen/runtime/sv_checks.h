// Check the rig before anything is written to it: every register that matters is read and compared with its row.
//
// The same questions as the host loop's (deploy/checks.py).

#ifndef SV_CHECKS_H_
#define SV_CHECKS_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// Read everything, write nothing; return whether anything forbids to arm, or a person wants to stop: => why.
int32_t sv_check_rig(sv_robot* robot);

#ifdef __cplusplus
}
#endif

#endif  // SV_CHECKS_H_
