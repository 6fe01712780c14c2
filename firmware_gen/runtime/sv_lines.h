// The sensor node's lines, $F,<seq>,<t_us>,<raw...>*HH: checked, dated, and held with their age.
//
// Whatever arrives, reading goes on: a line starts at a $ wherever one stands, ends at a line end, and counts only if
// its check matches: HH is the exclusive or of the bytes between $ and *. A line that starts with E is an emergency
// stop.
//
// A line arrives some time after its sample, and is read some time after that. The smallest difference of the last
// second between our time and the node's, less the latency that the rig states, dates every sample, so reading late
// does not make a sample look young. Of that second's differences at most SV_WINDOW_MAX are kept, each the smallest
// since, and those of one eighth of a second count as one: memory is fixed, and a difference may date samples for up to
// an eighth of a second longer than a second. That makes a sample look older, never younger, by no more than what the
// clocks drift apart in the eighth: 1.25 ms at 1 %. The node's times, as ours, are taken modulo 2^32 us.

#ifndef SV_LINES_H_
#define SV_LINES_H_

#include <stdint.h>

#include "sv_rig.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SV_LINE_BYTES_MAX 200  // of a line, from behind its $ to before its end
#define SV_WINDOW_MAX 9        // differences of a second

// A difference of the clocks, the smallest since it was seen.
typedef struct {
  uint32_t seen_us;
  uint32_t offset_us;
} sv_difference;

// The newest line of one letter, and how the node's clock stands to ours.
typedef struct {
  int32_t ndifference;                       // 0: no line has come
  uint32_t t_us;                             // the node's time of the sample; wraps, as all times here
  uint32_t offset_us;                        // our time less the node's
  uint32_t updated_us;                       // when the line was read
  sv_difference differences[SV_WINDOW_MAX];  // oldest first, rising
} sv_channel;

typedef struct {
  int32_t nopen;  // bytes of the line that is coming; < 0: none has started
  uint8_t emergency_stop;
  sv_channel channels[SV_MESSAGE_MAX];
  uint8_t open[SV_LINE_BYTES_MAX];
} sv_lines;

// Start without lines.
void sv_lines_init(sv_lines* lines);

// Take n bytes that the sensor line gave: => raw (nsensor), the newest counts of each sensor whose line has come.
void sv_lines_feed(sv_lines* lines, const sv_rig* rig, const uint8_t* bytes, int32_t n, uint32_t now_us, int32_t* raw);

// Return how old a sensor's counts are [us]; -1 before its first line, < 0 where they are older than 2^31 us.
int32_t sv_lines_age_us(const sv_lines* lines, const sv_rig* rig, int32_t sensor, uint32_t now_us);

#ifdef __cplusplus
}
#endif

#endif  // SV_LINES_H_
