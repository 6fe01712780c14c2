#include "sv_schedule.h"

int32_t sv_schedule_period(const sv_schedule* schedule, int32_t k, sv_transaction* transactions) {
  const sv_block nothing = {0, 0};
  const sv_transaction read = {SV_READ_STATE, -1, schedule->state};
  const sv_transaction run = {SV_RUN_CYCLE, -1, nothing};
  const sv_transaction write = {SV_WRITE_GOALS, -1, schedule->goal};
  transactions[0] = read;
  transactions[1] = run;
  transactions[2] = write;
  if (schedule->nservo < 1 || schedule->nhealth < 1 || schedule->health_every < 1 || k < 0 ||
      k % schedule->health_every != schedule->health_every - 1) {
    return 3;
  }
  const int32_t turn = k / schedule->health_every;
  const int32_t servo = turn % schedule->nservo;
  const sv_transaction health = {SV_READ_HEALTH, servo, schedule->health[turn / schedule->nservo % schedule->nhealth]};
  transactions[3] = health;
  return 4;
}
