#include "sv_safety.h"

#include "sv_math.h"

// the numbers of deploy/safety.py, where each is explained
#define SV_PASSING 2  // readings in a row that may be wrong
#define SV_POOR_MAX 10
#define SV_VOLTAGE_BIT 0x01

static const float kSpeedShare = 0.2F;

static float sv_absolute(float x) { return x < 0.0F ? -x : x; }

// counts => how far they are apart
static uint32_t sv_apart(int32_t a, int32_t b) { return a > b ? (uint32_t)a - (uint32_t)b : (uint32_t)b - (uint32_t)a; }

// Count how often in a row something has been wrong; return whether that is more often than it may be.
static int32_t sv_lasts(int32_t* count, int32_t wrong, int32_t most) {
  *count = wrong ? *count + 1 : 0;
  return *count > most;
}

int32_t sv_because(sv_watch* watch, int32_t reason, int32_t joint, int32_t a, int32_t b) {
  const sv_why why = {reason, joint, a, b};
  watch->why = why;
  return 1;
}

void sv_watch_init(sv_watch* watch) {
  for (int32_t i = 0; i < SV_JOINT_MAX; i++) {
    const sv_watch_joint fresh = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
    watch->joints[i] = fresh;
  }
  for (int32_t i = 0; i < SV_SENSOR_MAX; i++) {
    watch->stale[i] = 0;
  }
  watch->tilted = 0;
  watch->overruns = 0;
  watch->why.reason = SV_REASON_NONE;
}

int32_t sv_judge_replies(const sv_rig* rig, sv_watch* watch, const sv_reply* replies) {
  static const uint8_t kReasons[] = {SV_REASON_NONE, SV_REASON_REFUSED, SV_REASON_SILENT, SV_REASON_CORRUPT};
  const int32_t most = rig->safety.missed_max;
  int32_t nsilent = 0;
  int32_t late = 0;
  int32_t first = SV_NOBODY;
  for (int32_t i = rig->njoint - 1; i >= 0; i--) {
    sv_watch_joint* joint = watch->joints + i;
    const int32_t missing = replies[i].status != SV_REPLY_DATA;
    const int32_t silent = sv_lasts(&joint->missed, missing, most);
    joint->poor += missing ? 1 : joint->poor > 0 ? -1 : 0;
    if (silent || (missing && joint->poor > most + SV_POOR_MAX)) {
      first = i;
    }
    nsilent += silent;
    late |= replies[i].late;
  }
  if (first == SV_NOBODY) {
    return 0;
  }
  const sv_reply* reply = replies + first;
  const int32_t missed = watch->joints[first].missed;
  const int32_t everyone = nsilent > 1 && nsilent == rig->njoint;
  const int32_t reason = late ? SV_REASON_LATE : kReasons[everyone ? SV_REPLY_MISSING : reply->status];
  return sv_because(watch, reason, everyone ? SV_NOBODY : first, missed, (missed <= most) | (int32_t)reply->error << 8);
}

int32_t sv_judge_alert(const sv_rig* rig, sv_watch* watch, int32_t joint, const sv_reply* reply) {
  if (reply->status != SV_REPLY_DATA) {
    return 0;
  }
  const int32_t passing = SV_PROTOCOL(rig) != SV_DYNAMIXEL2 && reply->error == SV_VOLTAGE_BIT;
  return sv_lasts(&watch->joints[joint].alerted, reply->error != 0, passing ? SV_PASSING : 0);
}

int32_t sv_judge_hardware_error(const sv_rig* rig, sv_watch* watch, int32_t joint, int32_t status, int32_t shutdown) {
  // an error byte has bits beside these that are about the question
  const int32_t meant =
      SV_SERVO(rig, joint)->hardware_error.size > 0 ? status : status & SV_SERVO(rig, joint)->error_bits;
  return meant != 0 && sv_because(watch, SV_REASON_HARDWARE, joint, meant, shutdown);
}

int32_t sv_judge_torque(sv_watch* watch, int32_t joint, int32_t torque) {
  return torque == 0 && sv_because(watch, SV_REASON_NO_TORQUE, joint, 0, 0);
}

int32_t sv_judge_sensors(const sv_rig* rig, sv_watch* watch, const int32_t* ages_us) {
  for (int32_t i = 0; i < rig->nsensor; i++) {
    const sv_sensor* sensor = rig->sensors + i;
    const int32_t old = sensor->needed && !sv_is_fresh(sensor, ages_us[i]);
    if (sv_lasts(watch->stale + i, old, rig->safety.missed_max)) {
      return sv_because(watch, SV_REASON_STALE, i, ages_us[i], sensor->age_us_max);
    }
  }
  return 0;
}

int32_t sv_judge_encoders(const sv_rig* rig, sv_watch* watch, uint32_t asked_us, uint32_t now_us,
                          const sv_reply* replies, const int32_t* counts) {
  if (SV_VELOCITY_MODE(rig)) {
    return 0;
  }
  // a sum of bytes does not always tell that a packet is damaged, a CRC does
  const int32_t jumped_max = SV_PROTOCOL(rig) == SV_DYNAMIXEL2 ? 0 : 1;
  for (int32_t i = 0; i < rig->njoint; i++) {
    sv_watch_joint* joint = watch->joints + i;
    if (replies[i].status != SV_REPLY_DATA) {
      continue;
    }
    const uint32_t way = sv_apart(counts[i], joint->believed);
    const uint32_t since_us = now_us - joint->believed_us;
    const float reach = SV_SERVO(rig, i)->jump_counts + SV_SERVO(rig, i)->counts_per_us * (float)since_us;
    const int32_t jumped = joint->seen && (float)way > reach;
    if (sv_lasts(&joint->jumped, jumped, jumped_max)) {
      return sv_because(watch, SV_REASON_JUMP, i, (int32_t)way, (int32_t)since_us);
    }
    if (!jumped) {
      // an answer that was held up is as old as its question
      joint->seen = 1;
      joint->believed_us = asked_us;
      joint->believed = counts[i];
    }
  }
  return 0;
}

// Return for how long a joint has been off its track, 0 if it is on it [us].
static int32_t sv_off_track(sv_watch_joint* joint, uint32_t now_us, int32_t off) {
  if (!joint->off_track) {
    joint->off_track_us = now_us;
  }
  joint->off_track = off != 0;
  return off ? (int32_t)(now_us - joint->off_track_us) : 0;
}

int32_t sv_judge_tracking(const sv_rig* rig, sv_watch* watch, uint32_t now_us, const int32_t* goals,
                          const int32_t* counts) {
  for (int32_t i = 0; i < rig->njoint; i++) {
    const uint32_t away = sv_apart(goals[i], counts[i]);
    const int32_t off_us = sv_off_track(watch->joints + i, now_us, away > SV_SERVO(rig, i)->tracking_counts);
    if (off_us > rig->safety.tracking_us_max) {
      return sv_because(watch, SV_REASON_TRACKING, i, (int32_t)away, off_us);
    }
  }
  return 0;
}

int32_t sv_judge_speeds(const sv_rig* rig, sv_watch* watch, uint32_t now_us, const int32_t* goals,
                        const int32_t* speeds, const int32_t* counts) {
  const float slack = rig->safety.tracking_rad_max;
  for (int32_t i = 0; i < rig->njoint; i++) {
    const sv_axis* joint = rig->axes + i;
    const float angle = (float)(counts[i] - joint->zero) * joint->angle_scale;
    if (!joint->unlimited && !(angle >= joint->low_rad - slack && angle <= joint->high_rad + slack)) {
      return sv_because(watch, SV_REASON_OUTSIDE, i, counts[i], 0);
    }
    const float asked = (float)goals[i] * joint->speed_scale;
    const float done = (float)speeds[i] * joint->speed_scale;
    const int32_t stuck =
        sv_absolute(asked) > kSpeedShare * joint->speed_max && done * asked < kSpeedShare * asked * asked;
    if (sv_off_track(watch->joints + i, now_us, stuck) > rig->safety.tracking_us_max) {
      return sv_because(watch, SV_REASON_BLOCKED, i, speeds[i], goals[i]);
    }
  }
  return 0;
}

static float sv_cosine(const sv_sensor* sensor, int32_t raw) {
  return sv_cos((float)(raw - sensor->zero) * sensor->scale);
}

int32_t sv_judge_tilt(const sv_rig* rig, sv_watch* watch, int32_t roll, int32_t pitch) {
  const float cosine = sv_cosine(rig->sensors + rig->roll, roll) * sv_cosine(rig->sensors + rig->pitch, pitch);
  return sv_lasts(&watch->tilted, cosine < rig->safety.tilt_cosine_min, SV_PASSING) &&
         sv_because(watch, SV_REASON_TILT, SV_NOBODY, roll, pitch);
}

int32_t sv_judge_health(const sv_rig* rig, sv_watch* watch, int32_t joint, int32_t voltage, int32_t temperature) {
  sv_watch_joint* counted = watch->joints + joint;
  const int32_t hot = sv_lasts(&counted->hot, temperature > rig->safety.temperature_max, SV_PASSING);
  const int32_t low = sv_lasts(&counted->low, voltage < SV_SERVO(rig, joint)->voltage_low, SV_PASSING);
  if (hot) {
    return sv_because(watch, SV_REASON_HOT, joint, temperature, 0);
  }
  return low && sv_because(watch, SV_REASON_LOW, joint, voltage, 0);
}

int32_t sv_judge_timing(const sv_rig* rig, sv_watch* watch, int32_t overran) {
  return sv_lasts(&watch->overruns, overran, rig->safety.overrun_max) &&
         sv_because(watch, SV_REASON_OVERRUN, SV_NOBODY, watch->overruns, 0);
}

int32_t sv_judge_goals(const sv_rig* rig, sv_watch* watch, int32_t running, const int32_t* last, const int32_t* goals) {
  for (int32_t i = 0; i < rig->njoint; i++) {
    const sv_joint* joint = rig->joints + i;
    const uint32_t most = running ? SV_SERVO(rig, i)->slew_counts : SV_SERVO(rig, i)->homing_counts;
    // near an end of its travel a joint that is driven by its speed is stopped at once, and let go at once
    const int32_t at_once = SV_VELOCITY_MODE(rig) && !rig->axes[i].unlimited && (goals[i] == 0 || last[i] == 0);
    if (goals[i] < joint->goal_low || goals[i] > joint->goal_high) {
      return sv_because(watch, SV_REASON_LIMIT, i, goals[i], 0);
    }
    if (sv_apart(goals[i], last[i]) > most && !at_once) {
      return sv_because(watch, SV_REASON_RATE, i, goals[i], last[i]);
    }
  }
  return 0;
}
