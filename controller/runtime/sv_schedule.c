#include "sv_schedule.h"

int32_t sv_schedule_due(const sv_schedule* schedule, int32_t k, int32_t i, sv_transaction* due) {
  due->kind = i;
  due->servo = -1;
  if (i < SV_READ_HEALTH) {
    due->block = i == SV_READ_STATE ? &schedule->state : &schedule->goal;
    return 1;
  }
  if (i > SV_READ_HEALTH || schedule->nservo < 1 || schedule->nhealth < 1 || schedule->health_every < 1 || k < 0 ||
      k % schedule->health_every != schedule->health_every - 1) {
    return 0;
  }
  const int32_t turn = k / schedule->health_every;
  due->servo = turn % schedule->nservo;
  due->block = schedule->health + turn / schedule->nservo % schedule->nhealth;
  return 1;
}
