// The log: compact binary records on the console line, between its lines of text.
//
// A record is 0x00, the COBS code of (type, body, CRC-16 of both, low byte first), 0x00: no byte of the code is 0, so
// what stands between two zeros and is no code with its CRC right is text, or was damaged. The CRC is Dynamixel 2.0's:
// polynomial 0x8005, from 0, most significant bit first. Numbers are little endian. "varint" is a LEB128 of the zigzag
// code. A record that does not fit the line's buffer is dropped, and counted.

#ifndef SV_RECORD_H_
#define SV_RECORD_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SV_RECORD_FORMAT 2
#define SV_RECORD_MAX 250  // bytes before the code: type, body, CRC

typedef enum {
  SV_RECORD_HELLO = 1,    // u8 format, u32 rig fingerprint, u32 program fingerprint, u8 sv_reset_cause
  SV_RECORD_STATE = 2,    // i64 t_us, u8 left, u8 entered, u8 sv_reason, u8 joint (255: none), i32 a, i32 b
  SV_RECORD_FINDING = 3,  // i64 t_us, u8 level, u8 sv_finding, u8 joint, u16 address, i32 value, i32 low, i32 high
  SV_RECORD_START = 4,    // i64 t_us, f32 goal_dist, f32 goal_bearing, i32 periods, f32 derate, u8 armed
  SV_RECORD_CYCLE = 5,   // i64 t_us, varint k, late_us, read_us, compute_us, write_us (-1: not sent), u16 missed (bit a
                         // joint), varint raw (nraw), varint age_us (njoint, then nsensor; < 0: never),
                         // u32 terminal bits (ninput), u32 output bits (noutput), varint goal counts (noutput)
  SV_RECORD_HEALTH = 6,  // i64 t_us, u8 joint, u16 address, u8 size, bytes
  SV_RECORD_EVENT = 7,   // i64 t_us, u8 sv_event, u8 joint, i32 a, i32 b
  SV_RECORD_END = 8,     // i64 t_us, u8 state, u8 sv_reason, u8 joint, i32 a, i32 b, i32 cycles, i32 missed deadlines,
                         // i32 missed replies, u32 bus bytes, u32 records dropped, u16 unsure (bit a joint)
  SV_RECORD_READING = 9  // i64 t_us, u8 joint, u16 address, u8 size, bytes: a block that the check has read, in parts
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
void sv_record_u16(sv_record* record, uint32_t value);
void sv_record_u32(sv_record* record, uint32_t value);
void sv_record_i32(sv_record* record, int32_t value);
void sv_record_i64(sv_record* record, int64_t value);
void sv_record_f32(sv_record* record, float value);
void sv_record_varint(sv_record* record, int32_t value);

// Send it on the console line, waiting for wait_us at the longest for room; return 1, or 0 if it was
// dropped.
int32_t sv_record_end(sv_record* record, uint32_t wait_us);

#ifdef __cplusplus
}
#endif

#endif  // SV_RECORD_H_
