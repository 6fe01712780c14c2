// What the robot tells on the console: records of its log, and words for people.

#ifndef SV_LOG_H_
#define SV_LOG_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// Let the log's clock, which does not begin anew, run on to a time of the board's; less than 2^31 us may have passed.
void sv_log_time(sv_robot* robot, uint32_t now_us);

// Each writes one record of sv_record.h.
void sv_log_hello(sv_robot* robot);
void sv_log_start(sv_robot* robot);
void sv_log_state(sv_robot* robot, int32_t left, const sv_why* why);
void sv_log_finding(sv_robot* robot, int32_t finding, int32_t joint, int32_t address, int32_t value);
void sv_log_cycle(sv_robot* robot, int32_t k);
void sv_log_block(sv_robot* robot, int32_t type, int32_t joint, const sv_block* block, const uint8_t* data);
void sv_log_event(sv_robot* robot, int32_t event, int32_t a);
void sv_log_end(sv_robot* robot, uint32_t unsure);

// Print text.
void sv_print(const char* text);

// Print a number after a space.
void sv_print_number(int32_t value);

#ifdef __cplusplus
}
#endif

#endif  // SV_LOG_H_
