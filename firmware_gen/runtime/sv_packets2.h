// Dynamixel 2.0 packets: CRC, byte stuffing both ways, and a scan that finds its way back from any bytes.
//
//   FF FF FD 00  id  length (2)  instruction  parameters  CRC (2)
//
// The length counts what is behind it. FF FF FD in instruction and parameters is sent as FF FF FD FD. A status packet's
// instruction is 55, its first parameter the error byte. A fast sync read's answer is one packet with a part of each
// servo, each with the CRC of all before it, and nothing stuffed. Source: ROBOTIS e-Manual, protocol2.md.

#ifndef SV_PACKETS2_H_
#define SV_PACKETS2_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SV_PACKET2_PARAMETERS 8   // where they stand in a frame
#define SV_PACKET2_STATUS 11      // bytes of a status packet without data
#define SV_PACKET2_BROADCAST 254  // id: everybody

typedef enum {
  SV_PING2 = 0x01,
  SV_READ2 = 0x02,
  SV_WRITE2 = 0x03,
  SV_STATUS2 = 0x55,
  SV_SYNC_READ2 = 0x82,
  SV_SYNC_WRITE2 = 0x83,
  SV_FAST_SYNC_READ2 = 0x8A
} sv_instruction2;

typedef enum {
  SV_SCAN_SHORT = 0,   // a packet may begin at `first`, but `size` bytes of it have not come
  SV_SCAN_PACKET = 1,  // a packet of `size` bytes begins at `first`
  SV_SCAN_CORRUPT = 2  // what begins at `first` is none: scan again from the byte behind it
} sv_scan_result;

typedef struct {
  int32_t result;  // sv_scan_result
  int32_t first;   // bytes before it can not begin a packet
  int32_t size;
} sv_scan;

// Return the CRC of bytes that follow those whose CRC is `crc`; 0 to start.
uint16_t sv_packet2_crc(uint16_t crc, const uint8_t* data, int32_t n);

// Make a packet of n parameters that stand in the frame: stuff, frame, CRC: frame => frame; return its bytes, 0 if it
// does not fit `capacity`.
int32_t sv_packet2_seal(uint8_t* frame, int32_t capacity, uint8_t id, uint8_t instruction, int32_t n);

// Find the first status packet of `n` bytes, from a servo, or from SV_PACKET2_BROADCAST: a fast sync read's.
sv_scan sv_packet2_scan(const uint8_t* bytes, int32_t n, uint8_t id_max);

// Take the stuffing out of a packet that the scan has found: packet => packet; return the bytes of its instruction and
// parameters.
int32_t sv_packet2_unstuff(uint8_t* packet);

#ifdef __cplusplus
}
#endif

#endif  // SV_PACKETS2_H_
