#include "sv_program.h"

#include "sv_operations.h"
#include "sv_operations.inc"

typedef enum {
#define SV_OPERATIONS_ENUM
#include "sv_operations.inc"
#undef SV_OPERATIONS_ENUM
} sv_opcode;

typedef struct {
  uint8_t arity;
  uint8_t nstate;
} sv_shape;

static const sv_shape kShapes[SV_OP_END] = {
#define SV_OPERATIONS_TABLE
#include "sv_operations.inc"
#undef SV_OPERATIONS_TABLE
};

// A set of state slots.
typedef struct {
  uint32_t words[SV_STATE_MAX / 32];
} sv_slots;

static int32_t sv_has(const sv_slots* slots, int32_t slot) {
  return (int32_t)((slots->words[slot / 32] >> (slot % 32)) & 1U);
}

static void sv_add(sv_slots* slots, int32_t slot) { slots->words[slot / 32] |= UINT32_C(1) << (slot % 32); }

static int32_t sv_in_range(int32_t value, int32_t low, int32_t high) { return value >= low && value <= high; }

// sizes and constants
static int32_t sv_verify_data(const sv_program* program) {
  if (!sv_in_range(program->ninput, 0, SV_INPUT_MAX) || !sv_in_range(program->nconst, 0, SV_CONSTANT_MAX) ||
      !sv_in_range(program->ninstruction, 0, SV_INSTRUCTION_MAX) || !sv_in_range(program->nstate, 0, SV_STATE_MAX) ||
      !sv_in_range(program->noutput, 1, SV_OUTPUT_MAX)) {
    return SV_ERROR_SIZE;
  }
  for (int32_t i = 0; i < program->nconst; i++) {
    const float value = program->constants[i];
    if (!(value - value == 0.0F)) {
      return SV_ERROR_CONSTANT;
    }
  }
  return SV_OK;
}

// a slot belongs to one stateful operation, or to one store and the loads before it
static int32_t sv_verify_state(const sv_program* program, const sv_instruction* in, sv_slots* owned, sv_slots* loaded) {
  const sv_shape shape = kShapes[in->op];
  const uint16_t fields[4] = {in->a, in->b, in->c, 0};
  const int32_t first = fields[shape.arity];
  if (first + shape.nstate > program->nstate) {
    return SV_ERROR_STATE;
  }
  for (int32_t slot = first; slot < first + shape.nstate; slot++) {
    if (sv_has(owned, slot)) {
      return SV_ERROR_STATE;
    }
    if (in->op == SV_OP_LOAD) {
      sv_add(loaded, slot);
      continue;
    }
    if (in->op != SV_OP_STORE && sv_has(loaded, slot)) {
      return SV_ERROR_STATE;
    }
    sv_add(owned, slot);
  }
  return SV_OK;
}

int32_t sv_verify(const sv_program* program) {
  sv_slots owned = {{0}};
  sv_slots loaded = {{0}};
  const int32_t error = sv_verify_data(program);
  if (error != SV_OK) {
    return error;
  }
  const int32_t first = program->ninput + program->nconst;
  for (int32_t i = 0; i < program->ninstruction; i++) {
    const sv_instruction* in = program->instructions + i;
    if (in->op == 0 || in->op >= SV_OP_END) {
      return SV_ERROR_OPCODE;
    }
    const uint16_t operands[3] = {in->a, in->b, in->c};
    for (int32_t j = 0; j < kShapes[in->op].arity; j++) {
      if (operands[j] >= first + i) {
        return SV_ERROR_REGISTER;
      }
    }
    if (kShapes[in->op].nstate > 0) {
      const int32_t state_error = sv_verify_state(program, in, &owned, &loaded);
      if (state_error != SV_OK) {
        return state_error;
      }
    }
  }
  for (int32_t i = 0; i < SV_STATE_MAX / 32; i++) {
    // what is loaded, no other operation owns: owned means stored
    if (loaded.words[i] & ~owned.words[i]) {
      return SV_ERROR_STATE;
    }
  }
  for (int32_t i = 0; i < program->noutput; i++) {
    if (program->outputs[i] >= sv_nregister(program)) {
      return SV_ERROR_OUTPUT;
    }
  }
  return SV_OK;
}

int32_t sv_nregister(const sv_program* program) { return program->ninput + program->nconst + program->ninstruction; }

void sv_reset(const sv_program* program, float* registers, float* state) {
  for (int32_t i = 0; i < program->nconst; i++) {
    registers[program->ninput + i] = program->constants[i];
  }
  for (int32_t i = 0; i < program->nstate; i++) {
    state[i] = 0.0F;
  }
}

void sv_step(const sv_program* program, float dt, const float* inputs, float* registers, float* state, float* outputs) {
  const sv_instruction* in = program->instructions;
  const sv_instruction* const end = in + program->ninstruction;
  float* result = registers + program->ninput + program->nconst;

  for (int32_t i = 0; i < program->ninput; i++) {
    registers[i] = inputs[i];
  }
  for (; in < end; in++, result++) {
    switch (in->op) {
#define SV_OPERATIONS_CASES
#include "sv_operations.inc"
#undef SV_OPERATIONS_CASES
      default:
        break;
    }
  }
  for (int32_t i = 0; i < program->noutput; i++) {
    outputs[i] = registers[program->outputs[i]];
  }
}

void sv_run(const sv_program* program, float dt, int32_t nstep, const float* inputs, float* registers, float* state,
            float* outputs) {
  sv_reset(program, registers, state);
  for (int32_t i = 0; i < nstep; i++) {
    sv_step(program, dt, inputs, registers, state, outputs);
    inputs += program->ninput;
    outputs += program->noutput;
  }
}

uint32_t sv_operations_fingerprint(void) { return SV_OPERATIONS_FINGERPRINT; }
