// A tiny command line on the console, and the two inputs.
//
//   goal D [BEARING]  where to go [m], [rad]        arm     allow torque for one run
//   seconds S         how long                      disarm  do not
//   derate X          part of the torque ceiling    start   check, and run if armed
//   status            how it is                     stop    end the run
//
// Numbers are decimal, of at most nine digits, rounded once to binary32. While a run goes on only stop and status are
// heard.

#ifndef SV_CONSOLE_H_
#define SV_CONSOLE_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// A decimal number: mantissa / 10^places.
typedef struct {
  uint32_t mantissa;  // below 1e9
  uint8_t places;     // at most 9
  uint8_t negative;
} sv_decimal;

// Take what has come, and look at the inputs: => wish.
void sv_console_listen(sv_robot* robot);

// Read a number after spaces: => decimal; return what stands behind it, 0 if there is none.
const char* sv_decimal_parse(const char* text, sv_decimal* decimal);

// Return the nearest binary32.
float sv_decimal_float(const sv_decimal* decimal);

#ifdef __cplusplus
}
#endif

#endif  // SV_CONSOLE_H_
