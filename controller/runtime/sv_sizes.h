// The largest rig and program that arrays have room for; a generated firmware project holds the sizes of its own.

#ifndef SV_SIZES_H_
#define SV_SIZES_H_

#define SV_INPUT_MAX 64          // inputs of a program
#define SV_OUTPUT_MAX 32         // outputs of a program
#define SV_INSTRUCTION_MAX 8192  // instructions of a program
#define SV_CONSTANT_MAX 8192     // constants of a program
#define SV_STATE_MAX 4096        // float32 state slots of a program
#define SV_RAW_MAX 128           // raw channels of a rig

// kinds that a cycle may have, a bit each: what a project knows to be absent costs it no code
#define SV_TERMINAL_KINDS 0x7FU  // sv_terminal_kind

#endif  // SV_SIZES_H_
