// Times: 32-bit counts of microseconds that begin anew every 71 minutes. What is compared lies nearer together.

#ifndef SV_TIME_H_
#define SV_TIME_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// Return whether a time has come that lies less than 2^31 us away.
static inline int32_t sv_has_come(uint32_t now_us, uint32_t until_us) { return (int32_t)(now_us - until_us) >= 0; }

// Return how long ago a time was [us]; < 0 where that is 2^31 us or longer.
static inline int32_t sv_age_us(uint32_t now_us, uint32_t then_us) { return (int32_t)(now_us - then_us); }

#ifdef __cplusplus
}
#endif

#endif  // SV_TIME_H_
