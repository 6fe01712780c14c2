// A fuzzer's bytes, taken from the front; 0 once there are no more.

#ifndef FUZZ_INPUT_H_
#define FUZZ_INPUT_H_

#include <stddef.h>
#include <stdint.h>

#define REQUIRE(condition) \
  do {                     \
    if (!(condition)) {    \
      __builtin_trap();    \
    }                      \
  } while (0)

typedef struct {
  const uint8_t* bytes;
  size_t n;
} fuzz_input;

static inline uint8_t fuzz_byte(fuzz_input* input) {
  if (input->n == 0) {
    return 0;
  }
  input->n--;
  return *input->bytes++;
}

static inline uint32_t fuzz_number(fuzz_input* input, int32_t nbyte) {
  uint32_t number = 0;
  for (int32_t i = 0; i < nbyte; i++) {
    number = number << 8 | fuzz_byte(input);
  }
  return number;
}

// Take up to `size` bytes: => data; return how many.
static inline int32_t fuzz_take(fuzz_input* input, uint8_t* data, int32_t size) {
  int32_t n = 0;
  while (n < size && input->n > 0) {
    data[n++] = fuzz_byte(input);
  }
  return n;
}

#endif  // FUZZ_INPUT_H_
