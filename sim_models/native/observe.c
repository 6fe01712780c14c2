// States of the base, from qpos, so never a substep old.

#include "observe.h"

#include <math.h>

// quaternion => rotation matrix, row by row
static void rotation_free(const mjtNum* q, double r[9]) {
  double w = q[0], x = q[1], y = q[2], z = q[3];
  r[0] = 1 - 2 * (y * y + z * z);
  r[1] = 2 * (x * y - w * z);
  r[2] = 2 * (x * z + w * y);
  r[3] = 2 * (x * y + w * z);
  r[4] = 1 - 2 * (x * x + z * z);
  r[5] = 2 * (y * z - w * x);
  r[6] = 2 * (x * z - w * y);
  r[7] = 2 * (y * z + w * x);
  r[8] = 1 - 2 * (x * x + y * y);
}

// pitch => rotation matrix, row by row
static void rotation_planar(double pitch, double r[9]) {
  double c = cos(pitch), s = sin(pitch);
  r[0] = c, r[1] = 0, r[2] = s;
  r[3] = 0, r[4] = 1, r[5] = 0;
  r[6] = -s, r[7] = 0, r[8] = c;
}

void sv_observe(const sv_rollout_setup* setup, const mjData* d, sv_view* view) {
  const double* r = view->r;
  if (setup->form == SV_FORM_FREE) {
    rotation_free(d->qpos + 3, view->r);
    view->x = d->qpos[0], view->y = d->qpos[1], view->z = d->qpos[2];
    view->v[0] = d->qvel[0], view->v[1] = d->qvel[1], view->v[2] = d->qvel[2];
  } else {
    rotation_planar(d->qpos[2], view->r);
    view->x = d->qpos[0], view->y = 0, view->z = d->qpos[1] + setup->base_z;
    view->v[0] = d->qvel[0], view->v[1] = 0, view->v[2] = d->qvel[1];
  }

  // lowest foot
  double lowest = INFINITY;
  for (int i = 0; i < setup->nfoot; i++) {
    const double* foot = setup->foot + 3 * i;
    double height = r[6] * foot[0] + r[7] * foot[1] + r[8] * foot[2];
    lowest = height < lowest ? height : lowest;
  }
  view->clearance = view->z + lowest - setup->foot_radius;
}

double sv_quantity(const sv_view* view, sv_sensor sensor) {
  double sine = -view->r[6];
  double ahead[2] = {view->r[0], view->r[3]}, level = sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1]);
  if (level > 0) {
    ahead[0] /= level, ahead[1] /= level;
  } else {
    ahead[0] = 1, ahead[1] = 0;
  }
  switch (sensor) {
    case SV_SENSOR_X:
      return view->x;
    case SV_SENSOR_Y:
      return view->y;
    case SV_SENSOR_Z:
      return view->z;
    case SV_SENSOR_HEADING:
      return atan2(view->r[3], view->r[0]);
    case SV_SENSOR_ROLL:
      return atan2(view->r[7], view->r[8]);
    case SV_SENSOR_PITCH:
      return asin(sine > 1 ? 1 : (sine < -1 ? -1 : sine));
    case SV_SENSOR_VX:
      return view->v[0] * ahead[0] + view->v[1] * ahead[1];
    case SV_SENSOR_VY:
      return view->v[1] * ahead[0] - view->v[0] * ahead[1];
    case SV_SENSOR_VZ:
      return view->v[2];
    default:
      return view->force;
  }
}

double sv_base_force(const sv_rollout_setup* setup, const mjModel* m, const mjData* d) {
  double total = 0;
  for (int i = 0; i < d->ncon; i++) {
    const mjContact* contact = d->contact + i;
    int base1 = m->geom_bodyid[contact->geom[0]] == setup->base;
    int base2 = m->geom_bodyid[contact->geom[1]] == setup->base;
    if (base1 || base2) {
      mjtNum wrench[6];
      mj_contactForce(m, d, i, wrench);
      total += wrench[0];
    }
  }
  return total;
}
