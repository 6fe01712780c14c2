// The order of bus transactions in a period, the same in host loop and firmware.
//
// In every period k: read the state of all servos, run the control cycle, write all goals, and then, in every
// health_every-th period, read one health block of one servo. All servos take turns with the first block, then all with
// the second, and so on.

#ifndef SV_SCHEDULE_H_
#define SV_SCHEDULE_H_

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SV_HEALTH_MAX 4  // health blocks of a servo

// in the order of a period
typedef enum {
  SV_READ_STATE = 0,   // sync read of all servos
  SV_RUN_CYCLE = 1,    // no bus traffic: sv_cycle_step
  SV_WRITE_GOALS = 2,  // sync write to all servos
  SV_READ_HEALTH = 3   // read of one servo
} sv_transaction_kind;

typedef struct {
  uint16_t address;  // first register
  uint16_t size;     // bytes
} sv_block;

typedef struct {
  int32_t nservo;
  sv_block state;
  sv_block goal;
  int32_t nhealth;
  sv_block health[SV_HEALTH_MAX];
  int32_t health_every;  // periods from one health read to the next
} sv_schedule;

typedef struct {
  int32_t kind;           // sv_transaction_kind
  int32_t servo;          // index on the bus for SV_READ_HEALTH, else -1
  const sv_block* block;  // what is read or written; no matter for SV_RUN_CYCLE
} sv_transaction;

// Tell what happens as number i >= 0 in period k >= 0: => due; return whether anything does.
int32_t sv_schedule_due(const sv_schedule* schedule, int32_t k, int32_t i, sv_transaction* due);

#ifdef __cplusplus
}
#endif

#endif  // SV_SCHEDULE_H_
