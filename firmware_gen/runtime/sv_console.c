#include "sv_console.h"

#include "sv_hal.h"
#include "sv_log.h"

#define SV_DIGITS_MAX 9
#define SV_SECONDS_MAX 4000U
#define SV_MICRO_PLACES 6
#define SV_STEADY_US 30000U  // a button that has not changed for so long does not bounce
#define SV_CHUNKS_MAX 64     // reads in one go: no babbling line holds it up

static const float kGoalMax = 1000.0F;  // [m], [rad]

const char* sv_decimal_parse(const char* text, sv_decimal* decimal) {
  int32_t ndigit = 0;
  int32_t behind = 0;
  decimal->mantissa = 0;
  decimal->places = 0;
  while (*text == ' ') {
    text++;
  }
  decimal->negative = *text == '-';
  text += decimal->negative;
  for (int32_t any = 0;; text++, any = 1) {
    if (*text == '.' && !behind) {
      behind = 1;
      continue;
    }
    if (*text < '0' || *text > '9') {
      return any && (*text == ' ' || *text == '\0') && text[-1] != '.' ? text : 0;
    }
    ndigit += decimal->mantissa > 0 || *text != '0';
    decimal->places = (uint8_t)(decimal->places + behind);
    if (ndigit > SV_DIGITS_MAX || decimal->places > SV_DIGITS_MAX) {
      return 0;
    }
    decimal->mantissa = 10U * decimal->mantissa + (uint32_t)(*text - '0');
  }
}

static uint32_t sv_ten(int32_t power) {
  uint32_t ten = 1;
  for (int32_t i = 0; i < power; i++) {
    ten *= 10U;
  }
  return ten;
}

float sv_decimal_float(const sv_decimal* decimal) {
  union {
    uint32_t u;
    float f;
  } word = {(uint32_t)decimal->negative << 31};
  uint32_t part = decimal->mantissa;
  uint32_t whole = sv_ten(decimal->places);
  if (part == 0U) {
    return word.f;
  }
  // part / whole in [1, 2)
  int32_t exponent = 0;
  for (; part < whole; exponent--) {
    part *= 2U;
  }
  for (; part >= 2U * whole; exponent++) {
    whole *= 2U;
  }
  // long division: 24 bits, then half to even
  uint32_t bits = 0;
  for (int32_t i = 0; i < 24; i++) {
    bits = 2U * bits + (part >= whole);
    part = 2U * (part >= whole ? part - whole : part);
  }
  bits += part > whole || (part == whole && (bits & 1U) != 0U);
  // the hidden bit, or the carry of the rounding, adds to the exponent
  word.u |= ((uint32_t)(exponent + 126) << 23) + bits;
  return word.f;
}

// Read a number that is to lie in low..high: => value.
static const char* sv_number(const char* text, float low, float high, float* value) {
  sv_decimal decimal;
  const char* rest = sv_decimal_parse(text, &decimal);
  const float number = rest ? sv_decimal_float(&decimal) : 0.0F;
  if (!rest || number < low || number > high) {
    return 0;
  }
  *value = number;
  return rest;
}

static int32_t sv_set_goal(sv_robot* robot, const char* text) {
  sv_goal goal = {0.0F, 0.0F};
  const char* rest = sv_number(text, -kGoalMax, kGoalMax, &goal.goal_dist);
  if (rest && *rest != '\0') {
    rest = sv_number(rest, -kGoalMax, kGoalMax, &goal.goal_bearing);
  }
  if (!rest || *rest != '\0') {
    return 0;
  }
  robot->wish.goal = goal;
  return 1;
}

// periods: half to even, as the host rounds
static int32_t sv_set_seconds(sv_robot* robot, const char* text) {
  sv_decimal decimal;
  const char* rest = sv_decimal_parse(text, &decimal);
  if (!rest || *rest != '\0' || decimal.negative || decimal.places > SV_MICRO_PLACES ||
      decimal.mantissa / sv_ten(decimal.places) >= SV_SECONDS_MAX) {
    return 0;
  }
  const uint32_t us = decimal.mantissa * sv_ten(SV_MICRO_PLACES - decimal.places);
  const uint32_t period_us = (uint32_t)SV_RIG(robot)->period_us;
  const uint32_t periods = us / period_us;
  const uint32_t twice = 2U * (us % period_us);
  robot->wish.periods = (int32_t)(periods + (twice > period_us || (twice == period_us && periods % 2U != 0U)));
  return 1;
}

static int32_t sv_set_derating(sv_robot* robot, const char* text) {
  float part = 0.0F;
  const char* rest = sv_number(text, 0.0F, 1.0F, &part);
  if (!rest || *rest != '\0' || !(part > 0.0F)) {
    return 0;
  }
  robot->wish.derate = part;
  return 1;
}

static int32_t sv_print_status(const sv_robot* robot) {
  static const char* const kStates[] = {"off", "checked", "armed", "homing", "running", "stopping", "fault"};
  sv_print(kStates[robot->state]);
  sv_print(robot->wish.arm ? " armed, ended by" : " disarmed, ended by");
  sv_print_number(robot->watch.why.reason);
  sv_print_number(robot->watch.why.joint);
  sv_print_number(robot->watch.why.a);
  sv_print_number(robot->watch.why.b);
  sv_print(", cycles");
  sv_print_number(robot->counts.cycles);
  sv_print("\r\n");
  return 1;
}

// Return what stands behind a command's word, 0 if the line holds another command.
static const char* sv_behind(const char* line, const char* word) {
  while (*word != '\0') {
    if (*line++ != *word++) {
      return 0;
    }
  }
  return *line == '\0' || *line == ' ' ? line : 0;
}

static int32_t sv_is(const char* line, const char* word) {
  const char* rest = sv_behind(line, word);
  return rest && *rest == '\0';
}

// Carry out what may be asked while a run goes on; return 0 if it is none of these.
static int32_t sv_command_always(sv_robot* robot, const char* line) {
  if (sv_behind(line, "stop")) {
    robot->wish.stop = SV_REASON_STOP_COMMAND;
    return 1;
  }
  return sv_behind(line, "status") ? sv_print_status(robot) : 0;
}

// A stop that comes from now on is one of the run.
static void sv_wish_start(sv_robot* robot) {
  robot->wish.start = 1;
  robot->wish.stop = SV_REASON_NONE;
}

// Carry out a command between runs; return 0 if there is no such.
static int32_t sv_command(sv_robot* robot, const char* line) {
  const char* rest = sv_behind(line, "goal");
  if (rest) {
    return sv_set_goal(robot, rest);
  }
  rest = sv_behind(line, "seconds");
  if (rest) {
    return sv_set_seconds(robot, rest);
  }
  rest = sv_behind(line, "derate");
  if (rest) {
    return sv_set_derating(robot, rest);
  }
  if (sv_is(line, "arm") || sv_is(line, "disarm")) {
    robot->wish.arm = line[0] == 'a';
    return 1;
  }
  if (!sv_is(line, "start")) {
    return 0;
  }
  sv_wish_start(robot);
  return 1;
}

static void sv_obey(sv_robot* robot, const char* line) {
  if (line[0] == '\0') {
    return;
  }
  if (sv_behind(line, "help")) {
    sv_print("goal D [BEARING], seconds S, derate X, arm, disarm, start, stop, status\r\n");
  } else if (sv_command_always(robot, line)) {
    sv_print("ok\r\n");
  } else if (robot->wish.start) {
    sv_print("busy: stop, or wait\r\n");
  } else {
    sv_print(sv_command(robot, line) ? "ok\r\n" : "what? try help\r\n");
  }
}

// Take one byte; a line that is too long, or holds what nobody types, is no command.
static void sv_take(sv_robot* robot, uint8_t byte) {
  if (byte != '\r' && byte != '\n') {
    if (byte < ' ' || byte > '~') {
      robot->ncommand = SV_COMMAND_MAX;
    } else if (robot->ncommand < SV_COMMAND_MAX) {
      robot->command[robot->ncommand++] = (char)byte;
    }
    return;
  }
  if (robot->ncommand == SV_COMMAND_MAX) {
    robot->command[0] = '?';
    robot->ncommand = 1;
  }
  robot->command[robot->ncommand] = '\0';
  robot->ncommand = 0;
  sv_obey(robot, robot->command);
}

static void sv_look_at_inputs(sv_robot* robot) {
  const uint32_t inputs = sv_hal_inputs();
  const uint32_t now_us = sv_hal_now_us();
  const uint8_t closed = (inputs & (uint32_t)SV_INPUT_START) != 0U;
  if ((inputs & (uint32_t)SV_INPUT_STOP) != 0U && robot->wish.stop == SV_REASON_NONE) {
    robot->wish.stop = SV_REASON_STOP_INPUT;
  }
  if (closed != robot->closed) {
    robot->closed = closed;
    robot->turned_us = now_us;
  }
  if (closed == robot->pressed || now_us - robot->turned_us < SV_STEADY_US) {
    return;
  }
  // only a button that was open, and is closed now, was pressed
  robot->pressed = closed;
  if (closed && !robot->wish.start) {
    robot->wish.arm = 1;
    sv_wish_start(robot);
  }
}

void sv_console_listen(sv_robot* robot) {
  uint8_t bytes[16];
  sv_look_at_inputs(robot);
  for (int32_t chunk = 0; chunk < SV_CHUNKS_MAX; chunk++) {
    const int32_t n = sv_hal_read(SV_LINE_CONSOLE, bytes, (int32_t)sizeof bytes);
    if (n <= 0) {
      return;
    }
    for (int32_t i = 0; i < n; i++) {
      sv_take(robot, bytes[i]);
    }
  }
}
