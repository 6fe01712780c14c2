"""The whole firmware on an AVR and on Cortex-M: given what the native twin was given, it says what the twin said.

An AVR has 8-bit registers and 16-bit ints, and its floats are a library's: what the firmware's C leaves to the
compiler shows here. Every byte on the bus and of the log counts, and every time to which it waits.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from emulated_batch import BITS, M0, M4F, WARNINGS, Target
from toolchain import run_tool

from controller import load_controller
from controller.rig_file import load_rig
from deploy.firmware.bench import FirmwareBench
from deploy.firmware.machine import Given, Taken
from deploy.firmware.run import commands
from deploy.firmware.twin import TwinProcess
from deploy.host_loop import RunOptions
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig
from firmware_gen.projects.board import load_board
from firmware_gen.projects.build import build_firmware
from firmware_gen.projects.project import RUNTIME, make_project, write_project

LAMP = load_controller(Path(__file__).parent / "golden" / "lamp-robust.controller.toml")
RUN_S, END_S = 0.6, 3.0
STACK_MAX = 1200  # bytes; the sketch for a Mega leaves more, see test_arduino.py
FNV_START, FNV_FACTOR = 2166136261, 16777619

# lost, corrupt and late replies; servos of the other family; then a run that goes well, and a servo that dies
SCENES = (("lamp-xc330", ("drop=0.05", "corrupt=0.05", "late=0.02:5")), ("lamp-sts3215", ()))
SCENES_LONG = (*SCENES, ("lamp-xc330", ()), ("lamp-xc330", ("dead=1@1.0",)))


@dataclass(frozen=True)
class Scene:
    """Hold a recorded run of the twin, and the firmware's sources.

    Args:
        sources: folder of the library's C files
        given: what the twin was given, wait by wait
        taken: what it did after each
    """

    sources: Path
    given: tuple[Given, ...]
    taken: tuple[Taken, ...]


class Sum:
    """Add bytes to an FNV-1a sum of 32 bits."""

    def __init__(self):
        self.value = FNV_START

    def add(self, data):
        for byte in data:
            self.value = (self.value ^ byte) * FNV_FACTOR & 0xFFFFFFFF


def record_run(folder, rig, faults):
    """Run the native twin on a virtual rig; return what passed."""
    twin = build_firmware(LAMP, rig, "host", folder / "host")
    given, taken = [], []
    with TwinProcess(twin) as process:
        bench = FirmwareBench(VirtualRig(rig, faults=[parse_fault(fault) for fault in faults]), process)
        for line in commands(RunOptions(0.3, 0.0, RUN_S, True, 1.0), rig.period_s):
            bench.say(line)
        while bench.now < END_S:
            given_now, taken_now = bench.wake()
            given.append(given_now)
            taken.append(taken_now)
            bench.send(taken_now)
            bench.wait(taken_now)
    return tuple(given), tuple(taken)


def pytest_generate_tests(metafunc):
    if "scene" in metafunc.fixturenames:
        scenes = SCENES_LONG if metafunc.config.getoption("--long") else SCENES
        names = [" ".join((rig, *faults)) for rig, faults in scenes]
        metafunc.parametrize("scene", scenes, ids=names, indirect=True, scope="module")


@pytest.fixture(scope="module")
def scene(request, tmp_path_factory):
    name, faults = request.param
    folder = tmp_path_factory.mktemp("scene")
    rig = load_rig(name)
    write_project(make_project(LAMP, rig, load_board("arduino")), folder / "library")
    return Scene(folder / "library" / "src", *record_run(folder, rig, faults))


def write_record(scene, folder):
    """Write the record's four streams, as replay.h says."""
    sums = [Sum(), Sum(), Sum()]
    events = b""
    for i, given in enumerate(scene.given):
        total = sums[0].value ^ sums[1].value ^ sums[2].value
        lines = (given.bus, given.sensors, given.console)
        events += struct.pack("<IIB3H", total, given.now_us, given.inputs, *map(len, lines))
        sums[0].add(struct.pack("<I", scene.taken[i].until_us))
        sums[1].add(b"".join(scene.taken[i].boot + scene.taken[i].bus))
        sums[2].add(scene.taken[i].console)
    for name in ("bus", "sensors", "console"):
        (folder / f"record.{name}").write_bytes(b"".join(getattr(given, name) for given in scene.given))
    (folder / "record.events").write_bytes(events)


def sources_of(scene):
    library = sorted(scene.sources.glob("*.c"))
    return [str(path) for path in (*library, RUNTIME / "main.c", BITS / "replay.c")]


def test_the_record_is_of_a_run_that_moves(scene):
    assert len(scene.given) > 200
    assert len({taken.bus for taken in scene.taken}) > 40
    assert sum(len(taken.console) for taken in scene.taken) > 2000


def test_on_an_avr(scene, tmp_path):
    write_record(scene, tmp_path)
    flags = ["-mmcu=atmega2560", "-std=gnu11", "-Os", "-flto", "-fno-fat-lto-objects", "-ffunction-sections"]
    flags += ["-Wall", "-Wextra", "-Werror", f"-I{scene.sources}", f"-DREPLAY_NEVENT={len(scene.given)}"]
    run_tool(["avr-gcc", *flags, "-c", *sources_of(scene), str(BITS / "replay_avr.c")], tmp_path)
    run_tool(["avr-gcc", "-mmcu=atmega2560", "-c", str(BITS / "replay_record.S")], tmp_path)
    objects = sorted(path.name for path in tmp_path.glob("*.o") if path.name != "replay_record.o")
    link = ["-mmcu=atmega2560", "-Os", "-flto", "-Wl,--gc-sections", "-Wl,--undefined=replay_events"]
    run_tool(["avr-gcc", *link, "-o", "replay.elf", *objects, "replay_record.o"], tmp_path)
    said = run_tool(["simavr", "-m", "atmega2560", "-f", "16000000", "replay.elf"], tmp_path)
    event, differs, stack = (int(word, 16) for word in re.findall(r"([0-9a-f]{8})\.$", said, re.MULTILINE))
    assert not differs, f"event {event} of {len(scene.given)}: {scene.given[event]}"
    assert event == len(scene.given)
    assert stack <= STACK_MAX


@pytest.mark.parametrize("target", [M0, M4F], ids=lambda target: target.name)
def test_on_a_cortex_m(scene, target: Target, tmp_path):
    write_record(scene, tmp_path)
    flags = [*target.flags, *WARNINGS, "-std=gnu11", "-Os", f"-I{scene.sources}", f"-I{BITS}"]
    sources = [*sources_of(scene), str(BITS / "replay_arm.c"), str(BITS / "start.c"), str(BITS / "replay_record.S")]
    run_tool(["arm-none-eabi-gcc", *flags, f"-DREPLAY_NEVENT={len(scene.given)}", "-c", *sources], tmp_path)
    objects = sorted(path.name for path in tmp_path.glob("*.o") if path.name != "replay_record.o")
    link = ["-nostartfiles", f"-L{BITS}", f"-T{BITS / target.machine}.ld", "-o", "replay.elf"]
    run_tool(["arm-none-eabi-gcc", *target.flags, *link, *objects, "replay_record.o"], tmp_path)
    (tmp_path / "jobs").write_bytes(b"")
    qemu = ["qemu-system-arm", "-M", target.machine, "-kernel", "replay.elf", "-display", "none", "-monitor", "none"]
    run_tool([*qemu, "-serial", "none", "-semihosting-config", "enable=on,target=native"], tmp_path)
    event, differs = np.fromfile(tmp_path / "answers", "<i4")
    assert not differs, f"event {event} of {len(scene.given)}: {scene.given[event]}"
    assert event == len(scene.given)
