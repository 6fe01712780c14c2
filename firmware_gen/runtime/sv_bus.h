// The bus master: questions to servos and their answers, over Dynamixel 2.0 or Feetech STS packets.
//
// Every transaction is over by a deadline that follows from its bytes' time on the line. What a reply says is kept for
// each servo by itself; a corrupt packet costs no other servo its reply; a reply that comes late can not pass for the
// answer to the next question, for that one asks for another length. The same rules, in the same order, as the host
// loop's bus (deploy/buses/servo_bus.py).

#ifndef SV_BUS_H_
#define SV_BUS_H_

#include <stdint.h>

#include "sv_rig.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_LENGTHS 8  // lengths that the same data may be asked for in

typedef enum {
  SV_REPLY_DATA = 0,
  SV_REPLY_REFUSED = 1,  // an error and no data
  SV_REPLY_MISSING = 2,  // silence
  SV_REPLY_CORRUPT = 3   // bytes came, but no valid packet
} sv_reply_status;

typedef struct {
  uint8_t status;  // sv_reply_status
  uint8_t error;   // the packet's error byte; with data: that something is wrong with the servo, not with the question
  uint8_t late;    // whether it is missing, but an answer to an earlier question has come since it was last asked
  uint32_t t_us;   // when it had been read, or was given up
} sv_reply;

typedef struct {
  const sv_rig* rig;
  int32_t nreceived;
  int32_t nframe;
  uint32_t silent;        // by joint: asked last, where it keeps nobody waiting
  int32_t whole;          // whether everybody answered the last sync read
  int32_t strays;         // bytes that answered nothing that was asked
  int32_t echoed;         // whether the line has given back what was sent
  int32_t line_nbyte;     // the line is busy for as long as these need,
  uint32_t line_from_us;  // from here
  uint32_t deadline_us;
  int32_t patience_us;
  uint32_t nbyte;  // bytes sent and received
  sv_reply reply;  // the last of a joint that was asked by itself
  int32_t strays_seen[SV_JOINT_MAX];
  uint32_t lost_us[SV_LENGTHS];    // when a reply was last lost, by its data bytes modulo SV_LENGTHS
  uint8_t received[SV_FRAME_MAX];  // bytes of the transaction that are not used yet
  uint8_t frame[SV_FRAME_MAX];     // what has been sent last
} sv_bus;

// Start with an empty line.
void sv_bus_init(sv_bus* bus, const sv_rig* rig);

// What asks one joint returns the status of its reply.

// Ask joint number `joint` whether it is there: => its model number.
int32_t sv_bus_ping(sv_bus* bus, int32_t joint, uint16_t* model);

// Read a block: => data (size).
int32_t sv_bus_read(sv_bus* bus, int32_t joint, int32_t address, int32_t size, uint8_t* data);

// Write a block.
int32_t sv_bus_write(sv_bus* bus, int32_t joint, int32_t address, const uint8_t* data, int32_t size);

// Read the same block of every joint: => replies (njoint), data (njoint, size).
void sv_bus_sync_read(sv_bus* bus, int32_t address, int32_t size, sv_reply* replies, uint8_t* data);

// Write the same registers of every joint: data (njoint, size); nobody replies.
void sv_bus_sync_write(sv_bus* bus, int32_t address, int32_t size, const uint8_t* data);

// Make the packet of sv_bus_sync_write without sending it: => frame (SV_FRAME_MAX); return its bytes, 0 if it does not
// fit. Needs no bus: for fault handlers.
int32_t sv_bus_sync_write_frame(const sv_rig* rig, int32_t address, int32_t size, const uint8_t* data, uint8_t* frame);

// Read one register, trying again where the reply is lost: => count, 0 where there is none.
int32_t sv_bus_read_register(sv_bus* bus, int32_t joint, const sv_register* reg, int32_t attempts, int32_t* count);

// Write one register and read it back: => the count that it holds then, where the status is SV_REPLY_DATA.
int32_t sv_bus_write_register(sv_bus* bus, int32_t joint, const sv_register* reg, int32_t count, int32_t attempts,
                              int32_t* held);

#ifdef __cplusplus
}
#endif

#endif  // SV_BUS_H_
