// The closed loop: raw counts => cycle => goals => substeps, for every simulation of a batch.

#include "rollout.h"

#include <math.h>
#include <string.h>

#include "observe.h"

#define REGISTER_MAX (SV_INPUT_MAX + SV_CONSTANT_MAX + SV_INSTRUCTION_MAX)

typedef struct {  // what all simulations of a run share
  const sv_rollout_setup* setup;
  const sv_rollout_case* cases;
  const sv_results* results;
} sv_job;

typedef struct {  // what one simulation remembers while it runs
  sv_cycle_state cycle;
  sv_record record;
  int32_t substep;                          // substeps done
  int32_t flight;                           // of these, how many in a row without a contact of the base
  uint8_t read[SV_RAW_MAX];                 // which raw channels the cycle reads, or the results keep
  int32_t reads_force;                      // whether one of them is the contact force
  double goal[SV_GOAL_RING][SV_JOINT_MAX];  // goals of the last periods [rad, rad/s]
  sv_view sample[SV_SAMPLE_RING];           // states of the last substeps that a channel samples
  float registers[REGISTER_MAX];
  float program_state[SV_STATE_MAX];
} sv_memory;

int32_t sv_rollout_mujoco_version(void) { return mjVERSION_HEADER; }

void sv_rollout_sizes(int32_t sizes[4]) {
  sizes[0] = (int32_t)sizeof(sv_rollout_setup);
  sizes[1] = (int32_t)sizeof(sv_rollout_case);
  sizes[2] = (int32_t)sizeof(sv_statistics);
  sizes[3] = (int32_t)sizeof(sv_results);
}

// full reset to the settled state with this case's initial angles
static void start(const sv_job* job, const mjModel* m, mjData* d, const sv_rollout_case* own, sv_memory* memory) {
  const sv_rollout_setup* setup = job->setup;
  mj_resetData(m, d);
  mju_copy(d->qpos, setup->qpos0, (int)m->nq);
  for (int j = 0; j < setup->njoint; j++) {
    d->qpos[setup->qpos[j]] += (double)own->initial[j];
    d->ctrl[setup->actuator[j]] = setup->rest[j];
  }
  mj_forward(m, d);
  memory->substep = 0;
  memory->flight = 0;
  sv_cycle_reset(own->cycle, &memory->cycle, memory->registers, memory->program_state);
}

// which raw channels matter: those of the cycle's terminals and pose, or all
static void find_channels_read(const sv_job* job, const sv_rollout_case* own, sv_memory* memory) {
  const sv_rollout_setup* setup = job->setup;
  const sv_cycle* cycle = own->cycle;
  memset(memory->read, job->results->raw != NULL, sizeof(memory->read));
  for (int32_t i = 0; i < cycle->program->ninput; i++) {
    if (cycle->terminals[i].kind == SV_TERMINAL_RAW) {
      memory->read[cycle->terminals[i].channel] = 1;
    }
  }
  const int32_t pose[3] = {cycle->x.channel, cycle->y.channel, cycle->heading.channel};
  for (int32_t i = 0; i < 3; i++) {
    if (pose[i] >= 0) {
      memory->read[pose[i]] = 1;
    }
  }
  memory->reads_force = 0;
  for (int32_t i = 0; i < setup->nsensor; i++) {
    memory->reads_force |= setup->sensor[i] == SV_SENSOR_FORCE && memory->read[3 * setup->njoint + i];
  }
}

// remember the state after memory->substep substeps, if a channel samples it
static void sample(const sv_rollout_setup* setup, const mjModel* m, const mjData* d, sv_memory* memory) {
  if (setup->sampled[memory->substep]) {
    sv_view* view = memory->sample + memory->substep % SV_SAMPLE_RING;
    sv_observe(setup, d, view);
    view->force = memory->reads_force ? sv_base_force(setup, m, d) : 0;
  }
}

// one channel of the sensor node as its newest line at control instant k shows it, noise included
static double sensor_value(const sv_rollout_setup* setup, const sv_rollout_case* own, const sv_memory* memory,
                           int32_t k, int32_t channel) {
  int32_t at = setup->sample[k * setup->nsensor + channel], kind = setup->sensor[channel];
  double value = sv_quantity(memory->sample + at % SV_SAMPLE_RING, (sv_sensor)kind);
  float noise = kind == SV_SENSOR_FORCE   ? own->force_noise
                : kind <= SV_SENSOR_Z     ? own->pose_noise
                : kind <= SV_SENSOR_PITCH ? own->angle_noise
                                          : 0;
  return noise > 0 ? value + (double)noise * sv_noise(own->seed, at, channel) : value;
}

// what a servo reports as its load: torque, or the duty that makes this torque at this speed
static double load_value(const sv_rollout_setup* setup, const mjData* d, int32_t j) {
  double load = d->actuator_force[setup->actuator[j]] / setup->torque_max[j];
  if (setup->load_speed[j] == 0) {
    return load;
  }
  load += setup->load_speed[j] * d->qvel[setup->dof[j]];
  return load > 1 ? 1 : load < -1 ? -1 : load;
}

// the true value that a raw channel counts, SI
static double raw_value(const sv_rollout_setup* setup, const sv_rollout_case* own, const mjData* d,
                        const sv_memory* memory, int32_t k, int32_t channel) {
  int32_t n = setup->njoint, j = channel % n;
  switch (channel / n) {
    case 0:
      return d->qpos[setup->qpos[j]] + (double)own->encoder_bias[j];
    case 1:
      return d->qvel[setup->dof[j]];
    case 2:
      return load_value(setup, d, j);
    default:
      return sensor_value(setup, own, memory, k, channel - 3 * n);
  }
}

// (state, samples) => raw counts, as they would come over the wire; 0 where nobody reads
static void encode(const sv_rollout_setup* setup, const sv_rollout_case* own, const mjData* d, const sv_memory* memory,
                   int32_t k, int32_t* raw) {
  for (int32_t i = 0; i < 3 * setup->njoint + setup->nsensor; i++) {
    raw[i] = memory->read[i] ? sv_encode(setup->encoder + i, (float)raw_value(setup, own, d, memory, k, i)) : 0;
  }
}

// write one row of the trace
static void trace(const sv_job* job, const mjModel* m, const mjData* d, int sim, int32_t k, const sv_view* view,
                  const sv_memory* memory) {
  const sv_rollout_setup* setup = job->setup;
  int32_t n = setup->njoint;
  float* row =
      job->results->traces + ((size_t)sim * (size_t)setup->nstep + (size_t)k) * (size_t)(SV_TRACE_POSE + 4 * n);
  for (int i = SV_SENSOR_X; i <= SV_SENSOR_PITCH; i++) {
    row[i] = (float)sv_quantity(view, (sv_sensor)i);
  }
  row[6] = (float)view->clearance;
  row[7] = (float)sv_base_force(setup, m, d);
  row[8] = (float)sv_px(&memory->record, view);
  row += SV_TRACE_POSE;
  for (int32_t j = 0; j < n; j++) {
    row[j] = (float)d->qpos[setup->qpos[j]];
    row[n + j] = (float)d->qvel[setup->dof[j]];
    row[2 * n + j] = (float)(d->actuator_force[setup->actuator[j]] / setup->torque_max[j]);
    row[3 * n + j] = (float)memory->goal[k % SV_GOAL_RING][j];
  }
}

// one control cycle: raw counts => goals, and the record of both
static void control(const sv_job* job, const mjModel* m, const mjData* d, int sim, int32_t k, const sv_view* view,
                    sv_memory* memory) {
  const sv_rollout_setup* setup = job->setup;
  const sv_rollout_case* own = job->cases + sim;
  int32_t n = setup->njoint, nraw = 3 * n + setup->nsensor;
  size_t row = (size_t)sim * (size_t)setup->nstep + (size_t)k;
  int32_t raw[SV_RAW_MAX], counts[SV_OUTPUT_MAX];
  float terminals[SV_INPUT_MAX], outputs[SV_OUTPUT_MAX];
  encode(setup, own, d, memory, k, raw);
  sv_cycle_step(own->cycle, &own->goal, &memory->cycle, memory->registers, memory->program_state, raw, terminals,
                outputs, counts);
  for (int32_t j = 0; j < n; j++) {
    const sv_output* output = own->cycle->outputs + j;
    memory->goal[k % SV_GOAL_RING][j] = (double)(counts[j] - output->zero) / (double)output->count_scale;
  }
  if (job->results->traces) {
    trace(job, m, d, sim, k, view, memory);
  }
  if (job->results->raw) {
    memcpy(job->results->raw + row * (size_t)nraw, raw, (size_t)nraw * sizeof(int32_t));
  }
  if (job->results->outputs) {
    memcpy(job->results->outputs + row * (size_t)n, outputs, (size_t)n * sizeof(float));
  }
  if (job->results->goal_counts) {
    memcpy(job->results->goal_counts + row * (size_t)n, counts, (size_t)n * sizeof(int32_t));
  }
}

// contacts of the last substep => flight time of the base, touch of the head
static void watch_contacts(const sv_rollout_setup* setup, const mjModel* m, const mjData* d, sv_memory* memory,
                           sv_statistics* statistics) {
  int base = 0;
  for (int i = 0; i < d->ncon; i++) {
    const int* geom = d->contact[i].geom;
    base |= m->geom_bodyid[geom[0]] == setup->base || m->geom_bodyid[geom[1]] == setup->base;
    for (int j = 0; j < setup->nhead; j++) {
      statistics->head_touched |= geom[0] == setup->head[j] || geom[1] == setup->head[j];
    }
  }
  memory->flight = base ? 0 : memory->flight + 1;
}

// whether MuJoCo has met a bad number
static int diverged(const mjData* d) {
  return d->warning[mjWARN_BADQPOS].number || d->warning[mjWARN_BADQVEL].number || d->warning[mjWARN_BADQACC].number ||
         d->warning[mjWARN_BADCTRL].number;
}

// the substeps of one period; return 0, or 1 if the simulation has diverged
static int advance(const sv_rollout_setup* setup, const sv_rollout_case* own, const mjModel* m, mjData* d,
                   sv_memory* memory, sv_statistics* statistics) {
  for (int32_t i = 0; i < setup->nsub; i++) {
    int32_t age = memory->substep - own->latency;
    if (age >= 0 && age % setup->nsub == 0) {
      for (int32_t j = 0; j < setup->njoint; j++) {
        double goal = memory->goal[age / setup->nsub % SV_GOAL_RING][j];
        d->ctrl[setup->actuator[j]] = goal * (double)own->input_scale[j];
      }
    }
    mj_step(m, d);
    if (diverged(d)) {
      return 1;
    }
    memory->substep++;
    watch_contacts(setup, m, d, memory, statistics);
    sample(setup, m, d, memory);
  }
  return 0;
}

// which stop condition holds
static int32_t fallen(const sv_rollout_setup* setup, const sv_view* view, const sv_memory* memory,
                      const sv_statistics* statistics) {
  if (view->r[8] < setup->stop_tilt_cos) {
    return SV_FALL_TILT;
  }
  if (setup->stop_head && statistics->head_touched) {
    return SV_FALL_HEAD;
  }
  if (setup->stop_flight_substeps && memory->flight >= setup->stop_flight_substeps) {
    return SV_FALL_FLIGHT;
  }
  return SV_FALL_NONE;
}

// the rest of a simulation that has stopped at control instant k: its cost, and nothing else
static void simulate_on(const sv_job* job, const mjModel* m, mjData* d, int sim, int32_t k, sv_memory* memory) {
  const sv_results none = {0};
  const sv_job silent = {job->setup, job->cases, &none};
  sv_statistics unseen = {0};
  sv_view view;
  for (; k < job->setup->nstep; k++) {
    sv_observe(job->setup, d, &view);
    control(&silent, m, d, sim, k, &view, memory);
    if (advance(job->setup, job->cases + sim, m, d, memory, &unseen)) {
      return;
    }
  }
}

// one simulation, from reset to end or stop
static void run_one(const mjModel* m, mjData* d, int sim, void* arg) {
  const sv_job* job = arg;
  const sv_rollout_setup* setup = job->setup;
  const sv_rollout_case* own = job->cases + sim;
  sv_statistics* statistics = job->results->statistics + sim;
  sv_memory memory;
  sv_view view;

  start(job, m, d, own, &memory);
  find_channels_read(job, own, &memory);
  sample(setup, m, d, &memory);
  sv_observe(setup, d, &view);
  sv_statistics_begin(setup, &own->goal, d, &view, &memory.record, statistics);
  statistics->status = SV_STATUS_ERROR;  // stands if MuJoCo leaves by a long jump
  sv_statistics_observe(setup, d, &view, 0, &memory.record, statistics);

  int32_t k = 0, status = SV_STATUS_DONE;
  while (k < setup->nstep && statistics->fallen == SV_FALL_NONE) {
    control(job, m, d, sim, k, &view, &memory);
    if (advance(setup, own, m, d, &memory, statistics)) {
      status = SV_STATUS_DIVERGED;
      break;
    }
    k++;
    sv_observe(setup, d, &view);
    sv_statistics_observe(setup, d, &view, k, &memory.record, statistics);
    statistics->fallen = fallen(setup, &view, &memory, statistics);
  }
  statistics->alive_steps = k;
  statistics->status = status;
  if (status == SV_STATUS_DONE) {
    sv_statistics_end(setup, d, &view, k, &memory.record, statistics);
    if (!setup->stop_early) {
      simulate_on(job, m, d, sim, k, &memory);
    }
  }
}

int32_t sv_rollout_run(mjBatch* batch, const int* ids, int32_t n, const sv_rollout_setup* setup,
                       const sv_rollout_case* cases, const sv_results* results) {
  sv_job job = {setup, cases, results};

  // the timer of the Python bindings costs a tenth of the time, and a log file of diverged programs helps nobody
  mjfTime timer = mjcb_time;
  mjLogConfig log = mju_getLogConfig();
  mjLogConfig quiet = log;
  quiet.logto_console = 0;
  quiet.logto_file = 0;
  if (!setup->timer) {
    mjcb_time = NULL;
  }
  mju_setLogConfig(quiet);
  int failed = mjb_apply(batch, ids, n, run_one, &job, /*save=*/0);
  mju_setLogConfig(log);
  mjcb_time = timer;
  return failed;
}
