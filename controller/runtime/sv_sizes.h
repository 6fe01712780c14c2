// The largest rig and program that arrays have room for; a generated firmware project holds the sizes of its own.

#ifndef SV_SIZES_H_
#define SV_SIZES_H_

#define SV_INPUT_MAX 64          // inputs of a program
#define SV_OUTPUT_MAX 32         // outputs of a program
#define SV_INSTRUCTION_MAX 8192  // instructions of a program
#define SV_CONSTANT_MAX 8192     // constants of a program
#define SV_STATE_MAX 4096        // float32 state slots of a program
#define SV_RAW_MAX 128           // raw channels of a rig
#define SV_JOINT_MAX 16          // joints of a rig
#define SV_SENSOR_MAX 16         // channels of the sensor node
#define SV_BLOCK_MAX 160         // bytes of the longest block that is read at once
#define SV_FRAME_MAX 256         // bytes of the longest packet, stuffing included

#endif  // SV_SIZES_H_
