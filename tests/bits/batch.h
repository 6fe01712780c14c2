// A batch of controllers on a bare Cortex-M: jobs come from a file of the host's, answers go into another.
//
// Both files are words of 32 bits, little endian, over semihosting. A job is its number and what its function reads
// (see batch.c); rows stream through two small buffers, so a job may have any number of steps in 16 KiB of RAM.

#ifndef BATCH_H_
#define BATCH_H_

#include <stdint.h>

typedef enum {
  BATCH_FLOAT = 1,      // => sv_check_float, FPSCR (0 without an FPU)
  BATCH_SET_FPSCR = 2,  // word: do harm, so that the host sees that it is noticed
  BATCH_COMPILED = 3,   // a transpiled program
  BATCH_VM = 4,         // the virtual machine
  BATCH_CYCLE = 5       // the whole cycle around the virtual machine
} batch_job;

// One transpiled controller of the image.
typedef struct {
  int32_t ninput;
  int32_t noutput;
  int32_t (*selftest)(void);
  void (*init)(void);
  void (*step)(const float* inputs, float* outputs);
} batch_program;

// written by the host for each image
extern const batch_program kPrograms[];

int main(void);

// Read words, all of them, from the host's file; return 0 at its end.
int32_t batch_read(void* words, int32_t n);

// Append words to the host's other file.
void batch_write(const void* words, int32_t n);

// Open both files; end the emulation.
void batch_open(void);
void batch_exit(int32_t status) __attribute__((noreturn));

#endif  // BATCH_H_
