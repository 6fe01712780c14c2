// The firmware of one rig with one controller: the same on every board.

#include <stdint.h>

#include "rig.h"
#include "sv_hal.h"
#include "sv_robot.h"

int main(void);

static sv_robot robot;
static float registers[SERVOLVE_NREGISTER];
static float memory[SERVOLVE_NSTATE > 0 ? SERVOLVE_NSTATE : 1];

int main(void) {
  sv_hal_init();
  sv_robot_init(&robot, &servolve_rig, servolve_selftest(), SERVOLVE_PROGRAM, registers, memory);
  for (;;) {
    sv_robot_poll(&robot);
  }
}
