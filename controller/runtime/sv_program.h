// A controller program and the machine that runs it.
//
// A program is a flat list of instructions in static single assignment form. The register file holds, in this order,
// the inputs, the constants, and one register per instruction: instruction i writes register ninput + nconst + i.
// Nothing here allocates: the caller owns every array. A program must have passed sv_verify before sv_step sees it.

#ifndef SV_PROGRAM_H_
#define SV_PROGRAM_H_

#include <stdint.h>

#include "sv_sizes.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
  SV_OK = 0,
  SV_ERROR_SIZE = -1,      // a count is negative or above its bound
  SV_ERROR_OPCODE = -2,    // an instruction's opcode is not in the table
  SV_ERROR_REGISTER = -3,  // an operand is not defined before its use
  SV_ERROR_STATE = -4,     // a state slot is out of range or has two owners
  SV_ERROR_OUTPUT = -5,    // an output register is out of range
  SV_ERROR_CONSTANT = -6,  // a constant is not finite
  SV_ERROR_CYCLE = -7,     // a cycle configuration is inconsistent with its program
  SV_ERROR_FLOAT = -8      // this thread's arithmetic is not IEEE-754 binary32 (see sv_check_float)
} sv_error;

typedef struct {
  uint16_t op;  // sv_opcode
  uint16_t a;   // operand registers, in order; for a stateful operation the one after
  uint16_t b;   //   the last operand is the first of its state slots
  uint16_t c;
} sv_instruction;

typedef struct {
  int32_t ninput;
  int32_t nconst;
  int32_t ninstruction;
  int32_t nstate;
  int32_t noutput;
  const float* constants;              // (nconst)
  const sv_instruction* instructions;  // (ninstruction)
  const uint16_t* outputs;             // registers, (noutput)
} sv_program;

// Check every bound that sv_step relies on; return SV_OK or the first error found.
int32_t sv_verify(const sv_program* program);

// Return the number of registers that sv_step needs.
int32_t sv_nregister(const sv_program* program);

// Copy the constants into the register file and zero the state: call once before the first step.
void sv_reset(const sv_program* program, float* registers, float* state);

// Evaluate one step: (inputs, state) => (outputs, state). dt is the period [s].
void sv_step(const sv_program* program, float dt, const float* inputs, float* registers, float* state, float* outputs);

// Evaluate nstep steps from a reset: inputs (nstep, ninput) => outputs (nstep, noutput).
void sv_run(const sv_program* program, float dt, int32_t nstep, const float* inputs, float* registers, float* state,
            float* outputs);

// Check that this thread's arithmetic keeps subnormals, rounds to nearest even and fuses nothing; return SV_OK or
// SV_ERROR_FLOAT. Call it once where other code may have changed the floating-point mode, and at boot.
int32_t sv_check_float(void);

// Return the checksum of the table of operations that this was built from.
uint32_t sv_operations_fingerprint(void);

#ifdef __cplusplus
}
#endif

#endif  // SV_PROGRAM_H_
