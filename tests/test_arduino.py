"""The Arduino library: its files are what IDE and PlatformIO look for, and it compiles for a board of Debian's core."""

from __future__ import annotations

import json
import os
import re
import select
import subprocess
from pathlib import Path

import pytest
from toolchain import run_tool

from controller import load_controller
from controller.errors import InputError
from controller.rig_file import load_rig
from firmware_gen.projects.board import load_board
from firmware_gen.projects.build import build_project
from firmware_gen.projects.project import make_project, write_project

LAMP = Path(__file__).parent / "golden" / "lamp-robust.controller.toml"
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")

# as platform.txt has them; the packaged core needs a macro that the packaged compiler's C++ does not define
MEGA = ["-mmcu=atmega2560", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_MEGA2560", "-DARDUINO_ARCH_AVR"]
MEGA += ["-DDECIMAL_DIG=__DECIMAL_DIG__", f"-I{ARDUINO}/cores/arduino", f"-I{ARDUINO}/variants/mega"]
COMMON = ["-c", "-Os", "-ffunction-sections", "-fdata-sections", "-flto"]
C = [*COMMON, "-std=gnu11", "-fno-fat-lto-objects"]
CPP = [*COMMON, "-std=gnu++11", "-fpermissive", "-fno-exceptions", "-fno-threadsafe-statics"]
STRICT = ["-Wall", "-Wextra", "-Werror"]
FLASH, RAM, STACK_MIN = 253_952, 8192, 1500
BOOT_SECONDS_MAX = 60.0


def boot(image):
    """Run a sketch on an emulated Mega until its console has said a line; return what it has said."""
    command = ["simavr", "-m", "atmega2560", "-f", "16000000", str(image)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    said = b""
    try:
        while b"help" not in said and select.select([process.stderr], [], [], BOOT_SECONDS_MAX)[0]:
            said += os.read(process.stderr.fileno(), 4096)
    finally:
        process.kill()
        process.communicate()
    return said.decode(errors="replace")


@pytest.fixture(scope="module", params=["lamp-xc330", "lamp-sts3215"])
def library(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("library")
    project = make_project(load_controller(LAMP), load_rig(request.param), load_board("arduino"))
    write_project(project, folder)
    return folder


def test_ide_and_platformio_find_what_they_look_for(library):
    told = dict(line.split("=", 1) for line in (library / "library.properties").read_text().splitlines())
    needed = "name version author maintainer sentence paragraph category url architectures"
    assert set(needed.split()) <= told.keys()
    assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_ .-]*", told["name"]) and re.fullmatch(
        r"\d+\.\d+\.\d+", told["version"]
    )
    about = json.loads((library / "library.json").read_text())
    assert (about["name"], about["version"], about["headers"]) == (told["name"], told["version"], told["includes"])
    assert (library / "src" / told["includes"]).is_file()
    sources = "".join(path.read_text() for path in (library / "src").iterdir())
    for line in (library / "keywords.txt").read_text().splitlines():
        word, kind = line.split("\t")
        assert kind in ("KEYWORD1", "KEYWORD2", "LITERAL1") and re.search(rf"\b{word}\b", sources)
    sketches = sorted((library / "examples").glob("*/*.ino"))
    assert [path.stem for path in sketches] == [path.parent.name for path in sketches] != []
    for sketch in sketches:
        assert f"#include <{told['includes']}>" in sketch.read_text() and "{" + "header}" not in sketch.read_text()
        assert "void setup()" in sketch.read_text() and "void loop()" in sketch.read_text()


def test_every_source_forbids_fusing(library):
    sources = [path for path in (library / "src").iterdir() if path.suffix in (".c", ".cpp")]
    assert len(sources) > 15
    for path in sources:
        text = path.read_text()
        where = text.index('#pragma GCC optimize("fp-contract=off")')
        code = re.search(r"^(static|int32_t|void|float) ", text, re.MULTILINE)
        assert code is None or where < code.start(), path.name


def test_library_and_sketch_compile_for_a_mega(library, tmp_path):
    assert ARDUINO.is_dir(), "the Arduino core is not installed; .ci/system-packages fetches it"
    core, own = tmp_path / "core", tmp_path / "own"
    core.mkdir()
    own.mkdir()
    run_tool(["avr-gcc", *C, *MEGA, "-w", *map(str, sorted((ARDUINO / "cores/arduino").glob("*.c")))], core)
    run_tool(["avr-g++", *CPP, *MEGA, "-w", *map(str, sorted((ARDUINO / "cores/arduino").glob("*.cpp")))], core)
    assembler = sorted(map(str, (ARDUINO / "cores/arduino").glob("*.S")))
    run_tool(["avr-gcc", "-c", "-x", "assembler-with-cpp", "-flto", *MEGA, *assembler], core)
    run_tool(["avr-gcc-ar", "rcs", "../core.a", *(path.name for path in sorted(core.iterdir()))], core)

    # as the IDE does: the sketch becomes C++ with one line before it
    (sketch,) = (library / "examples").glob("*_Serial/*.ino")
    (own / "sketch.cpp").write_text("#include <Arduino.h>\n" + sketch.read_text())
    library_c = sorted(map(str, (library / "src").glob("*.c")))
    library_cpp = sorted(map(str, (library / "src").glob("*.cpp")))
    run_tool(["avr-gcc", *C, *MEGA, *STRICT, *library_c], own)
    run_tool(["avr-g++", *CPP, *MEGA, *STRICT, f"-I{library}/src", *library_cpp, "sketch.cpp"], own)
    objects = sorted(map(str, own.glob("*.o")))
    link = ["-w", "-Os", "-flto", "-fuse-linker-plugin", "-Wl,--gc-sections", "-mmcu=atmega2560"]
    run_tool(["avr-gcc", *link, "-o", "firmware.elf", *objects, "core.a", "-lm"], tmp_path)

    text, data, bss = map(int, run_tool(["avr-size", "firmware.elf"], tmp_path).splitlines()[1].split()[:3])
    assert text + data <= FLASH
    assert data + bss + STACK_MIN <= RAM
    about = load_board("arduino").chip
    (said,) = re.findall(r"fills (\d+) KiB of flash and (\d+) KiB of RAM", about)
    for bytes_taken, kib in zip((text + data, data + bss + STACK_MIN), said, strict=True):
        assert 0.75 * int(kib) < bytes_taken / 1024 <= int(kib), (
            f"{bytes_taken} bytes, but the board's file says {about}"
        )
    names = run_tool(["avr-nm", "-C", "firmware.elf"], tmp_path)
    assert "main" in names and "malloc" not in names
    assert "servolve: try help" in boot(tmp_path / "firmware.elf")


def test_the_c_compiles_for_the_openrb_s_processor(library, tmp_path):
    flags = ["-mcpu=cortex-m0plus", "-mthumb", "-Os", "-std=gnu11", "-ffunction-sections", "-Wconversion", *STRICT]
    sources = sorted(map(str, (library / "src").glob("*.c")))
    run_tool(["arm-none-eabi-gcc", *flags, "-c", *sources], tmp_path)


def test_it_is_not_built_by_cmake(tmp_path):
    with pytest.raises(InputError, match=r"Arduino IDE or PlatformIO, as its README.md says; leave out --build"):
        build_project(tmp_path, load_board("arduino"))
