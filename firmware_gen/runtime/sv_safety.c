#include "sv_safety.h"

#include "sv_math.h"

// the numbers of deploy/safety.py, where each is explained
#define SV_PERSISTENT 3
#define SV_POOR_MAX 10
#define SV_VOLTAGE_BIT 0x01

static const float kJumpRad = 0.2F;
static const float kJumpSpeed = 1.2F;
static const float kSpeedShare = 0.2F;
static const float kMicro = 1.0e-6F;

static float sv_absolute(float x) { return x < 0.0F ? -x : x; }

// time since => s
static float sv_seconds(uint32_t now_us, uint32_t since_us) { return (float)(int32_t)(now_us - since_us) * kMicro; }

static float sv_angle(const sv_joint* joint, int32_t count) {
  return (float)(count - joint->zero) * joint->angle_scale;
}

int32_t sv_milli(float value) { return sv_round(1000.0F * value); }

int32_t sv_because(sv_watch* watch, int32_t reason, int32_t joint, int32_t a, int32_t b) {
  const sv_why why = {reason, joint, a, b};
  watch->why = why;
  return 1;
}

void sv_watch_init(sv_watch* watch) {
  for (int32_t i = 0; i < SV_JOINT_MAX; i++) {
    const sv_watch_joint fresh = {0, 0, 0, 0, 0, 0, 0, 0, 0.0F, 0, 0};
    watch->joints[i] = fresh;
  }
  for (int32_t i = 0; i < SV_SENSOR_MAX; i++) {
    watch->stale[i] = 0;
  }
  watch->tilted = 0;
  watch->overruns = 0;
  watch->why.reason = SV_REASON_NONE;
}

// Return what to say of a joint that has been silent for too long, or of all.
static int32_t sv_blame(sv_watch* watch, int32_t joint, const sv_reply* reply, int32_t everyone, int32_t late,
                        int32_t missed, int32_t mostly) {
  if (late) {
    return sv_because(watch, SV_REASON_LATE, everyone ? SV_NOBODY : joint, missed, mostly);
  }
  if (everyone || reply->status == SV_REPLY_MISSING) {
    return sv_because(watch, SV_REASON_SILENT, everyone ? SV_NOBODY : joint, missed, mostly);
  }
  if (reply->status == SV_REPLY_CORRUPT) {
    return sv_because(watch, SV_REASON_CORRUPT, joint, missed, mostly);
  }
  return sv_because(watch, SV_REASON_REFUSED, joint, missed, mostly | (int32_t)reply->error << 8);
}

int32_t sv_judge_replies(const sv_rig* rig, sv_watch* watch, const sv_reply* replies) {
  const int32_t most = rig->safety.missed_max;
  int32_t everyone = rig->njoint > 1;
  int32_t late = 0;
  for (int32_t i = 0; i < rig->njoint; i++) {
    sv_watch_joint* joint = watch->joints + i;
    const int32_t answered = replies[i].status == SV_REPLY_DATA;
    joint->missed = answered ? 0 : joint->missed + 1;
    joint->poor += answered ? -1 : 1;
    joint->poor = joint->poor < 0 ? 0 : joint->poor;
    everyone = everyone && joint->missed > most;
    late = late || replies[i].late;
  }
  for (int32_t i = 0; i < rig->njoint; i++) {
    const sv_watch_joint* joint = watch->joints + i;
    if (joint->missed > most || (joint->missed != 0 && joint->poor > most + SV_POOR_MAX)) {
      return sv_blame(watch, i, replies + i, everyone, late, joint->missed, joint->missed <= most);
    }
  }
  return 0;
}

int32_t sv_judge_alert(const sv_rig* rig, sv_watch* watch, int32_t joint, const sv_reply* reply) {
  if (reply->status != SV_REPLY_DATA) {
    return 0;
  }
  int32_t* alerted = &watch->joints[joint].alerted;
  *alerted = reply->error != 0 ? *alerted + 1 : 0;
  const int32_t passing = SV_PROTOCOL(rig) != SV_DYNAMIXEL2 && reply->error == SV_VOLTAGE_BIT;
  return *alerted >= (passing ? SV_PERSISTENT : 1);
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
    const int32_t age_us_max = rig->sensors[i].age_us_max;
    if (!rig->sensors[i].needed) {
      continue;
    }
    const int32_t fresh = ages_us[i] >= 0 && ages_us[i] <= age_us_max;
    watch->stale[i] = fresh ? 0 : watch->stale[i] + 1;
    if (watch->stale[i] > rig->safety.missed_max) {
      return sv_because(watch, SV_REASON_STALE, i, ages_us[i], age_us_max);
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
    const float angle = sv_angle(rig->joints + i, counts[i]);
    const float since = joint->seen ? sv_seconds(now_us, joint->believed_us) : 0.0F;
    const float way = joint->seen ? sv_absolute(angle - joint->believed_rad) : 0.0F;
    const float turned = kJumpSpeed * SV_SERVO(rig, i)->no_load_speed * since;
    if (way <= kJumpRad + turned) {
      // an answer that was held up is as old as its question
      joint->seen = 1;
      joint->believed_us = asked_us;
      joint->believed_rad = angle;
      joint->jumped = 0;
      continue;
    }
    joint->jumped++;
    if (joint->jumped > jumped_max) {
      return sv_because(watch, SV_REASON_JUMP, i, sv_milli(way), (int32_t)(now_us - joint->believed_us));
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
    const float away = sv_absolute((float)(goals[i] - counts[i]) * rig->joints[i].angle_scale);
    const int32_t off_us = sv_off_track(watch->joints + i, now_us, !(away <= rig->safety.tracking_rad_max));
    if (off_us > rig->safety.tracking_us_max) {
      return sv_because(watch, SV_REASON_TRACKING, i, sv_milli(away), off_us);
    }
  }
  return 0;
}

int32_t sv_judge_speeds(const sv_rig* rig, sv_watch* watch, uint32_t now_us, const int32_t* goals,
                        const int32_t* speeds, const int32_t* counts) {
  const float slack = rig->safety.tracking_rad_max;
  for (int32_t i = 0; i < rig->njoint; i++) {
    const sv_axis* joint = rig->axes + i;
    const float angle = sv_angle(rig->joints + i, counts[i]);
    if (!joint->unlimited && !(angle >= joint->low_rad - slack && angle <= joint->high_rad + slack)) {
      return sv_because(watch, SV_REASON_OUTSIDE, i, sv_milli(angle), 0);
    }
    const float asked = (float)goals[i] * joint->speed_scale;
    const float done = (float)speeds[i] * joint->speed_scale;
    const int32_t stuck =
        sv_absolute(asked) > kSpeedShare * joint->speed_max && done * asked < kSpeedShare * asked * asked;
    if (sv_off_track(watch->joints + i, now_us, stuck) > rig->safety.tracking_us_max) {
      return sv_because(watch, SV_REASON_BLOCKED, i, sv_milli(done), sv_milli(asked));
    }
  }
  return 0;
}

// Return the angle in 0..pi that has a cosine [mrad].
static int32_t sv_rough_acos(float cosine) {
  float angle = 0.0F;
  for (float step = 1.57079633F; step > 5.0e-4F; step = 0.5F * step) {
    angle = sv_cos(angle + step) > cosine ? angle + step : angle;
  }
  return sv_milli(angle);
}

int32_t sv_judge_tilt(const sv_rig* rig, sv_watch* watch, float roll, float pitch) {
  const float most = rig->safety.tilt_rad_max;
  const float cosine = sv_cos(roll) * sv_cos(pitch);
  watch->tilted = most > 0.0F && cosine < sv_cos(most) ? watch->tilted + 1 : 0;
  return watch->tilted >= SV_PERSISTENT && sv_because(watch, SV_REASON_TILT, SV_NOBODY, sv_rough_acos(cosine), 0);
}

int32_t sv_judge_health(const sv_rig* rig, sv_watch* watch, int32_t joint, int32_t voltage, int32_t temperature) {
  const int32_t millivolts = sv_milli((float)voltage * SV_SERVO(rig, joint)->voltage_scale);
  sv_watch_joint* counted = watch->joints + joint;
  counted->hot = (float)temperature > rig->safety.temperature_max ? counted->hot + 1 : 0;
  counted->low = millivolts < sv_milli(rig->safety.voltage_low) ? counted->low + 1 : 0;
  if (counted->hot >= SV_PERSISTENT) {
    return sv_because(watch, SV_REASON_HOT, joint, temperature, 0);
  }
  return counted->low >= SV_PERSISTENT && sv_because(watch, SV_REASON_LOW, joint, millivolts, 0);
}

int32_t sv_judge_timing(const sv_rig* rig, sv_watch* watch, int32_t overran) {
  watch->overruns = overran ? watch->overruns + 1 : 0;
  return watch->overruns > rig->safety.overrun_max &&
         sv_because(watch, SV_REASON_OVERRUN, SV_NOBODY, watch->overruns, 0);
}
