// Lost replies: they may still come, and must not pass for the answer to another question.
//
// Nothing in the protocols is numbered, but a reply has the length that was asked for: after a lost reply the next
// question asks for a byte more.

#ifndef SV_BUS_LATE_H_
#define SV_BUS_LATE_H_

#include <stdint.h>

#include "sv_bus.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_EXTRA_MAX 7  // bytes more than wanted that are asked for

// Note that replies of `size` bytes of some joints (a bit each) were lost.
void sv_bus_remember_late(sv_bus* bus, uint32_t joints, int32_t size);

// Return how many bytes to ask some joints for, `size` or more, so that no lost reply could pass for the answer.
int32_t sv_bus_unlike_late(const sv_bus* bus, uint32_t joints, int32_t size);

#ifdef __cplusplus
}
#endif

#endif  // SV_BUS_LATE_H_
