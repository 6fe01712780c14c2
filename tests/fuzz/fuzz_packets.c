// Any bytes as packets of either protocol: a scan stays within them and finds what was framed.

#include <string.h>

#include "fuzz_input.h"
#include "sv_packets1.h"
#include "sv_packets2.h"

#define FRAME_MAX 256

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

static sv_scan scan_of(int32_t protocol, const uint8_t* bytes, int32_t n) {
  return protocol == 2 ? sv_packet2_scan(bytes, n, SV_PACKET2_BROADCAST) : sv_packet1_scan(bytes, n);
}

// Scan on from one find to the next, as the bus does.
static void scan_all(int32_t protocol, uint8_t* bytes, int32_t n) {
  int32_t used = 0;
  while (used < n) {
    const sv_scan scan = scan_of(protocol, bytes + used, n - used);
    REQUIRE(scan.first >= 0 && scan.first <= n - used);
    if (scan.result == SV_SCAN_SHORT) {
      return;
    }
    REQUIRE(scan.size > 0 && scan.first + scan.size <= n - used);
    if (scan.result == SV_SCAN_PACKET && protocol == 2) {
      const int32_t nbody = sv_packet2_unstuff(bytes + used + scan.first);
      REQUIRE(nbody >= 0 && nbody <= scan.size);
    }
    used += scan.result == SV_SCAN_PACKET ? scan.first + scan.size : scan.first + 1;
  }
}

// Frame parameters as a status packet: the scan finds them, behind anything that can not begin a packet.
static void round_trip(int32_t protocol, uint8_t id, uint8_t error, const uint8_t* parameters, int32_t n) {
  uint8_t frame[FRAME_MAX];
  const int32_t first = protocol == 2 ? SV_PACKET2_PARAMETERS : SV_PACKET1_PARAMETERS;
  const int32_t given = n < FRAME_MAX - first ? n : FRAME_MAX - first;
  memcpy(frame + first, parameters, (size_t)given);
  const int32_t size = protocol == 2 ? sv_packet2_seal(frame, FRAME_MAX, id, SV_STATUS2, given)
                                     : sv_packet1_seal(frame, FRAME_MAX, id, error, given);
  REQUIRE(size >= 0 && size <= FRAME_MAX);
  if (size == 0) {
    return;
  }
  const sv_scan scan = scan_of(protocol, frame, size);
  // what is shorter than a status packet with an error is none
  if (size < SV_PACKET2_STATUS && protocol == 2) {
    REQUIRE(scan.result == SV_SCAN_SHORT);
    return;
  }
  REQUIRE(scan.result == SV_SCAN_PACKET && scan.first == 0 && scan.size == size);
  if (protocol == 2) {
    REQUIRE(sv_packet2_unstuff(frame) == 1 + given);
  }
  REQUIRE(memcmp(frame + first, parameters, (size_t)given) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  uint8_t bytes[4096];
  fuzz_input input = {data, size};
  const int32_t protocol = fuzz_byte(&input) & 1 ? 2 : 1;
  const uint8_t id = (uint8_t)(fuzz_byte(&input) % 253);
  const uint8_t error = fuzz_byte(&input) & 0x7F;
  const int32_t n = fuzz_take(&input, bytes, (int32_t)sizeof bytes);
  round_trip(protocol, id, error, bytes, n);
  scan_all(protocol, bytes, n);
  return 0;
}
