// The bus's line: how long bytes are on it, when an answer is overdue, what has come and is not used yet.

#ifndef SV_BUS_LINE_H_
#define SV_BUS_LINE_H_

#include <stdint.h>

#include "sv_bus.h"

#ifdef __cplusplus
extern "C" {
#endif

// Send the frame's bytes, 0: it did not fit; what waits is dropped before, for it answers nothing that is asked now.
// Return whether it went out.
int32_t sv_bus_send(sv_bus* bus, int32_t nframe);

// Set the deadline of replies to what has just been sent, of `nbyte` bytes together.
void sv_bus_expect(sv_bus* bus, int32_t nbyte, int32_t nreply);

// Take what has come; where nothing has, wait for it until the deadline; return whether something came.
int32_t sv_bus_take(sv_bus* bus);

// Sleep until a time comes or something else does, for no longer than the watchdog can do without food; then feed it.
void sv_doze(uint32_t until_us);

// Forget the first bytes that were taken.
void sv_bus_drop(sv_bus* bus, int32_t n);

#ifdef __cplusplus
}
#endif

#endif  // SV_BUS_LINE_H_
