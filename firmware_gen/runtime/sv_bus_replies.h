// What servos answer: status packets found among any bytes, and each servo's reply by itself.

#ifndef SV_BUS_REPLIES_H_
#define SV_BUS_REPLIES_H_

#include <stdint.h>

#include "sv_bus.h"

#ifdef __cplusplus
extern "C" {
#endif

// A question, and where what is answered goes.
typedef struct {
  const uint8_t* joints;  // in the order of the question
  int32_t n;
  int32_t size;       // data bytes that each is asked for
  int32_t wanted;     // of them are kept
  int32_t first;      // the joint that the first place of replies and data belongs to
  sv_reply* replies;  // by joint
  uint8_t* data;      // by joint, `wanted` apart
} sv_asked;

// Return how many bytes an answer to a fast sync read has.
int32_t sv_bus_fast_size(const sv_asked* asked);

// Collect the replies to a question, if it was sent, until all, the last one, or the deadline; return how many of
// the joints, in the order of the question, there are up to the last that was heard.
int32_t sv_bus_receive(sv_bus* bus, const sv_asked* asked, int32_t sent);

#ifdef __cplusplus
}
#endif

#endif  // SV_BUS_REPLIES_H_
