// The log: compact binary records on the console line, between its lines of text.
//
// A record is 0x00, the COBS code of (type, body, CRC-16 of both, low byte first), 0x00: no byte of the code is 0, so
// what stands between two zeros and is no code with its CRC right is text, or was damaged. The CRC is Dynamixel 2.0's:
// polynomial 0x8005, from 0, most significant bit first. But for the first record's, a body is its time, i64 t_us, and
// numbers: varints, which are LEB128 of the zigzag code, where nothing else is said. Others are little endian. A record
// that does not fit the line's buffer is dropped, and counted.

#ifndef SV_RECORD_H_
#define SV_RECORD_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SV_RECORD_FORMAT 2
#define SV_RECORD_MAX 250  // bytes before the code: type, body, CRC

typedef enum {
  SV_RECORD_HELLO = 1,    // in any format: u8 format, u32 rig fingerprint, u32 program fingerprint, u8 sv_reset_cause
  SV_RECORD_STATE = 2,    // left, entered, sv_reason, joint (255: none), a, b
  SV_RECORD_FINDING = 3,  // sv_finding, joint (255: none), address, value
  SV_RECORD_START = 4,    // f32 goal_dist, f32 goal_bearing, f32 derate, periods, armed
  SV_RECORD_CYCLE = 5,    // k, late_us, read_us, compute_us, write_us (-1: not sent), missed (bit a joint), raw (nraw),
                          // age_us (njoint, then nsensor; < 0: never), f32 terminals (ninput), f32 outputs
                          // (noutput), goal counts (noutput)
  SV_RECORD_HEALTH = 6,   // joint, address, size, bytes
  SV_RECORD_EVENT = 7,    // sv_event, a
  SV_RECORD_END = 8,  // state, sv_reason, joint, a, b, cycles, missed deadlines, missed replies, bits of the count of
                      // bus bytes, records dropped, unsure (bit a joint)
  SV_RECORD_READING = 9  // joint, address, size, bytes: a block that the check has read
} sv_record_type;

// A record grows in the place of its code: a code byte before it, the CRC and a zero behind it.
typedef struct {
  uint8_t bytes[SV_RECORD_MAX + 3];
  int32_t n;
} sv_record;

// Begin a record of a type.
void sv_record_begin(sv_record* record, int32_t type);

// Append a number; what does not fit makes the record invalid, and sv_record_end drops it.
void sv_record_u8(sv_record* record, uint32_t value);
void sv_record_u32(sv_record* record, uint32_t value);
void sv_record_f32(sv_record* record, float value);
void sv_record_varint(sv_record* record, int32_t value);

// Send it on the console line, waiting for wait_us at the longest for room; return 1, or 0 if it was
// dropped.
int32_t sv_record_end(sv_record* record, uint32_t wait_us);

#ifdef __cplusplus
}
#endif

#endif  // SV_RECORD_H_
