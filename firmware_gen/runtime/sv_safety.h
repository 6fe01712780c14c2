// When a run must stop: isolated glitches ride through, persistent ones stop.
//
// Each sv_judge_… looks at one thing for one period, keeps its count in the watch, and returns whether that ends the
// run; the watch then holds why. The same rules as the host loop's (deploy/safety.py).

#ifndef SV_SAFETY_H_
#define SV_SAFETY_H_

#include <stdint.h>

#include "sv_bus.h"
#include "sv_reason.h"
#include "sv_rig.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_NOBODY 255  // number of no joint

// Why a run goes on, stops, or must stop.
typedef struct {
  int32_t reason;  // sv_reason
  int32_t joint;   // or sensor; SV_NOBODY: none
  int32_t a;       // see sv_reason.h
  int32_t b;
} sv_why;

// What has lasted, by joint.
typedef struct {
  int32_t missed;         // periods in a row without a valid reply
  int32_t poor;           // how many more periods lately were without one than with one
  int32_t alerted;        // replies in a row that reported a hardware error
  int32_t jumped;         // angles in a row that it can not have
  int32_t hot;            // readings in a row above the limit
  int32_t low;            // readings in a row below the limit
  uint8_t seen;           // whether it has ever been seen where it can have been,
  uint8_t off_track;      // whether it does not do what its goals say,
  int32_t believed;       // where last [counts],
  uint32_t believed_us;   // and when
  uint32_t off_track_us;  // since when
} sv_watch_joint;

typedef struct {
  sv_watch_joint joints[SV_JOINT_MAX];
  int32_t stale[SV_SENSOR_MAX];  // periods in a row with an old value
  int32_t tilted;                // periods in a row with too much tilt
  int32_t overruns;              // periods in a row that were not done in time
  sv_why why;                    // the run has ended; SV_REASON_NONE: it has not
} sv_watch;

// Hold a reason with what it is about; return 1: the run has ended. So many places call it that copies cost too much.
__attribute__((noinline)) int32_t sv_because(sv_watch* watch, int32_t reason, int32_t joint, int32_t a, int32_t b);

// Count from 0.
void sv_watch_init(sv_watch* watch);

// Stop when one servo has been silent for too many periods, or in most of them: replies (njoint).
int32_t sv_judge_replies(const sv_rig* rig, sv_watch* watch, const sv_reply* replies);

// Return whether to look into what a servo reports: at once, but for a voltage that may be back in a moment.
int32_t sv_judge_alert(const sv_rig* rig, sv_watch* watch, int32_t joint, const sv_reply* reply);

// Stop when a servo reports a hardware error; shutdown -1: unknown.
int32_t sv_judge_hardware_error(const sv_rig* rig, sv_watch* watch, int32_t joint, int32_t status, int32_t shutdown);

// Stop when a servo that should move has no torque.
int32_t sv_judge_torque(sv_watch* watch, int32_t joint, int32_t torque);

// Stop when a sensor that is needed has been old for too many periods: ages_us (nsensor), < 0: never read.
int32_t sv_judge_sensors(const sv_rig* rig, sv_watch* watch, const int32_t* ages_us);

// Stop when an angle has jumped farther than its servo can turn: asked at asked_us or later and read by now_us, replies
// (njoint), encoder counts (njoint).
int32_t sv_judge_encoders(const sv_rig* rig, sv_watch* watch, uint32_t asked_us, uint32_t now_us,
                          const sv_reply* replies, const int32_t* counts);

// Stop when a joint has been far from its goal for too long: goals and encoder counts (njoint).
int32_t sv_judge_tracking(const sv_rig* rig, sv_watch* watch, uint32_t now_us, const int32_t* goals,
                          const int32_t* counts);

// Stop when a joint that is driven by its speed hardly moves, or runs the other way, or is beyond its limits: goals and
// speeds [velocity counts], encoder counts (njoint).
int32_t sv_judge_speeds(const sv_rig* rig, sv_watch* watch, uint32_t now_us, const int32_t* goals,
                        const int32_t* speeds, const int32_t* counts);

// Stop when the base has fallen over: counts of a rig's sensors for roll and pitch.
int32_t sv_judge_tilt(const sv_rig* rig, sv_watch* watch, int32_t roll, int32_t pitch);

// Stop when a servo is too hot or its supply too low: register counts.
int32_t sv_judge_health(const sv_rig* rig, sv_watch* watch, int32_t joint, int32_t voltage, int32_t temperature);

// Stop when too many periods in a row were not done in time.
int32_t sv_judge_timing(const sv_rig* rig, sv_watch* watch, int32_t overran);

// Take a last look at limits and rate, which those who aim should have kept: goals in force and new ones (njoint).
int32_t sv_judge_goals(const sv_rig* rig, sv_watch* watch, int32_t running, const int32_t* last, const int32_t* goals);

#ifdef __cplusplus
}
#endif

#endif  // SV_SAFETY_H_
