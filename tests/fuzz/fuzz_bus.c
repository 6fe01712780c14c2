// Any bytes in any pieces as servos' answers: every question is over in time, and no reply is more than was asked for.

#include <string.h>

#include "fuzz_input.h"
#include "sv_bus.h"
#include "sv_hal.h"
#include "sv_packets1.h"
#include "sv_packets2.h"

#define DATA_MAX (SV_JOINT_MAX * SV_BLOCK_MAX)
#define CANARY 0xA5
#define QUESTIONS_MAX 40

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

static fuzz_input input;
static int64_t world_us;
static uint8_t sent[SV_FRAME_MAX];
static int32_t nsent;
static int32_t baud;
static int32_t dynamixel;

void sv_hal_init(void) {}
uint32_t sv_hal_inputs(void) { return 0; }
void sv_hal_feed_watchdog(void) {}
int32_t sv_hal_reset_cause(void) { return SV_RESET_POWER; }
uint32_t sv_hal_now_us(void) { return (uint32_t)world_us; }

// early, because of another line, or in time
void sv_hal_wait(uint32_t until_us) {
  const int32_t early_us = 1 + fuzz_byte(&input);
  const int32_t wait_us = (int32_t)(until_us - (uint32_t)world_us);
  REQUIRE(wait_us > 0);
  world_us += (fuzz_byte(&input) & 3) != 0 && early_us < wait_us ? early_us : wait_us;
}

// a sound status packet of the fuzzer's bytes
static int32_t seal(uint8_t* frame, int32_t n) {
  const int32_t first = dynamixel ? SV_PACKET2_PARAMETERS : SV_PACKET1_PARAMETERS;
  const uint8_t id = (uint8_t)(1 + (fuzz_byte(&input) & 15));
  const int32_t taken = fuzz_take(&input, frame + first, n);
  return dynamixel ? sv_packet2_seal(frame, SV_FRAME_MAX, id, SV_STATUS2, taken)
                   : sv_packet1_seal(frame, SV_FRAME_MAX, id, 0, taken);
}

// what the fuzzer says, a sound packet of it, or what was asked
int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) {
  REQUIRE(line == SV_LINE_BUS && size > 0);
  const uint8_t how = fuzz_byte(&input);
  if ((how & 3) == 0) {
    return 0;
  }
  if ((how & 3) == 1) {
    return fuzz_take(&input, data, (how >> 2) < size ? how >> 2 : size);
  }
  uint8_t frame[SV_FRAME_MAX];
  const int32_t nframe = (how & 3) == 2 ? seal(frame, how >> 2) : nsent;
  const int32_t n = nframe < size ? nframe : size;
  memcpy(data, (how & 3) == 2 ? frame : sent, (size_t)n);
  return n;
}

int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  REQUIRE(line == SV_LINE_BUS && size > 0 && size <= SV_FRAME_MAX);
  memcpy(sent, data, (size_t)size);
  nsent = size;
  world_us += 1 + (int64_t)size * 10000000 / baud;  // as on silicon
  return fuzz_byte(&input) == 1 ? size - 1 : size;
}

// the longest that one question may take
static int64_t bound_us(const sv_rig* rig, int32_t size) {
  const int64_t nbyte = SV_FRAME_MAX + (int64_t)rig->njoint * (size + 7 + 13);
  return nbyte * 10000000 / rig->baud + 2 + rig->njoint * rig->return_delay_us + rig->patience_us + 300;
}

static void ask(sv_bus* bus, uint8_t* data, int32_t size) {
  sv_reply replies[SV_JOINT_MAX];
  int32_t status = SV_REPLY_MISSING;
  const int64_t asked_us = world_us;
  const int32_t joint = fuzz_byte(&input) % bus->rig->njoint;
  const int32_t kind = fuzz_byte(&input) % 6;
  const int32_t address = (int32_t)fuzz_number(&input, 2);
  const int32_t nreply = kind == 3 ? bus->rig->njoint : 1;
  uint16_t model = 0;
  int32_t count = 0;
  const sv_register reg = {(uint16_t)address, (uint8_t)(1 << (address & 1)), (uint8_t)(address % 5)};
  memset(data, CANARY, DATA_MAX + 1);
  memset(replies, 0, sizeof replies);
  if (kind == 0) {
    status = sv_bus_ping(bus, joint, &model);
  } else if (kind == 1) {
    status = sv_bus_read(bus, joint, address, size, data);
    REQUIRE(data[size] == CANARY);
  } else if (kind == 2) {
    status = sv_bus_write(bus, joint, address, data, size);
  } else if (kind == 3) {
    sv_bus_sync_read(bus, address, size, replies, data);
    REQUIRE(data[nreply * size] == CANARY);
  } else if (kind == 4) {
    sv_bus_sync_write(bus, address, size, data);
  } else {
    status = sv_bus_write_register(bus, joint, &reg, (int32_t)fuzz_number(&input, 4), 3, &count);
  }
  if (kind != 3 && kind != 4) {
    REQUIRE(status == bus->reply.status);
    replies[0] = bus->reply;
  }
  for (int32_t i = 0; i < nreply; i++) {
    REQUIRE(replies[i].status <= SV_REPLY_CORRUPT);
    // who says nothing writes nothing
    REQUIRE(replies[i].status == SV_REPLY_DATA || data[i * size] == CANARY);
    REQUIRE(kind == 4 || (uint32_t)world_us - replies[i].t_us <= world_us - asked_us);
  }
}

int LLVMFuzzerTestOneInput(const uint8_t* bytes, size_t size) {
  static uint8_t data[DATA_MAX + 1];
  static const int32_t kBauds[4] = {1000000, 57600, 4500000, 9600};
  sv_joint joints[SV_JOINT_MAX];
  sv_bus bus;
  const fuzz_input all = {bytes, size};
  input = all;
  nsent = 0;
  memset(joints, 0, sizeof joints);
  for (int32_t i = 0; i < SV_JOINT_MAX; i++) {
    joints[i].id = (uint8_t)(1 + i);
  }
  const uint8_t what = fuzz_byte(&input);
  world_us = what >> 5 & 1 ? 0 : 0xFFFFFF00;
  const sv_rig rig = {.protocol = what & 1 ? SV_FEETECH_STS : SV_DYNAMIXEL2,
                      .fast_sync_read = what >> 1 & 1,
                      .baud = kBauds[what >> 2 & 3],
                      .patience_us = 1000,
                      .return_delay_us = what >> 4 & 1 ? 500 : 0,
                      .njoint = 1 + fuzz_byte(&input) % SV_JOINT_MAX,
                      .joints = joints};
  baud = rig.baud;
  dynamixel = rig.protocol == SV_DYNAMIXEL2;
  sv_bus_init(&bus, &rig);
  for (int32_t i = 0; i < QUESTIONS_MAX && input.n > 0; i++) {
    const int64_t begin_us = world_us;
    const int32_t wanted = 1 + fuzz_byte(&input) % SV_BLOCK_MAX;
    ask(&bus, data, wanted);
    // six questions at most: a register is written and read back, three times each and each read perhaps twice
    REQUIRE(world_us - begin_us <= 9 * bound_us(&rig, wanted));
    world_us += fuzz_number(&input, 2);
  }
  return 0;
}
