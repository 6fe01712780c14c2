// The largest rig that the firmware has room for; a generated project holds the sizes of its own.

#ifndef SV_RIG_SIZES_H_
#define SV_RIG_SIZES_H_

#define SV_JOINT_MAX 16    // joints of a rig
#define SV_SENSOR_MAX 16   // channels of the sensor node
#define SV_MESSAGE_MAX 16  // letters that a rig's lines have
#define SV_BLOCK_MAX 160   // bytes of the longest block that is read at once
#define SV_FRAME_MAX 256   // bytes of the longest packet, stuffing included

#endif  // SV_RIG_SIZES_H_
