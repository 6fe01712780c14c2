#include "sv_bus.h"

#include "sv_bus_late.h"
#include "sv_bus_line.h"
#include "sv_bus_replies.h"
#include "sv_hal.h"
#include "sv_packets1.h"
#include "sv_packets2.h"

#define SV_MODEL_ADDRESS1 3
#define SV_MODEL_SIZE1 2
#define SV_PONG_SIZE2 3  // model and firmware

// questions

static int32_t sv_is_dynamixel(const sv_rig* rig) { return SV_PROTOCOL(rig) == SV_DYNAMIXEL2; }

// Return where a frame's parameters begin. What puts some there returns where the next go.
static int32_t sv_parameters(const sv_rig* rig) {
  return sv_is_dynamixel(rig) ? SV_PACKET2_PARAMETERS : SV_PACKET1_PARAMETERS;
}

// Put bytes; the end of the frame where they do not fit, which no packet may reach.
static int32_t sv_put_bytes(uint8_t* frame, int32_t at, const uint8_t* bytes, int32_t n) {
  if (n > SV_FRAME_MAX - at) {
    return SV_FRAME_MAX;
  }
  for (int32_t i = 0; i < n; i++) {
    frame[at + i] = bytes[i];
  }
  return at + n;
}

// Put an address or a size, as long as the protocol writes it, where there is room.
static int32_t sv_put(const sv_rig* rig, uint8_t* frame, int32_t at, int32_t value) {
  frame[at++] = (uint8_t)value;
  if (sv_is_dynamixel(rig)) {
    frame[at++] = (uint8_t)(value >> 8);
  }
  return at;
}

// Put what questions for several registers begin with.
static int32_t sv_put_block(const sv_rig* rig, uint8_t* frame, int32_t address, int32_t size) {
  return sv_put(rig, frame, sv_put(rig, frame, sv_parameters(rig), address), size);
}

// Frame the parameters that end at `end`: return the frame's bytes, 0 if it does not fit. The instructions have the
// same numbers in both protocols.
static int32_t sv_seal(const sv_rig* rig, uint8_t* frame, uint8_t id, uint8_t instruction, int32_t end) {
  const int32_t n = end - sv_parameters(rig);
  return sv_is_dynamixel(rig) ? sv_packet2_seal(frame, SV_FRAME_MAX, id, instruction, n)
                              : sv_packet1_seal(frame, SV_FRAME_MAX, id, instruction, n);
}

// Send the parameters that end at `end`; return whether the packet went out.
static int32_t sv_send(sv_bus* bus, uint8_t id, uint8_t instruction, int32_t end) {
  return sv_bus_send(bus, sv_seal(SV_RIG(bus), bus->frame, id, instruction, end));
}

int32_t sv_bus_sync_write_frame(const sv_rig* rig, int32_t address, int32_t size, const uint8_t* data, uint8_t* frame) {
  int32_t at = sv_put_block(rig, frame, address, size);
  for (int32_t joint = 0; joint < rig->njoint; joint++) {
    at = sv_put_bytes(frame, at, &rig->joints[joint].id, 1);
    at = sv_put_bytes(frame, at, data + joint * size, size);
  }
  return sv_seal(rig, frame, SV_PACKET2_BROADCAST, SV_SYNC_WRITE2, at);
}

// transactions

void sv_bus_init(sv_bus* bus, const sv_rig* rig) {
  SV_SET_RIG(bus, rig);
  bus->silent = 0;
  bus->whole = 0;
  bus->strays = 0;
  for (int32_t i = 0; i < SV_JOINT_MAX; i++) {
    bus->strays_seen[i] = 0;
  }
  bus->line_from_us = 0;
  bus->line_nbyte = 0;
  bus->patience_us = rig->patience_us;
  bus->nbyte = 0;
  sv_bus_forget_late(bus);
}

// Ask one joint with the parameters that end at `end`, for `size` data bytes: => the first `wanted` of them.
static int32_t sv_ask(sv_bus* bus, int32_t joint, uint8_t instruction, int32_t end, int32_t size, int32_t wanted,
                      uint8_t* data) {
  const uint8_t joints[1] = {(uint8_t)joint};
  const sv_asked asked = {joints, 1, size, wanted, joint, &bus->reply, data};
  sv_bus_receive(bus, &asked, sv_send(bus, SV_RIG(bus)->joints[joint].id, instruction, end));
  return bus->reply.status;
}

int32_t sv_bus_ping(sv_bus* bus, int32_t joint, uint16_t* model) {
  uint8_t data[SV_PONG_SIZE2] = {0};
  const int32_t size = sv_is_dynamixel(SV_RIG(bus)) ? SV_PONG_SIZE2 : 0;
  int32_t status = sv_ask(bus, joint, SV_PING2, sv_parameters(SV_RIG(bus)), size, size, data);
  if (!sv_is_dynamixel(SV_RIG(bus)) && (status != SV_REPLY_MISSING || bus->echoed)) {
    // the answer of a servo whose only error is its voltage equals the question: what it says next is no echo
    status = sv_bus_read(bus, joint, SV_MODEL_ADDRESS1, SV_MODEL_SIZE1, data);
  }
  *model = (uint16_t)(data[0] | (uint32_t)data[1] << 8);
  return status;
}

int32_t sv_bus_read(sv_bus* bus, int32_t joint, int32_t address, int32_t size, uint8_t* data) {
  for (int32_t asked = sv_bus_unlike_late(bus, size);; asked = size) {
    const int32_t end = sv_put_block(SV_RIG(bus), bus->frame, address, asked);
    const int32_t status = sv_ask(bus, joint, SV_READ2, end, asked, size, data);
    // where it is refused, there may be nothing behind the block
    if (status != SV_REPLY_REFUSED || asked == size) {
      return status;
    }
  }
}

int32_t sv_bus_write(sv_bus* bus, int32_t joint, int32_t address, const uint8_t* data, int32_t size) {
  const int32_t begin = sv_put(SV_RIG(bus), bus->frame, sv_parameters(SV_RIG(bus)), address);
  return sv_ask(bus, joint, SV_WRITE2, sv_put_bytes(bus->frame, begin, data, size), 0, 0, 0);
}

// Ask several joints for as many bytes as are wanted, and perhaps a few more; return as sv_bus_receive does.
static int32_t sv_sync_read_once(sv_bus* bus, sv_asked* asked, uint8_t instruction, int32_t address) {
  asked->size = sv_bus_unlike_late(bus, asked->wanted);
  int32_t at = sv_put_block(SV_RIG(bus), bus->frame, address, asked->size);
  for (int32_t i = 0; i < asked->n; i++) {
    bus->frame[at++] = SV_RIG(bus)->joints[asked->joints[i]].id;
  }
  return sv_bus_receive(bus, asked, sv_send(bus, SV_PACKET2_BROADCAST, instruction, at));
}

// Return which joints' replies are missing, a bit each.
static uint32_t sv_missing(const sv_bus* bus, const sv_reply* replies) {
  uint32_t missing = 0;
  for (int32_t joint = 0; joint < SV_RIG(bus)->njoint; joint++) {
    missing |= replies[joint].status == SV_REPLY_MISSING ? UINT32_C(1) << joint : 0U;
  }
  return missing;
}

// Append the joints of a set to a list of n; return how many it has then.
static int32_t sv_list(uint32_t joints, uint8_t* list, int32_t n) {
  for (int32_t joint = 0; joint < SV_JOINT_MAX; joint++) {
    if ((joints >> joint & 1U) != 0) {
      list[n++] = (uint8_t)joint;
    }
  }
  return n;
}

static uint32_t sv_all(const sv_bus* bus) { return (UINT32_C(1) << SV_RIG(bus)->njoint) - 1U; }

// Ask one by one in one question. Servos answer in its order, each after the one before it, so a silent one silences
// all behind it: they are asked once more without it, and from then on it is asked last, where it keeps nobody waiting.
static void sv_sync_read_in_turn(sv_bus* bus, uint32_t joints, int32_t address, int32_t size, sv_reply* replies,
                                 uint8_t* data) {
  uint8_t order[SV_JOINT_MAX];
  const int32_t first = sv_list(joints & ~bus->silent, order, 0);
  const int32_t n = sv_list(joints & bus->silent, order, first);
  sv_asked asked = {order, n, size, size, 0, replies, data};
  const int32_t heard = sv_sync_read_once(bus, &asked, SV_SYNC_READ2, address);
  if (heard < first && heard + 1 < n) {
    bus->silent |= UINT32_C(1) << order[heard];
    asked.joints = order + heard + 1;
    asked.n = n - heard - 1;
    (void)sv_sync_read_once(bus, &asked, SV_SYNC_READ2, address);
  }
}

// Ask for one packet of all: none comes where one servo is silent. Return who is missing, a bit each.
static uint32_t sv_sync_read_fast(sv_bus* bus, int32_t address, int32_t size, sv_reply* replies, uint8_t* data) {
  uint8_t order[SV_JOINT_MAX];
  const int32_t n = sv_list(sv_all(bus), order, 0);
  sv_asked all = {order, n, size + SV_LENGTHS - 1, size, 0, replies, data};
  if (sv_bus_fast_size(&all) > (int32_t)sizeof bus->received) {
    return sv_all(bus);
  }
  (void)sv_sync_read_once(bus, &all, SV_FAST_SYNC_READ2, address);
  return sv_missing(bus, replies);
}

void sv_bus_sync_read(sv_bus* bus, int32_t address, int32_t size, sv_reply* replies, uint8_t* data) {
  uint32_t joints = sv_all(bus);
  if (SV_FAST_SYNC_READ(SV_RIG(bus)) && bus->whole) {
    joints = sv_sync_read_fast(bus, address, size, replies, data);
  }
  if (joints != 0) {
    sv_sync_read_in_turn(bus, joints, address, size, replies, data);
  }
  bus->whole = SV_FAST_SYNC_READ(SV_RIG(bus)) && sv_missing(bus, replies) == 0;
}

void sv_bus_sync_write(sv_bus* bus, int32_t address, int32_t size, const uint8_t* data) {
  (void)sv_bus_send(bus, sv_bus_sync_write_frame(SV_RIG(bus), address, size, data, bus->frame));
}

int32_t sv_bus_read_register(sv_bus* bus, int32_t joint, const sv_register* reg, int32_t attempts, int32_t* count) {
  uint8_t data[sizeof(int32_t)] = {0};
  int32_t status = SV_REPLY_MISSING;
  for (int32_t i = 0; i < attempts && status >= SV_REPLY_MISSING; i++) {
    status = sv_bus_read(bus, joint, reg->address, reg->size, data);
  }
  *count = sv_register_decode(reg, data);
  return status;
}

int32_t sv_bus_write_register(sv_bus* bus, int32_t joint, const sv_register* reg, int32_t count, int32_t attempts,
                              int32_t* held) {
  uint8_t data[sizeof(int32_t)];
  sv_register_encode(reg, count, data);
  int32_t status = SV_REPLY_MISSING;
  for (int32_t i = 0; i < attempts && status >= SV_REPLY_MISSING; i++) {
    status = sv_bus_write(bus, joint, reg->address, data, reg->size);
  }
  // a lost answer tells nothing: what the register holds does
  return status == SV_REPLY_REFUSED ? status : sv_bus_read_register(bus, joint, reg, attempts, held);
}
