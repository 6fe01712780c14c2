// Statistics of a rollout, at control rate.

#include <math.h>
#include <string.h>

#include "observe.h"

#define HIT_M 0.015            // within this of the goal is a hit (Gritz & Hahn 1997)
#define HOP_CLEARANCE_M 0.010  // a hop lifts all feet this far; the same as in sim_models/statistics.py
#define LANDED_M 0.002         // and is over when a foot is lower than this
#define UPRIGHT_RAD 0.35       // largest tilt of an upright base
#define IDLE_M_S 0.02          // a base slower than this stands
#define TURN 6.283185307179586

// square root of a sum of squares; lengths of metres need no care for overflow
static double length(double a, double b) { return sqrt(a * a + b * b); }

double sv_px(const sv_record* record, const sv_view* view) {
  double along = (record->goal_x - view->x) * view->r[0] + (record->goal_y - view->y) * view->r[3];
  double level = length(view->r[0], view->r[3]);
  return level > 0 ? along / level : record->goal_x - view->x;
}

// distance of the base from the goal
static double error(const sv_record* record, const sv_view* view) {
  return length(record->goal_x - view->x, record->goal_y - view->y);
}

// angle whose cosine is given
static double angle(double cosine) { return acos(cosine > 1 ? 1 : (cosine < -1 ? -1 : cosine)); }

// speed of the base's centre
static double speed(const sv_view* view) {
  return sqrt(view->v[0] * view->v[0] + view->v[1] * view->v[1] + view->v[2] * view->v[2]);
}

void sv_statistics_begin(const sv_rollout_setup* setup, const sv_goal* goal, const mjData* d, const sv_view* view,
                         sv_record* record, sv_statistics* statistics) {
  memset(statistics, 0, sizeof(*statistics));
  // the end's values stand unless the end is reached
  statistics->final_error = INFINITY;
  statistics->final_px = INFINITY;
  statistics->end_tilt = INFINITY;
  statistics->max_tilt = INFINITY;
  statistics->end_speed = INFINITY;
  statistics->end_joint_error = INFINITY;
  statistics->end_joint_speed = INFINITY;
  statistics->min_error = INFINITY;
  statistics->min_abs_px = INFINITY;
  statistics->first_hit_step = -1;
  statistics->arrive_step = -1;
  double direction = sv_quantity(view, SV_SENSOR_HEADING) + (double)goal->goal_bearing;
  record->goal_x = view->x + (double)goal->goal_dist * cos(direction);
  record->goal_y = view->y + (double)goal->goal_dist * sin(direction);
  record->last_x = view->x;
  record->last_y = view->y;
  record->last_clearance = view->clearance;
  record->airborne = 0;
  record->idle = 0;
  record->idle_arrived = 0;
  record->lowest_up = view->r[8];
  for (int j = 0; j < setup->njoint; j++) {
    record->last_angle[j] = d->qpos[setup->qpos[j]];
  }
}

// paths of base and joints since the last control instant
static void add_paths(const sv_rollout_setup* setup, const mjData* d, const sv_view* view, sv_record* record,
                      sv_statistics* statistics) {
  double moved = length(view->x - record->last_x, view->y - record->last_y);
  double turned = 0;
  for (int j = 0; j < setup->njoint; j++) {
    double now = d->qpos[setup->qpos[j]];
    turned += fabs(now - record->last_angle[j]);
    record->last_angle[j] = now;
  }
  statistics->path += (float)moved;
  if (record->last_clearance < LANDED_M && view->clearance < LANDED_M) {
    statistics->ground_path += (float)moved;
  }
  if (statistics->first_hit_step >= 0) {
    statistics->path_after_hit += (float)moved;
    statistics->joint_path_after_hit += (float)(turned / setup->njoint);
  }
  record->last_x = view->x;
  record->last_y = view->y;
  record->last_clearance = view->clearance;
}

void sv_statistics_observe(const sv_rollout_setup* setup, const mjData* d, const sv_view* view, int32_t k,
                           sv_record* record, sv_statistics* statistics) {
  add_paths(setup, d, view, record, statistics);
  double fast = speed(view);
  record->speed[k % SV_GOAL_RING] = fast;

  // distances
  double distance = error(record, view);
  double px = fabs(sv_px(record, view));
  statistics->min_error = fminf(statistics->min_error, (float)distance);
  statistics->min_abs_px = fminf(statistics->min_abs_px, (float)px);
  if (distance <= HIT_M && statistics->first_hit_step < 0) {
    statistics->first_hit_step = k;
  }
  if (distance > HIT_M) {
    statistics->arrive_step = -1;
  } else if (statistics->arrive_step < 0) {
    statistics->arrive_step = k;
    record->idle_arrived = record->idle;
  }
  record->idle += fast < IDLE_M_S;
  statistics->idle_steps = statistics->arrive_step < 0 ? record->idle : record->idle_arrived;

  // loads
  for (int j = 0; j < setup->njoint; j++) {
    double load = fabs(d->actuator_force[setup->actuator[j]] / setup->torque_max[j]);
    statistics->peak_torque = fmaxf(statistics->peak_torque, (float)load);
  }

  // tilt, clearance, hops
  record->lowest_up = view->r[8] < record->lowest_up ? view->r[8] : record->lowest_up;
  statistics->max_clearance = fmaxf(statistics->max_clearance, (float)view->clearance);
  if (!record->airborne && view->clearance >= HOP_CLEARANCE_M) {
    record->airborne = 1;
    statistics->hops++;
  } else if (record->airborne && view->clearance < LANDED_M) {
    record->airborne = 0;
  }
}

void sv_statistics_end(const sv_rollout_setup* setup, const mjData* d, const sv_view* view, int32_t k,
                       const sv_record* record, sv_statistics* statistics) {
  statistics->final_error = (float)error(record, view);
  statistics->final_px = (float)sv_px(record, view);
  statistics->end_tilt = (float)angle(view->r[8]);
  statistics->max_tilt = (float)angle(record->lowest_up);
  statistics->upright_end = statistics->fallen == SV_FALL_NONE && statistics->end_tilt <= (float)UPRIGHT_RAD;
  statistics->end_speed = 0;
  for (int32_t i = k; i >= 0 && i >= k - setup->window; i--) {
    statistics->end_speed = fmaxf(statistics->end_speed, (float)record->speed[i % SV_GOAL_RING]);
  }
  double away = 0, rate = 0;
  for (int j = 0; j < setup->njoint; j++) {
    double turned = d->qpos[setup->qpos[j]] - setup->neutral[j];
    away += fabs(setup->unlimited[j] ? remainder(turned, TURN) : turned);
    rate += fabs(d->qvel[setup->dof[j]]);
  }
  statistics->end_joint_error = (float)(away / setup->njoint);
  statistics->end_joint_speed = (float)(rate / setup->njoint);
}
