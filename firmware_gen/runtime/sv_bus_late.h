// Lost replies: they may still come, and must not pass for the answer to another question.
//
// Nothing in the protocols is numbered, but a reply has the length that was asked for: after a lost reply the next
// questions ask for other lengths.

#ifndef SV_BUS_LATE_H_
#define SV_BUS_LATE_H_

#include <stdint.h>

#include "sv_bus.h"

#ifdef __cplusplus
extern "C" {
#endif

// Start with no reply lost.
void sv_bus_forget_late(sv_bus* bus);

// Note that replies of `size` bytes were lost.
void sv_bus_remember_late(sv_bus* bus, int32_t size);

// Return how many bytes to ask for, `size` or a few more, so that no lost reply could pass for the answer.
int32_t sv_bus_unlike_late(const sv_bus* bus, int32_t size);

#ifdef __cplusplus
}
#endif

#endif  // SV_BUS_LATE_H_
