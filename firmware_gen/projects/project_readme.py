"""The README of a firmware project: all that a reader needs who has this folder and no servolve."""

from __future__ import annotations

import textwrap
from typing import Final

from controller import Controller
from controller.rig import Rig
from firmware_gen.projects.board import Board
from firmware_gen.projects.plain import plain
from firmware_gen.projects.rig_config import CONSOLE_BAUD, SENSOR_BAUD

_PACKAGES: Final = {"cc": "gcc", "arm-none-eabi-gcc": "gcc-arm-none-eabi"}

CONSOLE: Final = (
    ("help", "list the commands"),
    ("status", "state, whether it is armed, why the last run ended (`runtime/sv_reason.h`), cycles"),
    ("goal D [BEARING]", "distance of the goal ahead [m], its direction from the heading [rad]"),
    ("seconds S", "length of a run [s]"),
    ("derate X", "part of the torque ceiling that is allowed, above 0 and at most 1"),
    ("arm", "allow torque, for one run"),
    ("disarm", "take that back"),
    ("start", "run; without `arm` only the checks are made, and nothing is written to the servos"),
    ("stop", "end the run"),
)
"""The console's commands, and what each does."""


def readme_text(controller: Controller, rig: Rig, board: Board) -> str:
    """Write `README.md`.

    Args:
        controller: the controller
        rig: the rig
        board: the board
    """
    return "\n".join(
        [
            f"# {plain(controller.name)} on {plain(rig.name)}: firmware for {plain(board.name)}",
            "",
            *_wrapped(
                f"Board: {board.title} ({board.chip}). What this folder was made from stands in `servolve.json`."
            ),
            "",
            *(_install() if board.form == "arduino" else _build(board)),
            *_flash(board),
            *_servos(rig),
            "## Wiring",
            "",
            board.wiring,
            "",
            "## Power",
            "",
            board.power,
            "",
            *_steps(rig, board),
            *_console(),
            *_stops(rig, board),
            *_files(board),
        ]
    )


def _install() -> list[str]:
    steps = (
        "Arduino IDE: put this folder into the sketchbook's `libraries/`, install *Dynamixel2Arduino* and the board's "
        "package by their managers, then open the library's sketches under File, Examples. `…_Dynamixel` is for boards "
        "that Dynamixel2Arduino knows, `…_Serial` for a serial port with a direction pin; it needs no other library.",
        "PlatformIO: put this folder into a project's `lib/`, a sketch of `examples/` into its `src/`, and for "
        "`…_Dynamixel` write `lib_deps = robotis-git/Dynamixel2Arduino` into `platformio.ini`.",
        "For the Library Manager, to which others' libraries are submitted, write a page of yours behind `url=` of "
        "`library.properties`; the IDE itself needs none.",
        "Every C file forbids the compiler to fuse products with sums, and the controller checks at start that it "
        "computes the reference's bits; where it does not, the console says so and no run starts.",
    )
    return ["## Install", "", *(line for step in steps for line in [*_wrapped(step), ""])]


def _build(board: Board) -> list[str]:
    package = _PACKAGES.get(board.compiler, board.compiler)
    return [
        "## Build",
        "",
        f"It needs CMake, {board.compiler}, and Make or Ninja: `apt-get install cmake make {package}`.",
        "",
        "```sh",
        "cmake -B build",
        "cmake --build build",
        "```",
        "",
        f"That leaves `build/{board.elf}`. With Ninja instead of Make, the first line is `cmake -B build -G Ninja`.",
        "",
    ]


def _flash(board: Board) -> list[str]:
    if not board.flash:
        return []
    lines = ["## Flash", ""]
    for flash in board.flash:
        lines += [f"With {flash.tool}:", "", "```sh", f"cmake --build build --target {flash.target}", "```", ""]
    return lines


def _servos(rig: Rig) -> list[str]:
    return [
        "## Servos",
        "",
        f"Bus: {rig.bus.protocol}, {rig.bus.baud} bit/s, {rig.supply_v:g} V.",
        "",
        "| joint | id | servo | mode | return delay |",
        "|---|---|---|---|---|",
        *(
            f"| {plain(joint.name)} | {joint.id} | {joint.product.name} | {joint.mode} | {rig.bus.return_delay_us} us |"
            for joint in rig.joints
        ),
        "",
        "Their EEPROM is compared and never written: `servolve rig check` says what to set, and can set it.",
        "",
    ]


def _steps(rig: Rig, board: Board) -> list[str]:
    if board.machine == "twin":
        return [
            "## Run",
            "",
            "`servolve firmware CONTROLLER --rig RIG --board host --out DIR --run` runs it on the virtual rig.",
            "",
        ]
    sensors = f" The sensor node sends at {SENSOR_BAUD} bit/s." if rig.sensors else ""
    return [
        "## First run",
        "",
        f"1. Hang the robot up, or hold it. Keep the servos' power switch at hand.{sensors}",
        f"2. Open the console at {CONSOLE_BAUD} bit/s, 8N1, as with `picocom -b {CONSOLE_BAUD} /dev/ttyUSB0`.",
        "3. `start`: a dry run. Every servo is read, none is written to; what is wrong is told with its register.",
        "4. `derate 0.5`, `seconds 2`, `arm`, `start`: homing, then two seconds with half the torque.",
        "5. `derate 1`, `seconds 6`, `arm`, `start`.",
        "",
        "Between its lines of text the console carries the log as binary records. Record all that it sends, as with",
        "`picocom --logfile CONSOLE.bin`, and `servolve log CONSOLE.bin --project . --out LOG.mcap` makes of it",
        "the log that `servolve deploy` writes.",
        "",
    ]


def _console() -> list[str]:
    rows = [f"| `{command}` | {what} |" for command, what in CONSOLE]
    return ["## Console", "", "| command | what it does |", "|---|---|", *rows, ""]


def _stops(rig: Rig, board: Board) -> list[str]:
    safety = rig.safety
    held = " (then the servos hold their last goal)" if safety.stop == "hold" else ""
    tilt = f", the base tilts more than {safety.tilt_rad_max:g} rad" if safety.tilt_rad_max > 0.0 else ""
    reasons = (
        f"the time is over{held}, or you write `stop`, press the emergency stop, or the sensor node sends `$E`;",
        f"a servo misses more than {safety.missed_cycles_max} replies in a row, reports an error, loses its torque, is "
        f"above {safety.temperature_c_max:g} degrees Celsius or below {safety.voltage_low_v:g} V;",
        f"a joint is {safety.tracking_rad_max:g} rad from its goal for {safety.tracking_s_max:g} s, or jumps;",
        f"a sensor that it needs is silent{tilt}, or more than {safety.overrun_cycles_max} periods in a row overrun;",
        *_stuck(board),
    )
    if safety.watchdog_s > 0.0:
        alone = (
            f"If the board dies or a wire breaks, the servos' bus watchdogs stop them after {safety.watchdog_s:g} s."
        )
    else:
        alone = (
            "**If the board dies or a wire breaks, nothing on the servos stops them**: their bus watchdogs are off, or "
            "they have none, as Feetech's STS. They go on with the last goal until their overload protection or you "
            "cut them off, or until the board boots again. Put a switch into their supply, and keep it at hand."
        )
    return [
        "## What stops it",
        "",
        "A run ends, and torque is taken from every servo and read back, when",
        "",
        *(line for reason in reasons for line in _wrapped(reason, "- ", "  ")),
        "",
        *_wrapped(alone),
        "",
        *_wrapped("At every boot, whatever has reset the board, its first packet is torque off for every servo."),
        "",
    ]


def _stuck(board: Board) -> list[str]:
    """Return what ends a run whose program does not go on."""
    if board.form == "arduino":
        return [
            "the program hangs, on an AVR: its watchdog resets it, and as it boots it takes the torque. On other "
            "processors that needs a watchdog of your sketch's (`feed_watchdog`); without one it is as if the board "
            "had died. There is no fault handler on any."
        ]
    if board.machine == "twin":
        return []
    return ["the program hangs or faults: the board's watchdog or fault handler takes the torque and resets."]


def _wrapped(text: str, first: str = "", rest: str = "") -> list[str]:
    return textwrap.wrap(text, 116, initial_indent=first, subsequent_indent=rest, break_on_hyphens=False)


def _files(board: Board) -> list[str]:
    folders = (
        (
            (
                "src/",
                "the controller as C, the rig as data, bus, checks, states, safety, log, and what they need of a board",
            ),
            ("examples/", "sketches: which ports and pins there are"),
        )
        if board.form == "arduino"
        else (
            ("src/", "the controller as C, the rig as data, `main.c`"),
            ("runtime/", "bus, checks, states, safety, log: the same for every rig and board"),
            ("board/", "start-up code, clock, lines, inputs and watchdog of this board"),
        )
    )
    return [
        "## Files",
        "",
        "| folder | what it holds |",
        "|---|---|",
        *(f"| `{folder}` | {what} |" for folder, what in folders),
        "",
        "Generated files say so in their first lines; the same controller, rig and board give the same bytes.",
        "",
    ]
