// figure7: a robot controller, written by servolve transpile; do not edit.
//
//   controller  figure7
//   program     a6d9474c72a6eebd7b376ef9cd21d0058ec9a4fbde67b184898cdf29c4450ee6
//   generator   3
//   period      0.02 s
//   filter      none; slew limit none
//   memory      4 bytes of state; 2112 bytes of constants, for the selftest only
//   worst case  31 program operations a step, at most 39 float operations and comparisons
//
//   (list
//     (- (ifltz a0 pz a2) (% a1 t))
//     (ifltz (- (- (ifltz a0 pz a2) (% a1 t)) (ifltz (+ a2 15.4963) (ifltz a0 pz a2) (% a1 a2))) (ifltz (% (- s0 vx) (+ a2 s0)) (% (- s0 vx) (+ a2 s0)) (+ (- a1 a1) (- a1 t))) (% (+ a1 vz) (ifltz (* pz a1) (% a0 pz) (% px a0))))
//     (- (ifltz s0 (ifltz (- (% vx a0) (% vx vx)) (- (% vx a0) (- (+ -28.4382 t) (% a1 t))) (* 16.5266 s0)) vz) (+ a1 vz)))
//
// C99 without libc, heap, globals, recursion and double. Once a period:
//
//   figure7_step(&state, inputs, outputs);
//   figure7_command(&state, outputs, command);
//   counts = zero + round(command * counts per rad), half to even, within the servo's limits
//
// after figure7_selftest() has returned 0 and figure7_init(&state) has been called, at start-up.
//
// Symbols are <name>_<function>, <name>_input_<terminal> and <name>_output_<joint>. No <name> holds _input
// or _output, so those of two controllers never meet.

#ifndef figure7_H_
#define figure7_H_

#include <stdint.h>

// the source file compares these: a header and a source of different runs do not compile
#define figure7_GENERATOR 3
#define figure7_FINGERPRINT 0xe74291c5

#ifdef __cplusplus
extern "C" {
#endif

enum { figure7_ninput = 9, figure7_noutput = 3 };

// places in the array of inputs
typedef enum {
  figure7_input_t = 0,  // s, expected 0 to 10
  figure7_input_a0 = 1,  // rad, expected -1.06 to 1.06
  figure7_input_a1 = 2,  // rad, expected -1.147 to 1.147
  figure7_input_a2 = 3,  // rad, expected -1.147 to 1.147
  figure7_input_s0 = 4,  // N, expected 0 to 30
  figure7_input_px = 5,  // m, expected -1 to 1
  figure7_input_pz = 6,  // m, expected 0 to 0.6
  figure7_input_vx = 7,  // m/s, expected -2 to 2
  figure7_input_vz = 8  // m/s, expected -2 to 2
} figure7_input;

// places in the array of outputs
typedef enum {
  figure7_output_a0 = 0,  // position in deg, clamped to -60.7 to 60.7, 0 for a NaN
  figure7_output_a1 = 1,  // position in deg, clamped to -65.7 to 65.7, 0 for a NaN
  figure7_output_a2 = 2  // position in deg, clamped to -65.7 to 65.7, 0 for a NaN
} figure7_output;

typedef struct {
  float s[1];  // unused: this program has no memory
} figure7_state;

// Go back to the start.
void figure7_init(figure7_state* state);

// Evaluate one period: (inputs, state) => (outputs, state). The outputs are the program's own values.
void figure7_step(figure7_state* state, const float inputs[figure7_ninput], float outputs[figure7_noutput]);

// Clamp outputs where they are, in their own units: a NaN becomes neutral, the rest keeps to its limits.
void figure7_clamp(float outputs[figure7_noutput]);

// Turn the program's own outputs into commands [rad, rad/s], once a period: clamp, convert, filter, limit
// the rate. Both arrays may be the same.
void figure7_command(figure7_state* state, const float outputs[figure7_noutput], float command[figure7_noutput]);

// Check this build on this machine against the recorded answers of the reference. Returns 0: the same bits;
// n > 0: step n of the recording differs; -1: subnormals are flushed to zero; -2: products are fused with
// sums; -3: rounding is not to nearest even; -4: the clamp is wrong; -5: a copied function is wrong;
// -6: the command is wrong; -7: a closed loop, whose inputs follow its commands, goes another way.
int32_t figure7_selftest(void);

#ifdef __cplusplus
}
#endif

#endif  // figure7_H_
