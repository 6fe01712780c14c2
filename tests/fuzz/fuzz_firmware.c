// The whole firmware on a board whose every byte, input and moment is the fuzzer's.
//
// Behind the bus are servos that answer well unless the fuzzer says how not, so that it gets past the checks. The
// sensor node sends its lines every 10 ms. Required, whatever happens: memory and arithmetic are sound; the watchdog is
// fed; a run ends; and once it has ended, the last that was said of torque to every servo is to be off.

#include <string.h>

#include "fuzz_input.h"
#include "rig.h"
#include "sv_hal.h"
#include "sv_packets1.h"
#include "sv_packets2.h"
#include "sv_robot.h"

#define TABLE_MAX 1024
#define LINE_MAX 4096
#define WATCHDOG_US 150000
#define SENSORS_US 10000
#define NLINE 3
#define RUN_US_MAX 60000000

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

typedef struct {
  uint8_t bytes[LINE_MAX];
  int32_t n;
} line;

static struct {
  fuzz_input input;
  int64_t boot_us;
  int64_t now_us;
  int64_t fed_us;
  int64_t reply_us;  // when what is in `reply` has come
  int64_t sensors_us;
  line lines[NLINE];
  line reply;
  uint8_t tables[SV_JOINT_MAX][TABLE_MAX];
  uint8_t wrong;  // how the next question is answered
  uint8_t inputs;
  uint8_t silent;   // the sensor node
  uint8_t cause;    // of the reset
  uint32_t torque;  // by joint: what it was told last
  uint32_t seq;
} world;

static void put(line* to, const uint8_t* bytes, int32_t n) {
  for (int32_t i = 0; i < n && to->n < LINE_MAX; i++) {
    to->bytes[to->n++] = bytes[i];
  }
}

// the servos

static int32_t is_dynamixel(void) { return servolve_rig.protocol == SV_DYNAMIXEL2; }

static void set(int32_t joint, const sv_register* reg, int32_t count) {
  if (reg->size > 0) {
    sv_register_encode(reg, count, world.tables[joint] + reg->address);
  }
}

// as the checks want them
static void commission(void) {
  for (int32_t i = 0; i < servolve_rig.njoint; i++) {
    const sv_joint* joint = servolve_rig.joints + i;
    const sv_servo* servo = SV_SERVO(&servolve_rig, i);
    for (int32_t k = 0; k < servo->ncheck; k++) {
      const sv_check* check = servo->checks + k;
      set(i, &check->reg, check->kind == SV_FINDING_HIGH_LIMIT ? joint->goal_high : check->low);
    }
    if (!is_dynamixel()) {
      world.tables[i][3] = (uint8_t)servo->model;
      world.tables[i][4] = (uint8_t)(servo->model >> 8);
    }
    set(i, &servo->position, joint->neutral);
    set(i, &servo->temperature, 30);
  }
}

// Write a block; who is given a goal is there at once.
static void take_block(int32_t i, int32_t address, const uint8_t* data, int32_t n) {
  const sv_servo* servo = SV_SERVO(&servolve_rig, i);
  for (int32_t k = 0; k < n && address + k < TABLE_MAX; k++) {
    world.tables[i][address + k] = data[k];
  }
  if (address <= servo->goal.address && servo->goal.address < address + n && !servolve_rig.velocity_mode) {
    set(i, &servo->position, sv_register_decode(&servo->goal, world.tables[i] + servo->goal.address));
    // and an STS servo takes torque for it
    world.torque |= is_dynamixel() ? 0U : 1U << i;
  }
  if (address <= servo->torque.address && servo->torque.address < address + n) {
    const uint32_t bit = 1U << i;
    world.torque = data[servo->torque.address - address] != 0 ? world.torque | bit : world.torque & ~bit;
  }
}

// Answer one servo's question: the fuzzer may change, cut, delay or withhold it.
static void answer(int32_t i, const uint8_t* data, int32_t n) {
  uint8_t frame[SV_FRAME_MAX + 64];
  uint8_t* parameters = frame + (is_dynamixel() ? SV_PACKET2_PARAMETERS : SV_PACKET1_PARAMETERS);
  const uint8_t id = servolve_rig.joints[i].id;
  const uint8_t how = world.wrong;
  uint8_t error = 0;
  if (how & 1) {
    error = fuzz_byte(&world.input);
  }
  if (is_dynamixel()) {
    *parameters++ = error;
  }
  memcpy(parameters, data, (size_t)n);
  if (how & 2) {
    parameters[n > 0 ? fuzz_byte(&world.input) % n : 0] ^= fuzz_byte(&world.input);
  }
  int32_t size = is_dynamixel() ? sv_packet2_seal(frame, (int32_t)sizeof frame, id, SV_STATUS2, n + 1)
                                : sv_packet1_seal(frame, (int32_t)sizeof frame, id, error & 0x7F, n);
  if (how & 4) {
    frame[fuzz_byte(&world.input) % sizeof frame] ^= fuzz_byte(&world.input);
  }
  if ((how & 8) && size > 0) {
    size = fuzz_byte(&world.input) % size;
  }
  if (how & 16) {
    return;
  }
  put(&world.reply, frame, size);
}

static int32_t joint_of(uint8_t id) {
  for (int32_t i = 0; i < servolve_rig.njoint; i++) {
    if (servolve_rig.joints[i].id == id) {
      return i;
    }
  }
  return -1;
}

static void answer_block(uint8_t id, int32_t address, int32_t n) {
  const int32_t i = joint_of(id);
  if (i >= 0 && address + n <= TABLE_MAX && n <= SV_FRAME_MAX) {
    answer(i, world.tables[i] + address, n);
  }
}

// Carry out a question: a packet without stuffing.
static void obey(uint8_t id, uint8_t instruction, const uint8_t* parameters, int32_t n) {
  const int32_t wide = is_dynamixel() ? 2 : 1;
  const int32_t address = wide == 2 ? parameters[0] | parameters[1] << 8 : parameters[0];
  const int32_t size = parameters[wide];
  const int32_t i = joint_of(id);
  if (instruction == SV_PING2 && i >= 0) {
    const uint16_t model = SV_SERVO(&servolve_rig, i)->model;
    const uint8_t pong[3] = {(uint8_t)model, (uint8_t)(model >> 8), 46};
    answer(i, pong, is_dynamixel() ? 3 : 0);
  } else if (instruction == SV_READ2) {
    answer_block(id, address, size);
  } else if (instruction == SV_WRITE2 && i >= 0) {
    take_block(i, address, parameters + wide, n - wide);
    answer(i, parameters, 0);
  } else if (instruction == SV_SYNC_READ2) {
    for (int32_t k = 2 * wide; k < n; k++) {
      answer_block(parameters[k], address, size);
    }
  } else if (instruction == SV_SYNC_WRITE2) {
    for (int32_t k = 2 * wide; k + size < n; k += 1 + size) {
      take_block(joint_of(parameters[k]), address, parameters + k + 1, size);
    }
  }
}

static void hear(const uint8_t* frame, int32_t n) {
  uint8_t packet[SV_FRAME_MAX + 8] = {0};
  memcpy(packet, frame, (size_t)n);
  world.reply.n = 0;
  if (is_dynamixel()) {
    const int32_t nbody = sv_packet2_unstuff(packet);
    obey(packet[4], packet[7], packet + SV_PACKET2_PARAMETERS, nbody - 1);
  } else {
    obey(packet[2], packet[4], packet + SV_PACKET1_PARAMETERS, packet[3] - 2);
  }
  world.reply_us = world.now_us + 100 + (world.wrong & 32 ? (int64_t)fuzz_number(&world.input, 2) : 0);
  world.wrong = 0;
}

// the sensor node

static int32_t put_decimal(uint8_t* text, uint32_t value) {
  uint8_t digits[10];
  int32_t n = 0;
  do {
    digits[n++] = (uint8_t)('0' + value % 10);
    value /= 10;
  } while (value > 0);
  for (int32_t i = 0; i < n; i++) {
    text[i] = digits[n - 1 - i];
  }
  return n;
}

static void send_line(const sv_message* message) {
  static const char kHex[] = "0123456789ABCDEF";
  uint8_t text[200] = {'$', (uint8_t)message->letter, ','};
  int32_t n = 3 + put_decimal(text + 3, world.seq);
  text[n++] = ',';
  n += put_decimal(text + n, (uint32_t)world.now_us);
  for (int32_t i = 0; i < message->width; i++) {
    text[n++] = ',';
    text[n++] = (uint8_t)('0' + (world.silent & 6));
  }
  uint8_t check = 0;
  for (int32_t i = 1; i < n; i++) {
    check ^= text[i];
  }
  const uint8_t end[4] = {'*', (uint8_t)kHex[check >> 4], (uint8_t)kHex[check & 15], '\n'};
  put(&world.lines[SV_LINE_SENSORS], text, n);
  put(&world.lines[SV_LINE_SENSORS], end, 4);
}

static void send_lines(void) {
  for (int32_t i = 0; i < servolve_rig.nmessage; i++) {
    send_line(servolve_rig.messages + i);
  }
  world.seq++;
}

// the board

// one thing that may happen while the firmware waits
static void happen(void) {
  static const char* const kCommands[8] = {"arm\n",  "start\n",  "arm\nseconds 0.2\nstart\n", "stop\n", "goal 0.4 -1\n",
                                           "help\n", "status\n", "derate 0.5\nseconds 0.06\n"};
  uint8_t bytes[32];
  const uint8_t what = fuzz_byte(&world.input);
  const int32_t n = what >> 3;
  if (what == 0) {
    return;
  }
  switch (what & 7) {
    case 0:
      world.silent = fuzz_byte(&world.input);
      break;
    case 1:
      put(&world.lines[SV_LINE_SENSORS], bytes, fuzz_take(&world.input, bytes, n));
      break;
    case 2:
      put(&world.lines[SV_LINE_CONSOLE], bytes, fuzz_take(&world.input, bytes, n));
      break;
    case 3:
      put(&world.lines[SV_LINE_CONSOLE], (const uint8_t*)kCommands[n & 7], (int32_t)strlen(kCommands[n & 7]));
      break;
    case 4:
      put(&world.lines[SV_LINE_BUS], bytes, fuzz_take(&world.input, bytes, n));
      break;
    case 5:
      world.inputs = n & 3;
      break;
    default:
      world.wrong = fuzz_byte(&world.input);
      break;
  }
}

void sv_hal_init(void) {}
uint32_t sv_hal_inputs(void) { return world.inputs; }
uint32_t sv_hal_now_us(void) { return (uint32_t)world.now_us; }
int32_t sv_hal_reset_cause(void) { return world.cause; }

void sv_hal_feed_watchdog(void) { world.fed_us = world.now_us; }

void sv_hal_wait(uint32_t until_us) {
  happen();
  const int32_t wait_us = (int32_t)(until_us - (uint32_t)world.now_us);
  if (wait_us <= 0) {
    return;
  }
  // to the next thing that comes, or for a part of the time
  int64_t next_us = world.now_us + wait_us;
  if (world.reply.n > 0 && world.reply_us < next_us) {
    next_us = world.reply_us;
  }
  if (world.sensors_us < next_us) {
    next_us = world.sensors_us;
  }
  world.now_us = next_us > world.now_us ? next_us : world.now_us + 1;
  if (world.reply.n > 0 && world.reply_us <= world.now_us) {
    put(&world.lines[SV_LINE_BUS], world.reply.bytes, world.reply.n);
    world.reply.n = 0;
  }
  if (world.sensors_us <= world.now_us) {
    world.sensors_us += SENSORS_US;
    if (!(world.silent & 1)) {
      send_lines();
    }
  }
  REQUIRE(world.fed_us < 0 || world.now_us - world.fed_us <= WATCHDOG_US);
  // what never ends is no run: at the input's end somebody presses the button
  world.inputs = world.input.n == 0 ? SV_INPUT_STOP : world.inputs;
  REQUIRE(world.now_us - world.boot_us < RUN_US_MAX);
}

int32_t sv_hal_read(int32_t number, uint8_t* data, int32_t size) {
  line* from = world.lines + number;
  REQUIRE(number >= 0 && number < NLINE && size > 0);
  const int32_t n = from->n < size ? from->n : size;
  memcpy(data, from->bytes, (size_t)n);
  memmove(from->bytes, from->bytes + n, (size_t)(from->n - n));
  from->n -= n;
  return n;
}

int32_t sv_hal_write(int32_t number, const uint8_t* data, int32_t size) {
  REQUIRE(size > 0 && (number == SV_LINE_BUS || number == SV_LINE_CONSOLE));
  if (number == SV_LINE_BUS) {
    REQUIRE(size <= SV_FRAME_MAX);
    hear(data, size);
    return size;
  }
  return world.silent & 8 ? 0 : size;
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static sv_robot robot;
  static float registers[SERVOLVE_NREGISTER];
  static float memory[SERVOLVE_NSTATE > 0 ? SERVOLVE_NSTATE : 1];
  const fuzz_input input = {data, size};
  memset(&world, 0, sizeof world);
  memset(&robot, 0, sizeof robot);
  world.input = input;
  const uint8_t boot = fuzz_byte(&world.input);
  world.cause = boot % 3;
  // the clock begins anew in the middle of many a run
  world.boot_us = boot < 128 ? 0 : (int64_t)UINT32_MAX - 500000;
  world.now_us = world.boot_us;
  world.fed_us = -1;
  world.sensors_us = world.now_us + SENSORS_US;
  commission();
  sv_robot_init(&robot, &servolve_rig, servolve_selftest(), SERVOLVE_PROGRAM, registers, memory);
  while (world.input.n > 0 && world.now_us - world.boot_us < RUN_US_MAX / 2) {
    sv_robot_poll(&robot);
    // whoever may hold is told so by the rig
    REQUIRE(world.torque == 0 || servolve_rig.safety.stop_holds);
  }
  return 0;
}
