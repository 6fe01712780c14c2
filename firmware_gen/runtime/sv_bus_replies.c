#include "sv_bus_replies.h"

#include "sv_bus_late.h"
#include "sv_bus_line.h"
#include "sv_hal.h"
#include "sv_packets1.h"
#include "sv_packets2.h"

#define SV_STUFFING 2     // bytes that stuffing may add to a reply; an estimate that only moves deadlines
#define SV_PREFIX2 7      // bytes before what a packet's length counts
#define SV_AROUND_PART 4  // error, id and CRC of a part
#define SV_ID_MAX2 0xFC
#define SV_ALERT2 0x80

static int32_t sv_is_dynamixel(const sv_bus* bus) { return SV_PROTOCOL(SV_RIG(bus)) == SV_DYNAMIXEL2; }

sv_reply sv_bus_no_reply(sv_reply_status status) {
  const sv_reply reply = {(uint8_t)status, 0, 0, 0, 0, sv_hal_now_us()};
  return reply;
}

// Return the joint among those asked that has an id, -1: none.
static int32_t sv_joint_of(const sv_bus* bus, const sv_asked* asked, uint8_t id) {
  for (int32_t i = 0; i < asked->n; i++) {
    if (SV_RIG(bus)->joints[asked->joints[i]].id == id) {
      return asked->joints[i];
    }
  }
  return -1;
}

typedef struct {
  uint8_t id;
  uint8_t error;
  int32_t ndata;        // < 0: it has not even an error
  const uint8_t* data;  // in bus->received
  int32_t size;         // bytes of the packet as it was meant
} sv_status;

// Return the next status packet's place: SV_SCAN_PACKET => status, SV_SCAN_CORRUPT if there were bytes that hold none,
// SV_SCAN_SHORT if none comes by the deadline.
static int32_t sv_next_packet(sv_bus* bus, uint8_t id_max, sv_scan* scan) {
  for (;;) {
    *scan = sv_is_dynamixel(bus) ? sv_packet2_scan(bus->received, bus->nreceived, id_max)
                                 : sv_packet1_scan(bus->received, bus->nreceived);
    if (scan->result == SV_SCAN_PACKET) {
      sv_bus_drop(bus, scan->first);
      return SV_SCAN_PACKET;
    }
    if (scan->result == SV_SCAN_SHORT) {
      if (sv_bus_take(bus)) {
        continue;
      }
      if (bus->nreceived == 0) {
        return SV_SCAN_SHORT;
      }
    }
    sv_bus_drop(bus, scan->first + 1);
    return SV_SCAN_CORRUPT;
  }
}

static int32_t sv_same(const uint8_t* a, const uint8_t* b, int32_t n) {
  for (int32_t i = 0; i < n; i++) {
    if (a[i] != b[i]) {
      return 0;
    }
  }
  return 1;
}

// What was sent is not heard, once: an adapter that echoes makes the question its own answer in protocol 1.
static int32_t sv_is_echo(sv_bus* bus, int32_t size) {
  if (sv_is_dynamixel(bus) || bus->echoed || size != bus->nframe || !sv_same(bus->received, bus->frame, size)) {
    return 0;
  }
  bus->echoed = 1;
  return 1;
}

static sv_status sv_read_status(sv_bus* bus, int32_t size) {
  uint8_t* packet = bus->received;
  if (!sv_is_dynamixel(bus)) {
    const sv_status status = {packet[2], packet[4], packet[3] - 2, packet + SV_PACKET1_PARAMETERS, size};
    return status;
  }
  const int32_t nbody = sv_packet2_unstuff(packet);
  const sv_status status = {packet[4], packet[8], nbody - 2, packet + SV_PACKET2_PARAMETERS + 1,
                            SV_PREFIX2 + nbody + 2};
  return status;
}

// Return whether a status packet answers a question for `size` bytes: => reply.
static int32_t sv_judge(const sv_bus* bus, const sv_status* status, int32_t size, sv_reply* reply) {
  if (status->ndata < 0) {
    return 0;
  }
  *reply = sv_bus_no_reply(SV_REPLY_DATA);
  reply->error = status->error;
  // a Feetech servo's error says how it is, and nothing of the question
  reply->alert = sv_is_dynamixel(bus) ? (status->error & SV_ALERT2) != 0 : status->error != 0;
  if (sv_is_dynamixel(bus) && (status->error & ~SV_ALERT2) != 0) {
    reply->status = SV_REPLY_REFUSED;
    return 1;
  }
  reply->size = size;
  return status->ndata == size;
}

// Hold a joint's data: the first `wanted` bytes of a reply that may be longer.
static void sv_keep(sv_reply* reply, const uint8_t* from, int32_t wanted, uint8_t* data) {
  reply->size = reply->status == SV_REPLY_DATA ? wanted : 0;
  for (int32_t i = 0; i < reply->size; i++) {
    data[i] = from[i];
  }
}

// Collect one packet of each joint: => replies, data; => corrupt. Return which joints have answered, a bit each.
static uint32_t sv_collect(sv_bus* bus, const sv_asked* asked, int32_t wanted, sv_reply* replies, uint8_t* data,
                           int32_t* corrupt) {
  uint32_t answered = 0;
  const int32_t last = asked->joints[asked->n - 1];
  // replies come in the order of the question: who has not answered before the last one will not
  while ((answered >> last & 1U) == 0) {
    sv_scan scan;
    // an answer to a fast sync read that comes late is whole, and nobody's
    const uint8_t id_max = SV_FAST_SYNC_READ(SV_RIG(bus)) ? SV_PACKET2_BROADCAST : SV_ID_MAX2;
    const int32_t result = sv_next_packet(bus, id_max, &scan);
    if (result == SV_SCAN_SHORT) {
      break;
    }
    if (result == SV_SCAN_CORRUPT) {
      *corrupt = 1;
      continue;
    }
    if (!sv_is_echo(bus, scan.size)) {
      const sv_status status = sv_read_status(bus, scan.size);
      const int32_t joint = sv_joint_of(bus, asked, status.id);
      sv_reply reply;
      if (!sv_judge(bus, &status, asked->size, &reply)) {
        bus->strays += status.size;
      } else if (joint >= 0 && (answered >> joint & 1U) == 0) {
        answered |= UINT32_C(1) << joint;
        replies[joint - asked->first] = reply;
        sv_keep(&replies[joint - asked->first], status.data, wanted, data + (joint - asked->first) * wanted);
      }
    }
    sv_bus_drop(bus, scan.size);
  }
  return answered;
}

// Return whether the header of the answer to this fast sync read has come, and nothing before it.
static int32_t sv_is_fast(const sv_bus* bus, const sv_asked* asked) {
  const int32_t length = sv_bus_fast_size(asked) - SV_PREFIX2;
  const uint8_t header[SV_PACKET2_PARAMETERS] = {
      0xFF, 0xFF, 0xFD, 0, SV_PACKET2_BROADCAST, (uint8_t)length, (uint8_t)(length >> 8), SV_STATUS2};
  return bus->nreceived >= SV_PACKET2_PARAMETERS && sv_same(bus->received, header, SV_PACKET2_PARAMETERS);
}

// Take each joint's part of the packet that begins with the bytes received, as far as parts come: => replies, data;
// => corrupt. Return which joints have answered.
static uint32_t sv_take_parts(sv_bus* bus, const sv_asked* asked, int32_t wanted, sv_reply* replies, uint8_t* data,
                              int32_t* corrupt) {
  uint32_t answered = 0;
  uint16_t crc = sv_packet2_crc(0, bus->received, SV_PACKET2_PARAMETERS);
  int32_t begin = SV_PACKET2_PARAMETERS;
  for (int32_t i = 0; i < asked->n; i++) {
    const int32_t end = begin + 2 + asked->size;
    while (bus->nreceived < end + 2) {
      if (!sv_bus_take(bus)) {
        *corrupt = *corrupt || bus->nreceived > begin;
        return answered;
      }
    }
    const uint8_t* part = bus->received + begin;
    const sv_status status = {part[1], part[0], asked->size, part + 2, 0};
    const uint16_t said = (uint16_t)(bus->received[end] | bus->received[end + 1] << 8);
    const int32_t joint = asked->joints[i];
    const int32_t place = joint - asked->first;
    if (sv_packet2_crc(crc, part, end - begin) != said || status.id != SV_RIG(bus)->joints[joint].id) {
      *corrupt = 1;
    } else if (sv_judge(bus, &status, asked->size, &replies[place])) {
      answered |= UINT32_C(1) << joint;
      sv_keep(&replies[place], status.data, wanted, data + place * wanted);
    }
    // who follows has gone on from the CRC that was sent here, whatever became of this part's other bytes
    crc = sv_packet2_crc(said, bus->received + end, 2);
    begin = end + 2;
  }
  return answered;
}

// Collect the one packet in which all joints answer a fast sync read; likewise.
static uint32_t sv_collect_fast(sv_bus* bus, const sv_asked* asked, int32_t wanted, sv_reply* replies, uint8_t* data,
                                int32_t* corrupt) {
  for (;;) {
    // a packet begins where the scan says, whether it is whole or not
    const sv_scan scan = sv_packet2_scan(bus->received, bus->nreceived, SV_PACKET2_BROADCAST);
    sv_bus_drop(bus, scan.first);
    if (sv_is_fast(bus, asked)) {
      return sv_take_parts(bus, asked, wanted, replies, data, corrupt);
    }
    if (scan.result == SV_SCAN_PACKET) {
      bus->strays += scan.size;
      sv_bus_drop(bus, scan.size);
    } else if (scan.result == SV_SCAN_CORRUPT || !sv_bus_take(bus)) {
      if (bus->nreceived == 0) {
        return 0;
      }
      *corrupt = 1;
      sv_bus_drop(bus, 1);
    }
  }
}

int32_t sv_bus_fast_size(const sv_asked* asked) {
  return SV_PACKET2_PARAMETERS + asked->n * (asked->size + SV_AROUND_PART);
}

void sv_bus_receive(sv_bus* bus, const sv_asked* asked, int32_t wanted, sv_reply* replies, uint8_t* data) {
  const int32_t around = sv_is_dynamixel(bus) ? SV_PACKET2_STATUS + SV_STUFFING : SV_PACKET1_STATUS;
  const int32_t fast = SV_FAST_SYNC_READ(SV_RIG(bus)) && asked->fast;
  const int32_t nbyte = fast ? sv_bus_fast_size(asked) : asked->n * (around + asked->size);
  sv_bus_expect(bus, nbyte, asked->n);
  bus->echoed = 0;
  int32_t corrupt = 0;
  const uint32_t answered = fast ? sv_collect_fast(bus, asked, wanted, replies, data, &corrupt)
                                 : sv_collect(bus, asked, wanted, replies, data, &corrupt);
  // what was read and not used was part of a transaction that is over
  bus->nreceived = 0;
  int32_t lost = 0;
  for (int32_t i = 0; i < asked->n; i++) {
    const int32_t joint = asked->joints[i];
    if ((answered >> joint & 1U) == 0) {
      lost = 1;
      sv_reply* reply = replies + (joint - asked->first);
      *reply = sv_bus_no_reply(corrupt ? SV_REPLY_CORRUPT : SV_REPLY_MISSING);
      reply->late = !corrupt && bus->strays > bus->strays_seen[joint];
    }
    bus->strays_seen[joint] = bus->strays;
  }
  if (lost) {
    sv_bus_remember_late(bus, asked->size);
  }
}
