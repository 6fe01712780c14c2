// One period's data: what came over the wire, held with its age where nothing new came. After deploy/rig_io.py.

#ifndef SV_IO_H_
#define SV_IO_H_

#include <stdint.h>

#include "sv_robot.h"

#ifdef __cplusplus
extern "C" {
#endif

// Forget what a run before this one has read.
void sv_forget(sv_robot* robot);

// Take the lines that have come from the sensor node: => raw.
void sv_read_sensors(sv_robot* robot);

// Drop them: nobody looks at sensors between runs.
void sv_drop_sensors(sv_robot* robot);

// Return whether every sensor that is needed is fresh.
int32_t sv_sensors_fresh(const sv_robot* robot);

// Return how old a joint's counts are [us]; -1: it has never answered, < 0: they are older than 2^31 us.
int32_t sv_joint_age_us(const sv_robot* robot, int32_t joint, uint32_t now_us);

// Return whether a block holds a register: => its count.
int32_t sv_in_block(const sv_block* block, const uint8_t* data, const sv_register* reg, int32_t* count);

// Read position, velocity and load of every servo: => raw, replies; the last counts of one that does not answer are
// held.
void sv_read_servos(sv_robot* robot, const sv_block* block);

// Write goals (njoint), without the speed of a joint that it may have carried to an end of its travel.
void sv_write_goals(sv_robot* robot, const sv_block* block, const int32_t* goals);

#ifdef __cplusplus
}
#endif

#endif  // SV_IO_H_
