#include "sv_packets1.h"

#define SV_AROUND 4        // header, id and length are not counted by the length
#define SV_LENGTH_MAX 250  // of the vendor's packets
#define SV_ID_MAX 0xFD
#define SV_ERROR_MAX 0x7F

// Return the check of a packet of `size` bytes.
static uint8_t sv_check_sum(const uint8_t* packet, int32_t size) {
  uint32_t sum = 0;
  for (int32_t i = 2; i < size - 1; i++) {
    sum += packet[i];
  }
  return (uint8_t)~sum;
}

int32_t sv_packet1_seal(uint8_t* frame, int32_t capacity, uint8_t id, uint8_t instruction, int32_t n) {
  const int32_t size = SV_PACKET1_STATUS + n;
  if (n < 0 || size > capacity || size > SV_LENGTH_MAX) {
    return 0;
  }
  frame[0] = 0xFF;
  frame[1] = 0xFF;
  frame[2] = id;
  frame[3] = (uint8_t)(n + 2);
  frame[4] = instruction;
  frame[size - 1] = sv_check_sum(frame, size);
  return size;
}

sv_scan sv_packet1_scan(const uint8_t* bytes, int32_t n) {
  sv_scan scan = {SV_SCAN_SHORT, 0, SV_PACKET1_STATUS};
  for (; n - scan.first >= SV_PACKET1_STATUS; scan.first++) {
    const uint8_t* packet = bytes + scan.first;
    const int32_t size = SV_AROUND + packet[3];
    if (packet[0] != 0xFF || packet[1] != 0xFF || packet[2] > SV_ID_MAX || packet[3] > SV_LENGTH_MAX ||
        packet[4] > SV_ERROR_MAX) {
      continue;
    }
    scan.size = size;
    if (n - scan.first >= size) {
      scan.result = sv_check_sum(packet, size) == packet[size - 1] ? SV_SCAN_PACKET : SV_SCAN_CORRUPT;
    }
    return scan;
  }
  return scan;
}
