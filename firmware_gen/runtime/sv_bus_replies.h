// What servos answer: status packets found among any bytes, and each servo's reply by itself.

#ifndef SV_BUS_REPLIES_H_
#define SV_BUS_REPLIES_H_

#include <stdint.h>

#include "sv_bus.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
  uint8_t joints[SV_JOINT_MAX];  // in the order of the question
  int32_t n;
  int32_t first;  // the joint that the first place of replies and data belongs to
  uint8_t fast;   // all answer in one packet
  int32_t size;   // data bytes that each was asked for
} sv_asked;

// Return the reply of a joint that has given none.
sv_reply sv_bus_no_reply(sv_reply_status status);

// Return how many bytes an answer to a fast sync read has.
int32_t sv_bus_fast_size(const sv_asked* asked);

// Collect the replies to what has just been sent, until all, the last one, or the deadline: => replies (by joint),
// the first `wanted` data bytes of each (by joint, `wanted` apart).
void sv_bus_receive(sv_bus* bus, const sv_asked* asked, int32_t wanted, sv_reply* replies, uint8_t* data);

#ifdef __cplusplus
}
#endif

#endif  // SV_BUS_REPLIES_H_
