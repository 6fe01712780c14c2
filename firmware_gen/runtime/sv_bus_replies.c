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

// Return the place of a joint's reply.
static sv_reply* sv_place(const sv_asked* asked, int32_t joint) { return asked->replies + (joint - asked->first); }

// Return the joint that has an id, -1 if none has that was asked and has not answered.
static int32_t sv_joint_of(const sv_bus* bus, const sv_asked* asked, uint8_t id) {
  for (int32_t i = 0; i < asked->n; i++) {
    const int32_t joint = asked->joints[i];
    if (SV_RIG(bus)->joints[joint].id == id && sv_place(asked, joint)->status == SV_REPLY_MISSING) {
      return joint;
    }
  }
  return -1;
}

// Return the bytes of the status packet that the received ones begin with, once it has come; 0 if none comes by the
// deadline: => whether there were bytes that hold none.
static int32_t sv_next_packet(sv_bus* bus, int32_t* corrupt) {
  for (;;) {
    // an answer to a fast sync read that comes late is whole, and nobody's
    const uint8_t id_max = SV_FAST_SYNC_READ(SV_RIG(bus)) ? SV_PACKET2_BROADCAST : SV_ID_MAX2;
    const sv_scan scan = sv_is_dynamixel(bus) ? sv_packet2_scan(bus->received, bus->nreceived, id_max)
                                              : sv_packet1_scan(bus->received, bus->nreceived);
    sv_bus_drop(bus, scan.first);
    if (scan.result == SV_SCAN_PACKET) {
      return scan.size;
    }
    if (scan.result == SV_SCAN_CORRUPT || !sv_bus_take(bus)) {
      if (bus->nreceived == 0) {
        return 0;
      }
      *corrupt = 1;
      sv_bus_drop(bus, 1);
    }
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

// Hear what a servo says, joint -1: nobody's; return whether it answers the question.
static int32_t sv_hear(sv_bus* bus, const sv_asked* asked, int32_t joint, uint8_t error, const uint8_t* data,
                       int32_t ndata) {
  // a Feetech servo's error says how it is, and nothing of the question
  const int32_t refused = sv_is_dynamixel(bus) && (error & ~SV_ALERT2) != 0;
  if (ndata < 0 || (!refused && ndata != asked->size)) {
    return 0;
  }
  if (joint >= 0) {
    const sv_reply reply = {refused ? SV_REPLY_REFUSED : SV_REPLY_DATA, error, 0, sv_hal_now_us()};
    *sv_place(asked, joint) = reply;
    bus->silent &= ~(UINT32_C(1) << joint);
    for (int32_t i = 0; i < asked->wanted && !refused; i++) {
      asked->data[(joint - asked->first) * asked->wanted + i] = data[i];
    }
  }
  return 1;
}

// Hear the packet of `size` bytes that the received ones begin with.
static void sv_hear_packet(sv_bus* bus, const sv_asked* asked, int32_t size) {
  uint8_t* packet = bus->received;
  if (sv_is_dynamixel(bus)) {
    const int32_t ndata = sv_packet2_unstuff(packet) - 2;
    if (!sv_hear(bus, asked, sv_joint_of(bus, asked, packet[4]), packet[8], packet + SV_PACKET2_PARAMETERS + 1,
                 ndata)) {
      bus->strays += SV_PACKET2_STATUS + ndata;
    }
  } else if (!sv_is_echo(bus, size) && !sv_hear(bus, asked, sv_joint_of(bus, asked, packet[2]), packet[4],
                                                packet + SV_PACKET1_PARAMETERS, size - SV_PACKET1_STATUS)) {
    bus->strays += size;
  }
}

// Return whether the header of the answer to this fast sync read has come, and nothing before it.
static int32_t sv_is_fast(const sv_bus* bus, const sv_asked* asked) {
  const int32_t length = sv_bus_fast_size(asked) - SV_PREFIX2;
  const uint8_t header[SV_PACKET2_PARAMETERS] = {
      0xFF, 0xFF, 0xFD, 0, SV_PACKET2_BROADCAST, (uint8_t)length, (uint8_t)(length >> 8), SV_STATUS2};
  return bus->nreceived >= SV_PACKET2_PARAMETERS && sv_same(bus->received, header, SV_PACKET2_PARAMETERS);
}

// Hear each joint's part of the packet that begins with the bytes received, as far as parts come: => corrupt.
static void sv_hear_parts(sv_bus* bus, const sv_asked* asked, int32_t* corrupt) {
  uint16_t crc = sv_packet2_crc(0, bus->received, SV_PACKET2_PARAMETERS);
  int32_t begin = SV_PACKET2_PARAMETERS;
  for (int32_t i = 0; i < asked->n; i++) {
    const int32_t end = begin + 2 + asked->size;
    while (bus->nreceived < end + 2) {
      if (!sv_bus_take(bus)) {
        *corrupt = *corrupt || bus->nreceived > begin;
        return;
      }
    }
    const uint8_t* part = bus->received + begin;
    const uint16_t said = (uint16_t)(bus->received[end] | (uint32_t)bus->received[end + 1] << 8);
    const int32_t joint = asked->joints[i];
    if (sv_packet2_crc(crc, part, end - begin) == said && part[1] == SV_RIG(bus)->joints[joint].id) {
      (void)sv_hear(bus, asked, joint, part[0], part + 2, asked->size);
    } else {
      *corrupt = 1;
    }
    // who follows has gone on from the CRC that was sent here, whatever became of this part's other bytes
    crc = sv_packet2_crc(said, bus->received + end, 2);
    begin = end + 2;
  }
}

// Hear the one packet in which all joints answer a fast sync read: => corrupt.
static void sv_collect_fast(sv_bus* bus, const sv_asked* asked, int32_t* corrupt) {
  for (;;) {
    // a packet begins where the scan says, whether it is whole or not
    const sv_scan scan = sv_packet2_scan(bus->received, bus->nreceived, SV_PACKET2_BROADCAST);
    sv_bus_drop(bus, scan.first);
    if (sv_is_fast(bus, asked)) {
      sv_hear_parts(bus, asked, corrupt);
      return;
    }
    if (scan.result == SV_SCAN_PACKET) {
      bus->strays += scan.size;
      sv_bus_drop(bus, scan.size);
    } else if (scan.result == SV_SCAN_CORRUPT || !sv_bus_take(bus)) {
      if (bus->nreceived == 0) {
        return;
      }
      *corrupt = 1;
      sv_bus_drop(bus, 1);
    }
  }
}

// Hear one packet of each joint: => corrupt.
static void sv_collect(sv_bus* bus, const sv_asked* asked, int32_t* corrupt) {
  // replies come in the order of the question: who has not answered before the last one will not
  const sv_reply* last = sv_place(asked, asked->joints[asked->n - 1]);
  while (last->status == SV_REPLY_MISSING) {
    const int32_t size = sv_next_packet(bus, corrupt);
    if (size == 0) {
      return;
    }
    sv_hear_packet(bus, asked, size);
    sv_bus_drop(bus, size);
  }
}

int32_t sv_bus_fast_size(const sv_asked* asked) {
  return SV_PACKET2_PARAMETERS + asked->n * (asked->size + SV_AROUND_PART);
}

int32_t sv_bus_receive(sv_bus* bus, const sv_asked* asked, int32_t sent) {
  const int32_t around = sv_is_dynamixel(bus) ? SV_PACKET2_STATUS + SV_STUFFING : SV_PACKET1_STATUS;
  int32_t corrupt = 0;
  int32_t heard = 0;
  bus->echoed = 0;
  for (int32_t i = 0; i < asked->n; i++) {
    sv_place(asked, asked->joints[i])->status = SV_REPLY_MISSING;
  }
  if (sent && SV_FAST_SYNC_READ(SV_RIG(bus)) && bus->frame[SV_PACKET2_PARAMETERS - 1] == SV_FAST_SYNC_READ2) {
    sv_bus_expect(bus, sv_bus_fast_size(asked), asked->n);
    sv_collect_fast(bus, asked, &corrupt);
  } else if (sent) {
    sv_bus_expect(bus, asked->n * (around + asked->size), asked->n);
    sv_collect(bus, asked, &corrupt);
  }
  // what was read and not used was part of a transaction that is over
  bus->nreceived = 0;
  for (int32_t i = 0; i < asked->n; i++) {
    const int32_t joint = asked->joints[i];
    sv_reply* reply = sv_place(asked, joint);
    if (reply->status != SV_REPLY_MISSING) {
      heard = i + 1;
    } else {
      reply->status = corrupt ? SV_REPLY_CORRUPT : SV_REPLY_MISSING;
      reply->error = 0;
      reply->late = !corrupt && bus->strays > bus->strays_seen[joint];
      reply->t_us = sv_hal_now_us();
      sv_bus_remember_late(bus, asked->size);
    }
    bus->strays_seen[joint] = bus->strays;
  }
  return corrupt ? asked->n : heard;  // who is corrupt is not silent
}
