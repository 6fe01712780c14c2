// Rollouts: closed-loop simulations of a body under controllers, run on a MuJoCo batch.
//
// Time. Control instant k is at t_k = k * period. Encoders are those of the state at t_k. A line of the sensor node is
// sampled at multiples of its own period, arrives latency later and is held until the next has arrived, so the newest
// line at t_k shows an earlier state: sample[] says which. Loads and contact forces are the last substep's, that is of
// the state one substep before. The goals computed at t_k act latency substeps later.
//
// Each simulation starts from a full reset and depends on nothing but its own case, so the number of threads changes
// no bit. These structs are mirrored in sim_models/native_rollouts.py.

#ifndef SIM_MODELS_NATIVE_ROLLOUT_H_
#define SIM_MODELS_NATIVE_ROLLOUT_H_

#include <mujoco/mjbatch.h>
#include <mujoco/mujoco.h>
#include <stdint.h>

#include "sv_cycle.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_JOINT_MAX 32     // joints of a rig
#define SV_FOOT_MAX 8       // feet of a body
#define SV_HEAD_MAX 8       // geoms of a head
#define SV_SENSOR_MAX 32    // channels of the sensor node
#define SV_GOAL_RING 64     // control periods whose goals are remembered: bounds the command latency
#define SV_SAMPLE_RING 512  // substeps whose states are remembered: bounds the sensor latency
#define SV_TRACE_POSE 9     // trace channels before the joints: pose (6), clearance, force, px

typedef enum { SV_FORM_FREE = 0, SV_FORM_PLANAR = 1 } sv_form;

typedef enum {  // what a channel of the sensor node shows
  SV_SENSOR_X = 0,
  SV_SENSOR_Y = 1,
  SV_SENSOR_Z = 2,
  SV_SENSOR_HEADING = 3,
  SV_SENSOR_ROLL = 4,
  SV_SENSOR_PITCH = 5,
  SV_SENSOR_FORCE = 6,
  SV_SENSOR_VX = 7,
  SV_SENSOR_VY = 8,
  SV_SENSOR_VZ = 9
} sv_sensor;

typedef enum {  // how a rollout went
  SV_STATUS_DONE = 0,
  SV_STATUS_DIVERGED = 1,  // MuJoCo met a bad number
  SV_STATUS_ERROR = 2      // MuJoCo raised an error
} sv_status;

typedef enum { SV_FALL_NONE = 0, SV_FALL_TILT = 1, SV_FALL_HEAD = 2, SV_FALL_FLIGHT = 3 } sv_fall;

typedef struct {                    // what all simulations share
  int32_t nstep;                    // control periods
  int32_t nsub;                     // substeps of a period
  int32_t form;                     // sv_form
  int32_t base;                     // base body
  int32_t njoint;                   // joints of the rig
  int32_t nfoot;                    // feet
  int32_t nhead;                    // head geoms
  int32_t nsensor;                  // channels of the sensor node
  int32_t window;                   // control periods that end_speed looks back, at most SV_GOAL_RING
  int32_t stop_head;                // stop when the head touches anything
  int32_t stop_flight_substeps;     // stop when the base has touched nothing for this long; 0: never
  int32_t stop_early;               // end at a stop; 0: simulate on to the end, though nothing is recorded any more
  int32_t timer;                    // leave MuJoCo's timer callback in place
  double stop_tilt_cos;             // stop when the cosine of the base's tilt is below this; -2: never
  double base_z;                    // planar: height of the base at qpos = 0 [m]
  double foot_radius;               // [m]
  double foot[3 * SV_FOOT_MAX];     // centres of the feet in the base's frame [m]
  double neutral[SV_JOINT_MAX];     // [rad]
  double rest[SV_JOINT_MAX];        // goal that holds a joint at its neutral angle: the angle, or no rate [rad, rad/s]
  double torque_max[SV_JOINT_MAX];  // servo torque that reads as a load of 1 [N m]
  double load_speed[SV_JOINT_MAX];  // load per rate of a servo whose load is its duty, else 0 [s/rad]
  int32_t head[SV_HEAD_MAX];        // geoms
  int32_t qpos[SV_JOINT_MAX];       // addresses in qpos
  int32_t dof[SV_JOINT_MAX];        // addresses in qvel
  int32_t actuator[SV_JOINT_MAX];   // actuators
  int32_t unlimited[SV_JOINT_MAX];  // whether the joint may turn for ever
  int32_t sensor[SV_SENSOR_MAX];    // sv_sensor of each channel
  const double* qpos0;              // settled state, (nq)
  const sv_terminal* encoder;       // how each raw channel counts, (nraw): angles, velocities, loads, sensors
  const int32_t* sample;            // substep whose state a channel shows at each control instant, (nstep, nsensor)
  const uint8_t* sampled;           // whether any channel samples the state after so many substeps, (nstep * nsub + 1)
} sv_rollout_setup;

typedef struct {  // what one simulation has of its own, apart from its model
  const sv_cycle* cycle;
  sv_goal goal;
  uint64_t seed;                     // of its noise
  int32_t latency;                   // substeps until a goal acts
  float pose_noise;                  // standard deviation of x, y, z [m]
  float angle_noise;                 // of heading, roll, pitch [rad]
  float force_noise;                 // [N]
  float encoder_bias[SV_JOINT_MAX];  // added to the angles read [rad]
  float initial[SV_JOINT_MAX];       // added to the settled angles [rad]
  float input_scale[SV_JOINT_MAX];   // what each motor's input is over the goal
} sv_rollout_case;

typedef struct {               // what one simulation came to; see sim_models/statistics.py
  float final_error;           // distance of the base from the goal at the end [m]
  float final_px;              // goal - base along the heading at the end [m]
  float min_error;             // smallest distance from the goal [m]
  float min_abs_px;            // smallest |px| [m]
  float end_tilt;              // angle of the base to the vertical at the end [rad]
  float max_tilt;              // its largest value [rad]
  float end_speed;             // largest speed of the base during the last 0.2 s [m/s]
  float end_joint_error;       // mean |angle - neutral| at the end, the shorter way round where unlimited [rad]
  float end_joint_speed;       // mean |rate| of the joints at the end [rad/s]
  float max_clearance;         // of the lowest foot [m]
  float path;                  // horizontal path of the base [m]
  float ground_path;           // the part of it with a foot down at both ends of a period [m]
  float path_after_hit;        // the part of it after first_hit_step [m]
  float joint_path_after_hit;  // mean path of the joints after first_hit_step [rad]
  float peak_torque;           // largest |load| of any joint
  int32_t status;              // sv_status
  int32_t fallen;              // sv_fall: which condition stopped it
  int32_t head_touched;        // whether the head touched anything
  int32_t upright_end;         // not fallen, and end_tilt is at most 0.35 rad
  int32_t alive_steps;         // control periods completed
  int32_t hops;                // excursions of all feet to at least 10 mm
  int32_t first_hit_step;      // first control instant within 0.015 m of the goal, or -1
  int32_t arrive_step;         // control instant since which the base stays within 0.015 m of the goal, or -1
  int32_t idle_steps;          // control instants before arrive_step, or the end, with the base slower than 0.02 m/s
} sv_statistics;

typedef struct {  // where the results go; all but statistics may be NULL; rows after a stop are left as they were
  sv_statistics* statistics;  // (nsim)
  float* traces;              // (nsim, nstep, SV_TRACE_POSE + 4 * njoint): ... angles, rates, loads, goals
  int32_t* raw;               // raw counts that the cycle read, (nsim, nstep, 3 * njoint + nsensor)
  float* outputs;             // clamped outputs in their own units, (nsim, nstep, njoint)
  int32_t* goal_counts;       // (nsim, nstep, njoint)
} sv_results;

// Return the version of the MuJoCo headers that this library was compiled with.
int32_t sv_rollout_mujoco_version(void);

// Return the sizes of the structs above, so that a caller can check its mirror of them.
void sv_rollout_sizes(int32_t sizes[4]);

// Return a standard normal deviate, the same on every machine: (seed, substep, channel) => value.
double sv_noise(uint64_t seed, int32_t substep, int32_t channel);

// Run simulations 0 .. n-1 of the batch, ids = (0 .. n-1); return in how many MuJoCo raised an error.
int32_t sv_rollout_run(mjBatch* batch, const int* ids, int32_t n, const sv_rollout_setup* setup,
                       const sv_rollout_case* cases, const sv_results* results);

#ifdef __cplusplus
}
#endif

#endif  // SIM_MODELS_NATIVE_ROLLOUT_H_
