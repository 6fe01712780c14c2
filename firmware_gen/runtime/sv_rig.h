// One rig as constant data: what `rig.toml` says, resolved to register addresses and counts by the generator.
//
// A servo's registers, the checks of its settings and the settings themselves are rows of tables, so that the code
// knows no product: Dynamixel 2.0 and Feetech STS servos differ here and in their packets only. What is the same for
// all joints of one product with the same settings stands once, in sv_servo.

#ifndef SV_RIG_H_
#define SV_RIG_H_

#include <stdint.h>

#include "sv_cycle.h"
#include "sv_homing.h"
#include "sv_rig_sizes.h"
#include "sv_schedule.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum { SV_DYNAMIXEL2 = 0, SV_FEETECH_STS = 1 } sv_protocol;

typedef enum {
  SV_UNSIGNED = 0,
  SV_TWOS = 1,     // two's complement
  SV_SIGN10 = 10,  // magnitude, sign in bit 10
  SV_SIGN11 = 11,
  SV_SIGN15 = 15
} sv_encoding;

typedef struct {
  uint16_t address;
  uint8_t size;      // bytes, low byte first; 0: the servo has no such register
  uint8_t encoding;  // sv_encoding
} sv_register;

typedef struct {
  sv_register reg;
  uint16_t value;  // counts
} sv_setting;

// A register must hold low..high. What is found otherwise tells whose bounds they are: those of a limit are the joint's
// goals, those of a position its places.
typedef struct {
  sv_register reg;
  uint16_t low;
  uint16_t high;
  uint8_t mask;  // bits of the count that matter, 0: all
  uint8_t kind;  // sv_finding otherwise: see sv_reason.h
} sv_check;

// A servo as the rig sets it: the same for all joints that have such a one.
typedef struct {
  uint16_t model;            // what the servo says that it is
  uint8_t error_bits;        // of the hardware error that mean something
  float jump_counts;         // an encoder may be so far from its last reading,
  float counts_per_us;       // and so much farther by each us since
  uint32_t tracking_counts;  // so far from its goal a joint may be for long, position mode
  uint32_t slew_counts;      // so far apart two goals of a run may be,
  uint32_t homing_counts;    // and two of homing
  int32_t voltage_low;       // least that is not too low [counts]
  int32_t rest_count;        // a joint at rest has at most this velocity [counts]
  int32_t ceiling_count;     // torque ceiling at derating 1
  sv_register position;
  sv_register velocity;
  sv_register load;
  sv_register goal;
  sv_register torque;
  sv_register ceiling;   // torque ceiling, size 0: none
  sv_register watchdog;  // bus watchdog, size 0: none
  sv_register hardware_error;
  sv_register shutdown;
  sv_register voltage;
  sv_register temperature;
  sv_block tables[2];  // blocks that the start-up check reads: EEPROM, then RAM
  const sv_check* checks;
  int32_t ncheck;
  const sv_setting* settings;  // what is written before torque, in order, but for the torque ceiling, which is last
  int32_t nsetting;
} sv_servo;

typedef struct {
  uint8_t id;
  uint8_t servo;      // number of its kind among the rig's servos
  int32_t zero;       // encoder counts at angle 0
  float angle_scale;  // rad per count, sign included
  int32_t goal_low;   // goals that the mode and the limits allow [counts]
  int32_t goal_high;
  int32_t place_low;  // where it may stand before a run [counts]
  int32_t place_high;
  int32_t neutral;  // position at rest [counts]
} sv_joint;

// Lines of the sensor node that begin with one letter.
typedef struct {
  char letter;
  uint8_t width;       // integers that a line must have
  int32_t latency_us;  // from the sample to the line's last byte
} sv_message;

typedef struct {
  uint8_t message;  // number of its message
  uint8_t field;    // place among the line's integers
  uint8_t needed;   // whether the controller or the tilt guard can not do without it
  int32_t zero;     // counts at 0 SI
  float scale;      // SI per count
  int32_t age_us_max;
} sv_sensor;

// Return whether a sensor's value is young enough; age -1, never read, is not.
static inline int32_t sv_is_fresh(const sv_sensor* sensor, int32_t age_us) {
  return (uint32_t)age_us <= (uint32_t)sensor->age_us_max;
}

typedef struct {
  uint8_t stop_holds;  // a run that was done ends with torque on at the last goal
  float homing_rad_s;
  float tracking_rad_max;
  int32_t tracking_us_max;
  int32_t missed_max;       // replies of one servo that may be missing in a row
  int32_t temperature_max;  // [degrees Celsius]
  float tilt_cosine_min;    // least of cos(roll) * cos(pitch)
  int32_t overrun_max;      // periods in a row that may overrun
  int32_t watchdog_us;      // of the servos' bus watchdogs, 0: none
  int32_t watchdog_count;
} sv_safety;

typedef struct {
  int32_t protocol;  // sv_protocol
  int32_t baud;
  int32_t return_delay_us;
  int32_t patience_us;  // how much later than the line needs a reply may come
  uint8_t velocity_mode;
  uint8_t fast_sync_read;  // one status packet for all: Dynamixel 2.0, where every servo knows it
  int32_t period_us;
  int32_t homing_periods_max;  // beyond those of the move, until rest
  int32_t njoint;
  const sv_joint* joints;
  const sv_servo* servos;  // kinds of servos
  const sv_axis* axes;     // (njoint) of joints that are driven by their speed, 0: by their position
  int32_t nsensor;
  const sv_sensor* sensors;
  int32_t nmessage;
  const sv_message* messages;
  int32_t roll;  // number of the sensor, -1: nobody looks at the tilt
  int32_t pitch;
  sv_safety safety;
  uint32_t fingerprint;  // of rig and controller: a log names the files that it belongs to
} sv_rig;

// A project's one rig with its schedule and its cycle, of rig.c.
extern const sv_rig servolve_rig;
extern const sv_schedule servolve_schedule;
extern const sv_cycle servolve_cycle;

// Return the count that a register's bytes hold.
int32_t sv_register_decode(const sv_register* reg, const uint8_t* data);

// Write a count as a register's bytes: => data (reg->size).
void sv_register_encode(const sv_register* reg, int32_t count, uint8_t* data);

#ifdef __cplusplus
}
#endif

#endif  // SV_RIG_H_
