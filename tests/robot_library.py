"""The firmware's robot as a shared library, with a HAL of a silent bus and clock: words go in, packets come out."""

import ctypes
import subprocess
from pathlib import Path

from firmware_gen.projects.rig_config import rig_header, rig_source
from firmware_gen.transpiler.unit import make_unit

ROOT = Path(__file__).parents[1]
RUNTIME, SHARED = ROOT / "firmware_gen" / "runtime", ROOT / "controller" / "runtime"
HAL = """
#include "rig.h"
#include "sv_console.h"
#include "sv_hal.h"
static sv_robot robot;
static int64_t now_us, fed_us, starved_us;
static int32_t cause, nbus;
static uint8_t bus[65536];
static const uint8_t* typed;
static int32_t ntyped, nsaid;
static uint32_t inputs;
static char said[4096];
void boot(int32_t selftest, int32_t reset, int64_t at_us);
void run(void);
void idle(int64_t us);
int64_t now(void);
int64_t starved(void);
const uint8_t* sent(int32_t* n);
int32_t state(sv_why* why);
void press(uint32_t active);
void pass(int32_t us);
const sv_wish* type(const uint8_t* bytes, int32_t n);
const char* answer(void);
const char* heard(int32_t* n);
int32_t decimal(const char* text, float* value);
void boot(int32_t selftest, int32_t reset, int64_t at_us) {
  static float memory[64];
  typed = 0;
  ntyped = nsaid = nbus = 0;
  now_us = fed_us = at_us;
  starved_us = 0;
  cause = reset;
  sv_robot_init(&robot, &servolve_rig, selftest, 0, memory, memory);
}
void run(void) { sv_robot_poll(&robot); }
void idle(int64_t us) {
  for (const int64_t until_us = now_us + us; now_us < until_us;) {
    sv_robot_poll(&robot);
  }
}
int64_t now(void) { return now_us; }
int64_t starved(void) { return starved_us; }
const uint8_t* sent(int32_t* n) {
  *n = nbus;
  return bus;
}
int32_t state(sv_why* why) {
  *why = robot.watch.why;
  return robot.state;
}
void press(uint32_t active) { inputs = active; }
void pass(int32_t us) { now_us += us; }
const sv_wish* type(const uint8_t* bytes, int32_t n) {
  typed = bytes;
  ntyped = n;
  nsaid = 0;
  while (ntyped > 0) {
    sv_console_listen(&robot);
  }
  sv_console_listen(&robot);
  return &robot.wish;
}
const char* answer(void) {
  said[nsaid] = 0;
  return said;
}
const char* heard(int32_t* n) {
  *n = nsaid;
  return said;
}
int32_t decimal(const char* text, float* value) {
  sv_decimal number;
  const char* rest = sv_decimal_parse(text, &number);
  *value = rest ? sv_decimal_float(&number) : 0.0F;
  return rest != 0 && *rest == 0;
}
void sv_hal_init(void) {}
uint32_t sv_hal_now_us(void) { return (uint32_t)now_us; }
void sv_hal_wait(uint32_t until_us) {
  const int32_t wait_us = (int32_t)(until_us - (uint32_t)now_us);
  now_us += wait_us > 0 ? wait_us : 0;
  starved_us = now_us - fed_us > starved_us ? now_us - fed_us : starved_us;
}
int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) {
  int32_t n = 0;
  while (line == SV_LINE_CONSOLE && n < size && ntyped > 0) {
    data[n++] = *typed++;
    ntyped--;
  }
  return n;
}
int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  for (int32_t i = 0; i < size && line == SV_LINE_CONSOLE && nsaid < 4000; i++) {
    said[nsaid++] = (char)data[i];
  }
  for (int32_t i = 0; i < size && line == SV_LINE_BUS && nbus < (int32_t)sizeof bus; i++) {
    bus[nbus++] = data[i];
  }
  return size;
}
uint32_t sv_hal_inputs(void) { return inputs; }
void sv_hal_feed_watchdog(void) { fed_us = now_us; }
int32_t sv_hal_reset_cause(void) { return cause; }
"""
PROGRAM = """
#include "sv_program.h"
void sv_reset(const sv_program* program, float* registers, float* state) {
  (void)program, (void)registers, (void)state;
}
void sv_step(const sv_program* program, float dt, const float* inputs, float* registers, float* state, float* outputs) {
  (void)program, (void)dt, (void)inputs, (void)registers, (void)state, (void)outputs;
}
int32_t sv_verify(const sv_program* program) { return program == 0; }
"""
FLAGS = "-std=c99 -O1 -Wall -Wextra -Wconversion -Wmissing-prototypes -Werror -ffp-contract=off -fsanitize=undefined"


def compile_runtime(folder):
    """Return the objects of all that is the same for every rig.

    Args:
        folder: where they are built
    """
    sources = [path for path in sorted(RUNTIME.glob("*.c")) if path.name != "main.c"]
    sources += [SHARED / f"sv_{name}.c" for name in ("cycle", "homing", "schedule")]
    (folder / "program.c").write_text(PROGRAM)
    _compile("-c", *sources, "program.c", folder=folder)
    return sorted(folder.glob("*.o"))


def build_robot(folder, objects, rig, controller):
    """Return the library.

    Args:
        folder: where it is built
        objects: of the runtime
        rig: the rig
        controller: any that fits it; it is never run
    """
    texts = {"rig.c": rig_source(rig, controller), "rig.h": rig_header(rig, make_unit(controller)), "hal.c": HAL}
    for name, text in texts.items():
        (folder / name).write_text(text)
    _compile("-shared", "-o", "robot.so", "rig.c", "hal.c", *objects, folder=folder)
    built = ctypes.CDLL(str(folder / "robot.so"))
    built.now.restype = built.starved.restype = ctypes.c_int64
    built.sent.restype = built.heard.restype = ctypes.POINTER(ctypes.c_uint8)
    built.boot.argtypes = (ctypes.c_int32, ctypes.c_int32, ctypes.c_int64)
    built.idle.argtypes = (ctypes.c_int64,)
    return built


def _compile(*arguments, folder):
    command = [
        "gcc",
        *FLAGS.split(),
        "-fsanitize-undefined-trap-on-error",
        "-fPIC",
        "-I.",
        f"-I{RUNTIME}",
        f"-I{SHARED}",
    ]
    subprocess.run([*command, *map(str, arguments)], check=True, cwd=folder)
