// Protocol 1 framing, as Feetech STS servos use it: a sum for a check, no stuffing, and a scan that finds its way back.
//
//   FF FF  id  length  instruction  parameters  check
//
// The length counts what is behind it. A status packet has its error byte where a question has its instruction, so an
// echo of a question can look like an answer. Source: ROBOTIS e-Manual, protocol1.md; Feetech, ST3215 memory table.

#ifndef SV_PACKETS1_H_
#define SV_PACKETS1_H_

#include <stdint.h>

#include "sv_packets2.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_PACKET1_PARAMETERS 5  // where they stand in a frame
#define SV_PACKET1_STATUS 6      // bytes of a status packet without data

typedef enum {
  SV_PING1 = 0x01,
  SV_READ1 = 0x02,
  SV_WRITE1 = 0x03,
  SV_SYNC_READ1 = 0x82,
  SV_SYNC_WRITE1 = 0x83
} sv_instruction1;

// Make a packet of n parameters that stand in the frame: frame => frame; return its bytes, 0 if it does not fit
// `capacity`.
int32_t sv_packet1_seal(uint8_t* frame, int32_t capacity, uint8_t id, uint8_t instruction, int32_t n);

// Find the first status packet of `n` bytes.
sv_scan sv_packet1_scan(const uint8_t* bytes, int32_t n);

#ifdef __cplusplus
}
#endif

#endif  // SV_PACKETS1_H_
