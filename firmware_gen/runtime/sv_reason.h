// Why a state was entered, what a check found, what happened: numbers, which `servolve` turns into sentences.

#ifndef SV_REASON_H_
#define SV_REASON_H_

typedef enum {
  SV_STATE_OFF = 0,
  SV_STATE_CHECKED = 1,
  SV_STATE_ARMED = 2,
  SV_STATE_HOMING = 3,
  SV_STATE_RUNNING = 4,
  SV_STATE_STOPPING = 5,
  SV_STATE_FAULT = 6
} sv_state;

// a and b are what the reason is about: counts of registers and sensors, microseconds, as its comment says.
typedef enum {
  SV_REASON_NONE = 0,
  // how a run goes on
  SV_REASON_WELL = 1,     // every servo is there, is the right one, and is well
  SV_REASON_WRITTEN = 2,  // settings are written and read back, goals are where the joints stand
  SV_REASON_TORQUE_ON = 3,
  SV_REASON_RESTED = 4,    // at rest in neutral, sensors are fresh
  SV_REASON_TIME = 5,      // the time is over
  SV_REASON_DRY_RUN = 6,   // every check passed; nothing was written
  SV_REASON_RELEASED = 7,  // torque is off on every servo
  // a person's wish
  SV_REASON_STOP_COMMAND = 16,
  SV_REASON_STOP_INPUT = 17,
  SV_REASON_STOP_LINE = 18,  // the sensor node sent an emergency stop
  // faults
  SV_REASON_FINDING = 32,  // a: number of further errors; the first error's joint; the finding record says what
  SV_REASON_SILENT =
      33,  // a: periods, b: error byte << 8, and 1 if in most periods rather than in a row; joint 255: nobody answers
  SV_REASON_LATE = 34,           // likewise
  SV_REASON_CORRUPT = 35,        // likewise
  SV_REASON_REFUSED = 36,        // likewise
  SV_REASON_HARDWARE = 37,       // a: hardware error bits, b: shutdown register, -1: unknown
  SV_REASON_NO_TORQUE = 38,      // a servo has lost its torque
  SV_REASON_STALE = 39,          // joint: number of the sensor, a: age [us], b: age allowed [us]
  SV_REASON_JUMP = 40,           // a: by so much [counts], b: in [us]
  SV_REASON_TRACKING = 41,       // a: so far from the goal [counts], b: for [us]
  SV_REASON_OUTSIDE = 42,        // velocity mode: a: encoder [counts]
  SV_REASON_BLOCKED = 43,        // velocity mode: a: speed [counts], b: goal [counts]
  SV_REASON_TILT = 44,           // a: roll, b: pitch [counts of the sensors]
  SV_REASON_HOT = 45,            // a: temperature [degrees Celsius]
  SV_REASON_LOW = 46,            // a: voltage [counts]
  SV_REASON_OVERRUN = 47,        // a: periods in a row
  SV_REASON_WATCHDOG = 48,       // the servos' bus watchdogs have tripped; a: silence [us]
  SV_REASON_NO_REST = 49,        // homing did not come to rest
  SV_REASON_LIMIT = 50,          // a defect: a: goal [counts]
  SV_REASON_RATE = 51,           // a defect: a: goal, b: the last one [counts]
  SV_REASON_SETTING = 52,        // a register was not taken; a: its address, b: status << 16 | error, or the count read
  SV_REASON_TORQUE_UNSURE = 53,  // torque could not be switched off for certain; a: joints, a bit each
  SV_REASON_SELFTEST = 54,  // this build or this machine does not compute the reference's bits; a: what it returned
  SV_REASON_RESET = 55      // the board has reset itself; a: sv_reset_cause
} sv_reason;

typedef enum {
  SV_FINDING_NONE = 0,
  SV_FINDING_ABSENT = 1,      // does not answer
  SV_FINDING_CORRUPT = 2,     // answers with corrupt packets only
  SV_FINDING_MODEL = 3,       // value: its model
  SV_FINDING_UNREADABLE = 4,  // the block of value bytes from address on could not be read,
  SV_FINDING_GARBLED = 5,     // and answers are corrupt
  SV_FINDING_SETTING = 6,     // a register holds value, and must not
  SV_FINDING_LOW_LIMIT = 7,   // likewise: it must let the joint go as low as its limits
  SV_FINDING_HIGH_LIMIT = 8,  // as high
  SV_FINDING_VOLTAGE = 9,     // of the supply
  SV_FINDING_TEMPERATURE = 10,
  SV_FINDING_POSITION = 11,  // outside one turn, or outside its limits
  SV_FINDING_HARDWARE = 12,  // value: hardware error bits
  SV_FINDING_SENSOR = 13,    // joint: number of a sensor that is needed; value: age [us], -1: no line has come
  SV_FINDING_DERATE = 14,    // the servos have no torque ceiling to lower
  SV_FINDING_LATE = 15,      // answers later than the line needs; value: by [us]
  // warnings
  SV_FINDING_TORQUE = 32,    // was on already
  SV_FINDING_WATCHDOG = 33,  // the servos have no bus watchdog
  SV_FINDING_SLOW = 34,      // every servo answers later than the line needs; value: by [us]
  SV_FINDING_OLD = 35        // as SV_FINDING_SENSOR, of one that nobody needs
} sv_finding;

typedef enum {
  SV_EVENT_RELEASED = 1,  // torque is off on every servo, as read back
  SV_EVENT_UNSURE = 2,    // a: joints whose torque is not known to be off, a bit each
  SV_EVENT_HELD = 3       // every servo holds its last goal
} sv_event;

#endif  // SV_REASON_H_
