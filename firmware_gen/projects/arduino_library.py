"""A firmware project as a library for the Arduino IDE and PlatformIO: the same C, and sketches in place of `main.c`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Final

from controller import Controller
from controller.rig import Rig
from firmware_gen.projects.plain import plain
from firmware_gen.transpiler.unit import GENERATOR_VERSION, Unit

_OWN: Final = frozenset({"main.c", "board.toml"})
_ROUND_TWICE: Final = """\
// a * b + c must round twice; Arduino's compilers fuse where the processor can
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

"""
_IN_FLASH: Final = """\
// an AVR copies constants to its small RAM unless they are said to stay in flash
#if defined(__FLASH)
#define SERVOLVE_FLASH __flash
#else
#define SERVOLVE_FLASH
#endif

"""
_KEYWORDS: Final = (
    ("ServolveBoard", "KEYWORD1"),
    ("ServolveBus", "KEYWORD1"),
    ("ServolvePortBus", "KEYWORD1"),
    ("ServolveSerialBus", "KEYWORD1"),
    ("servolve_loop", "KEYWORD2"),
    ("servolve_setup", "KEYWORD2"),
    ("SERVOLVE_BUS_BAUD", "LITERAL1"),
    ("SERVOLVE_CONSOLE_BAUD", "LITERAL1"),
    ("SERVOLVE_SENSOR_BAUD", "LITERAL1"),
)


def library_files(controller: Controller, rig: Rig, unit: Unit, files: Mapping[str, str]) -> dict[str, str]:
    """Turn the C files of a project into those of a library, which has all its sources in one folder.

    Args:
        controller: the controller
        rig: the rig
        unit: the controller's names in C
        files: path in a CMake project => contents, those of `src/`, `runtime/` and `board/`

    Returns:
        path in the library => contents
    """
    name, header = f"servolve_{unit.name}", f"{unit.name}_robot.h"
    title = f"{plain(controller.name)} on {plain(rig.name)}"
    library = {
        "keywords.txt": "".join(f"{word}\t{kind}\n" for word, kind in _KEYWORDS),
        "library.json": _platformio(name, header, title),
        "library.properties": _arduino(name, header, title),
        f"src/{header}": f'// {title}: what a sketch includes.\n\n#include "servolve_arduino.h"\n',
    }
    for path, text in files.items():
        place = PurePosixPath(path)
        if place.name in _OWN:
            continue
        if place.suffix == ".ino":
            sketch = f"{unit.name}_{place.stem}"
            library[f"examples/{sketch}/{sketch}.ino"] = text.replace("{header}", header).replace("{title}", title)
        else:
            library[f"src/{place.name}"] = _source(text, place, unit)
    return library


def _source(text: str, place: PurePosixPath, unit: Unit) -> str:
    if place.name == f"{unit.name}.c":
        # the selftest's recorded run is large, and read by index only
        table = f"uint32_t {unit.name}_recorded_"
        return _IN_FLASH + text.replace(f"static const {table}", f"static const SERVOLVE_FLASH {table}")
    if place.suffix in (".c", ".cpp") and "fp-contract=off" not in text:
        return _ROUND_TWICE + text
    return text


def _arduino(name: str, header: str, title: str) -> str:
    return "".join(
        f"{key}={value}\n"
        for key, value in (
            ("name", name),
            ("version", f"{GENERATOR_VERSION}.0.0"),
            ("author", "servolve"),
            ("maintainer", "servolve"),
            ("sentence", f"A servo robot's controller and all that drives its servos: {title}."),
            ("paragraph", "Written by servolve firmware; do not edit. README.md says how to wire and run it."),
            ("category", "Device Control"),
            ("url", ""),
            ("architectures", "*"),
            ("includes", header),
            ("depends", "Dynamixel2Arduino"),
        )
    )


def _platformio(name: str, header: str, title: str) -> str:
    told = {
        "name": name,
        "version": f"{GENERATOR_VERSION}.0.0",
        "description": f"A servo robot's controller and all that drives its servos: {title}.",
        "keywords": "robotics, servo, dynamixel, feetech",
        "frameworks": "arduino",
        "platforms": "*",
        "headers": header,
        "build": {"flags": ["-ffp-contract=off"]},
    }
    return json.dumps(told, indent=2) + "\n"
