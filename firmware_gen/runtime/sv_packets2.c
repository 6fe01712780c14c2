#include "sv_packets2.h"

#define SV_PREFIX 7         // header, reserved, id, length
#define SV_LENGTH_MAX 1024  // more can only be noise, and waiting for it would deafen the bus

// four bits at a time: 32 bytes of table, at a third of the speed of one of 512
static const uint16_t kCrc[16] = {0x0000, 0x8005, 0x800F, 0x000A, 0x801B, 0x001E, 0x0014, 0x8011,
                                  0x8033, 0x0036, 0x003C, 0x8039, 0x0028, 0x802D, 0x8027, 0x0022};

uint16_t sv_packet2_crc(uint16_t crc, const uint8_t* data, int32_t n) {
  uint32_t accumulated = crc;
  for (int32_t i = 0; i < n; i++) {
    accumulated ^= (uint32_t)data[i] << 8;
    accumulated = (accumulated << 4 & 0xFFFFU) ^ kCrc[accumulated >> 12];
    accumulated = (accumulated << 4 & 0xFFFFU) ^ kCrc[accumulated >> 12];
  }
  return (uint16_t)accumulated;
}

static int32_t sv_is_header(const uint8_t* bytes) { return bytes[0] == 0xFF && bytes[1] == 0xFF && bytes[2] == 0xFD; }

static int32_t sv_length(const uint8_t* packet) { return packet[5] | (int32_t)packet[6] << 8; }

// Repeat each FD behind FF FF: body (n) => body; return its bytes, 0 if they do not fit.
static int32_t sv_stuff(uint8_t* body, int32_t n, int32_t capacity) {
  for (int32_t i = 2; i < n; i++) {
    if (!sv_is_header(body + i - 2)) {
      continue;
    }
    if (n == capacity) {
      return 0;
    }
    for (int32_t j = n; j > i; j--) {
      body[j] = body[j - 1];
    }
    n++;
    i++;
  }
  return n;
}

int32_t sv_packet2_seal(uint8_t* frame, int32_t capacity, uint8_t id, uint8_t instruction, int32_t n) {
  if (n < 0 || SV_PREFIX + 1 + n + 2 > capacity) {
    return 0;
  }
  frame[7] = instruction;
  const int32_t nbody = sv_stuff(frame + SV_PREFIX, 1 + n, capacity - SV_PREFIX - 2);
  if (nbody == 0) {
    return 0;
  }
  frame[0] = 0xFF;
  frame[1] = 0xFF;
  frame[2] = 0xFD;
  frame[3] = 0x00;
  frame[4] = id;
  frame[5] = (uint8_t)(nbody + 2);
  frame[6] = (uint8_t)((nbody + 2) >> 8);
  const int32_t end = SV_PREFIX + nbody;
  const uint16_t crc = sv_packet2_crc(0, frame, end);
  frame[end] = (uint8_t)crc;
  frame[end + 1] = (uint8_t)(crc >> 8);
  return end + 2;
}

sv_scan sv_packet2_scan(const uint8_t* bytes, int32_t n, uint8_t id_max) {
  sv_scan scan = {SV_SCAN_SHORT, 0, SV_PACKET2_STATUS};
  for (; n - scan.first >= SV_PACKET2_STATUS; scan.first++) {
    const uint8_t* packet = bytes + scan.first;
    const int32_t length = sv_length(packet);
    if (!sv_is_header(packet) || packet[3] != 0x00 || packet[4] > id_max || length > SV_LENGTH_MAX ||
        packet[7] != SV_STATUS2) {
      continue;
    }
    // one that says that it is shorter than any takes as many bytes as one: nothing that a servo sends
    const int32_t end = SV_PREFIX + length;
    scan.size = end < SV_PACKET2_STATUS ? SV_PACKET2_STATUS : end;
    if (n - scan.first < end) {
      return scan;
    }
    const uint16_t crc = (uint16_t)(packet[end - 2] | (uint32_t)packet[end - 1] << 8);
    scan.result = sv_packet2_crc(0, packet, end - 2) == crc ? SV_SCAN_PACKET : SV_SCAN_CORRUPT;
    return scan;
  }
  return scan;
}

int32_t sv_packet2_unstuff(uint8_t* packet) {
  const int32_t nbody = sv_length(packet) - 2;
  uint8_t* body = packet + SV_PREFIX;
  int32_t n = 0;
  uint32_t came = 0;  // the last four bytes, as they came: FF FF FD FD FD loses one only
  for (int32_t i = 0; i < nbody; i++) {
    came = came << 8 | body[i];
    if (came != 0xFFFFFDFDU) {
      body[n++] = body[i];
    }
  }
  return n;
}
