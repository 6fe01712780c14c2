// The jobs: each reads what it needs from the host, computes, and writes its answer.

#include "batch.h"

#include "sv_cycle.h"

#define BATCH_ARENA 1536  // words for a program's instructions, constants, registers and state
#define BATCH_BUFFER 512  // words of rows on the way in, and out

static uint32_t batch_arena[BATCH_ARENA];
static float batch_inputs[BATCH_BUFFER];
static float batch_outputs[BATCH_BUFFER];
static int32_t batch_used;

static void batch_need(int32_t truth) {
  if (!truth) {
    batch_exit(2);
  }
}

static uint32_t batch_word(void) {
  uint32_t word;
  batch_need(batch_read(&word, 1));
  return word;
}

static void* batch_take(int32_t nword) {
  uint32_t* const words = batch_arena + batch_used;
  batch_need(nword >= 0 && nword <= BATCH_ARENA - batch_used);
  batch_used += nword;
  return words;
}

static void* batch_load(int32_t nword) {
  void* const words = batch_take(nword);
  batch_need(nword == 0 || batch_read(words, nword));
  return words;
}

static int32_t batch_rows_at_once(int32_t ninput, int32_t noutput, int32_t nrow) {
  const int32_t width = ninput > noutput ? ninput : noutput;
  const int32_t n = BATCH_BUFFER / width;
  return n < nrow ? n : nrow;
}

static void batch_float(void) {
  uint32_t answer[2] = {(uint32_t)sv_check_float(), 0};
#ifdef __ARM_FP
  __asm__ volatile("vmrs %0, fpscr" : "=r"(answer[1]));
#endif
  batch_write(answer, 2);
}

static void batch_set_fpscr(void) {
  const uint32_t word = batch_word();
#ifdef __ARM_FP
  __asm__ volatile("vmsr fpscr, %0" : : "r"(word));
#else
  (void)word;
#endif
}

// number, rows, steps after which it starts anew; rows => selftest, rows
static void batch_compiled(void) {
  const batch_program* program = kPrograms + batch_word();
  int32_t nrow = (int32_t)batch_word();
  const int32_t nstep = (int32_t)batch_word();
  const int32_t status = program->selftest();
  int32_t step = 0;
  batch_write(&status, 1);
  while (nrow > 0) {
    const int32_t n = batch_rows_at_once(program->ninput, program->noutput, nrow);
    batch_need(program->ninput == 0 || batch_read(batch_inputs, n * program->ninput));
    for (int32_t i = 0; i < n; i++, step++) {
      if (step % nstep == 0) {
        program->init();
      }
      program->step(batch_inputs + i * program->ninput, batch_outputs + i * program->noutput);
    }
    batch_write(batch_outputs, n * program->noutput);
    nrow -= n;
  }
}

// ninput, nconst, ninstruction, nstate, noutput, constants, instructions, outputs (two a word)
static sv_program batch_load_program(void) {
  sv_program program = {0};
  program.ninput = (int32_t)batch_word();
  program.nconst = (int32_t)batch_word();
  program.ninstruction = (int32_t)batch_word();
  program.nstate = (int32_t)batch_word();
  program.noutput = (int32_t)batch_word();
  program.constants = batch_load(program.nconst);
  program.instructions = batch_load(2 * program.ninstruction);
  program.outputs = batch_load((program.noutput + 1) / 2);
  return program;
}

// period, program, rows, steps after which it starts anew; rows => sv_verify, rows
static void batch_vm(void) {
  const uint32_t period = batch_word();
  batch_used = 0;
  const sv_program program = batch_load_program();
  int32_t nrow = (int32_t)batch_word();
  const int32_t nstep = (int32_t)batch_word();
  float* const registers = batch_take(sv_nregister(&program));
  float* const state = batch_take(program.nstate);
  const int32_t status = sv_verify(&program);
  int32_t step = 0;
  union {
    uint32_t word;
    float value;
  } dt = {period};
  batch_write(&status, 1);
  batch_need(status == SV_OK);
  while (nrow > 0) {
    const int32_t n = batch_rows_at_once(program.ninput, program.noutput, nrow);
    batch_need(program.ninput == 0 || batch_read(batch_inputs, n * program.ninput));
    for (int32_t i = 0; i < n; i++, step++) {
      if (step % nstep == 0) {
        sv_reset(&program, registers, state);
      }
      sv_step(&program, dt.value, batch_inputs + i * program.ninput, registers, state,
              batch_outputs + i * program.noutput);
    }
    batch_write(batch_outputs, n * program.noutput);
    nrow -= n;
  }
}

// program, the cycle's numbers, goal, rows; rows of raw counts => sv_cycle_verify, rows of terminals, outputs, goals
static void batch_cycle(void) {
  static sv_cycle_state state;
  static int32_t raw[SV_RAW_MAX];
  static int32_t goals[SV_OUTPUT_MAX];
  batch_used = 0;
  const sv_program program = batch_load_program();
  sv_cycle cycle = {0};
  sv_goal goal;
  cycle.program = &program;
  cycle.terminals = batch_load(program.ninput * (int32_t)(sizeof(sv_terminal) / 4));
  cycle.outputs = batch_load(program.noutput * (int32_t)(sizeof(sv_output) / 4));
  cycle.guards = batch_load(program.noutput * (int32_t)(sizeof(sv_guard) / 4));
  // period, filter, slew step, nraw, x, y, heading, facing: as they lie in the structure
  batch_need(batch_read(&cycle.period_s, 4 + 4 * (int32_t)(sizeof(sv_terminal) / 4)));
  batch_need(batch_read(&goal, 2));
  const int32_t nrow = (int32_t)batch_word();
  float* const registers = batch_take(sv_nregister(&program));
  float* const memory = batch_take(program.nstate);
  const int32_t status = sv_cycle_verify(&cycle);
  batch_write(&status, 1);
  batch_need(status == SV_OK);
  sv_cycle_reset(&cycle, &state, registers, memory);
  for (int32_t i = 0; i < nrow; i++) {
    batch_need(batch_read(raw, cycle.nraw));
    sv_cycle_step(&cycle, &goal, &state, registers, memory, raw, batch_inputs, batch_outputs, goals);
    batch_write(batch_inputs, program.ninput);
    batch_write(batch_outputs, program.noutput);
    batch_write(goals, program.noutput);
  }
}

int main(void) {
  uint32_t job;
  batch_open();
  while (batch_read(&job, 1)) {
    switch (job) {
      case BATCH_FLOAT:
        batch_float();
        break;
      case BATCH_SET_FPSCR:
        batch_set_fpscr();
        break;
      case BATCH_COMPILED:
        batch_compiled();
        break;
      case BATCH_VM:
        batch_vm();
        break;
      case BATCH_CYCLE:
        batch_cycle();
        break;
      default:
        return 1;
    }
  }
  return 0;
}
