// What a rollout sees of a state, and what it remembers of a run.

#ifndef SIM_MODELS_NATIVE_OBSERVE_H_
#define SIM_MODELS_NATIVE_OBSERVE_H_

#include "rollout.h"

typedef struct {     // the base as an ideal camera and load cell see it
  double x, y, z;    // [m]
  double v[3];       // velocity, in the world's frame [m/s]
  double r[9];       // rotation from the base's frame to the world's, row by row
  double clearance;  // of the lowest foot [m]
  double force;      // sum of the normal contact forces on the base [N]
} sv_view;

typedef struct {  // running values of the statistics
  double goal_x, goal_y;
  double last_x, last_y, last_clearance;
  double last_angle[SV_JOINT_MAX];
  double speed[SV_GOAL_RING];
  double lowest_up;  // smallest cosine of the tilt
  int32_t airborne;
  int32_t idle;          // control instants so far at which the base stood
  int32_t idle_arrived;  // the same before arrive_step
} sv_record;

// (qpos, qvel) => pose, velocity and clearance of the base; force is left alone.
void sv_observe(const sv_rollout_setup* setup, const mjData* d, sv_view* view);

// Return one of the quantities that a sensor shows: angles about z, y, x in this order, velocities along the heading,
// to its left and up.
double sv_quantity(const sv_view* view, sv_sensor sensor);

// Return the sum of the normal forces of the base's contacts, of the state before the last mj_step.
double sv_base_force(const sv_rollout_setup* setup, const mjModel* m, const mjData* d);

// Return distance along the heading, goal - base [m].
double sv_px(const sv_record* record, const sv_view* view);

// Start the statistics of a run whose goal is fixed by its first view.
void sv_statistics_begin(const sv_rollout_setup* setup, const sv_goal* goal, const mjData* d, const sv_view* view,
                         sv_record* record, sv_statistics* statistics);

// Take the state at control instant k into the statistics.
void sv_statistics_observe(const sv_rollout_setup* setup, const mjData* d, const sv_view* view, int32_t k,
                           sv_record* record, sv_statistics* statistics);

// Finish the statistics with the state at control instant k, the last one seen.
void sv_statistics_end(const sv_rollout_setup* setup, const mjData* d, const sv_view* view, int32_t k,
                       const sv_record* record, sv_statistics* statistics);

#endif  // SIM_MODELS_NATIVE_OBSERVE_H_
