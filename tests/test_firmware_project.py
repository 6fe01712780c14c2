"""Firmware projects: the same bytes from the same input, built by their own README."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from rig_in_c import FLAGS

from controller import load_rig, parse_controller
from controller.errors import InputError
from firmware_gen.projects.board import BOARDS, board_names, load_board
from firmware_gen.projects.build import build_firmware, build_project, require_tools
from firmware_gen.projects.image_size import image_size
from firmware_gen.projects.project import CONTROLLER_RUNTIME, RUNTIME, SHARED, make_project, write_project
from firmware_gen.projects.project_readme import CONSOLE
from servolve.cli import main

LAMP = Path(__file__).parent / "golden" / "lamp-hop.controller.toml"
ARM = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-ffreestanding")
BUILT = sorted(path.parent.name for path in BOARDS.glob("*/board.toml") if load_board(path.parent.name).form == "cmake")
IMAGES = tomllib.loads((LAMP.parent / "image_sizes.toml").read_text())["image"]
LISTED = ", ".join(board_names())
COMPILERS = {"gcc": (), "clang": (), "arm-none-eabi-gcc": ARM}


def lamp():
    return parse_controller(LAMP.read_text(), str(LAMP))


def project_of(board="host", rig="lamp-xc330", **changes):
    return make_project(replace(lamp(), **changes), load_rig(rig), load_board(board))


def tree(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def readme_commands(folder, heading):
    """Return the commands under a heading of a README, as a reader would copy them."""
    section = (folder / "README.md").read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    return [line for block in re.findall(r"```sh\n(.*?)```", section, re.S) for line in block.splitlines()]


def shell(command, folder, **environment):
    done = subprocess.run(
        command, shell=True, cwd=folder, capture_output=True, text=True, check=False, env=os.environ | environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def flash_with_nothing(command, folder, tools):
    """Run a command of a README with tools that only say how they were called; return that."""
    for name in ("openocd", "dfu-util"):
        (tools / name).unlink(missing_ok=True)
        (tools / name).write_text('#!/bin/sh\necho "called: ${0##*/} $*"\n')
        (tools / name).chmod(0o755)
    told = shell(command, folder, PATH=str(tools))
    return next(line.removeprefix("called: ") for line in told.splitlines() if line.startswith("called: "))


def firmware(*arguments):
    return main(["firmware", str(LAMP), *map(str, arguments)])


# the same bytes


def test_two_processes_write_the_same_bytes(tmp_path):
    code = "import sys; from servolve.cli import main; sys.exit(main(sys.argv[1:]))"
    for seed in ("1", "2"):
        arguments = ["firmware", LAMP, "--rig", "lamp-xc330", "--board", "stm32f405", "--out", tmp_path / seed]
        done = subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)], check=False, env=os.environ | {"PYTHONHASHSEED": seed}
        )
        assert done.returncode == 0
    first = tree(tmp_path / "1")
    assert first == tree(tmp_path / "2") == {k: v.encode() for k, v in project_of("stm32f405").files.items()}
    told = json.loads(first["servolve.json"])
    assert told["rig"]["text"] == load_rig("lamp-xc330").text
    assert parse_controller(told["controller"]["text"], "told").program.inputs == lamp().program.inputs
    assert set(told["files"]) == set(first) - {"servolve.json"}


def test_a_fast_sync_read_is_a_matter_of_the_rigs_data_alone():
    board = load_board("host")
    slow, fast = (make_project(lamp(), load_rig("lamp-xc330"), board, asked).files for asked in (False, True))
    differing = {path for path in slow if slow[path] != fast[path]}
    assert differing == {"src/rig.c", "runtime/sv_rig_sizes.h", "servolve.json"}


# it builds


@pytest.mark.parametrize("board", ["host", "stm32f405"])
def test_a_project_builds_by_its_readmes_commands_alone(board, tmp_path):
    write_project(project_of(board), tmp_path / "written")
    folder = tmp_path / "elsewhere"
    shutil.copytree(tmp_path / "written", folder)  # nothing in it may point to where it was made
    # a reader has no servolve, and not everybody has Ninja
    tools = tmp_path / "bin"
    tools.mkdir()
    for tool in Path("/usr/bin").iterdir():
        if not tool.name.startswith(("ninja", "python", "servolve")):
            (tools / tool.name).symlink_to(tool)
    for command in readme_commands(folder, "Build"):
        shell(command, folder, PATH=str(tools), CFLAGS="-Werror")
    image = folder / "build" / load_board(board).elf
    assert image.is_file()
    if board == "host":
        assert subprocess.run([image], stdin=subprocess.DEVNULL, capture_output=True, check=False).returncode == 0
    else:
        assert (folder / "build" / "firmware.bin").stat().st_size == image_size(image)["text_bytes"]
        flashed = [flash_with_nothing(command, folder, tools) for command in readme_commands(folder, "Flash")]
        assert [line.split()[0] for line in flashed] == ["openocd", "dfu-util"]
        assert f"program {image} verify reset exit" in flashed[0] and str(image.with_suffix(".bin")) in flashed[1]


def test_a_project_builds_with_ninja_and_again_without_work(tmp_path):
    image = build_firmware(lamp(), load_rig("lamp-sts3215"), "host", tmp_path)
    assert "CMAKE_GENERATOR:INTERNAL=Ninja" in (tmp_path / "build" / "CMakeCache.txt").read_text()
    before = image.stat().st_mtime_ns
    assert build_firmware(lamp(), load_rig("lamp-sts3215"), "host", tmp_path) == image
    assert image.stat().st_mtime_ns == before, "nothing has changed"


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_file_compiles_without_a_warning(compiler, tmp_path):
    write_project(project_of(), tmp_path / "small")
    small = tmp_path / "small"
    shared = [CONTROLLER_RUNTIME / name for name in SHARED if name.endswith(".c")]
    runtime = [path for path in RUNTIME.glob("*.c") if path.name != "main.c"]
    runs = [
        ([*runtime, *shared], [RUNTIME, CONTROLLER_RUNTIME]),  # for the largest rig
        ([*small.glob("runtime/*.c"), *small.glob("src/*.c")], [small / "src", small / "runtime"]),
    ]
    for sources, includes in runs:
        paths = [f"-I{path}" for path in includes]
        command = [compiler, *FLAGS, *COMPILERS[compiler], "-O1", *paths, "-c", *map(str, sources)]
        folder = tmp_path / str(len(sources))
        folder.mkdir()
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("board", BUILT)
def test_every_board_compiles_without_a_warning_and_says_how_to_wire_it(board, tmp_path):
    found = load_board(board)
    project = project_of(board)
    write_project(project, tmp_path)
    includes = [f"-I{tmp_path / folder}" for folder in ("src", "runtime", "board")]
    sources = [str(tmp_path / "board" / source) for source in found.sources]
    done = subprocess.run(
        [found.compiler, *FLAGS, *found.flags, *includes, "-c", *sources],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    readme = project.files["README.md"]
    assert found.wiring in readme and found.power in readme and found.title in readme
    assert all(f"--target {flash.target}" in readme for flash in found.flash)


def test_the_readme_lists_the_commands_that_the_console_knows():
    console = (RUNTIME / "sv_console.c").read_text()
    for command, _ in CONSOLE:
        assert f'"{command.split()[0]}' in console, command


@pytest.mark.parametrize(
    ("board", "promised"),
    [("stm32f405", "fault handler takes the torque"), ("arduino", "There is no fault handler"), ("host", None)],
)
def test_the_readme_promises_no_watchdog_that_a_board_has_not(board, promised):
    stops = " ".join(project_of(board).files["README.md"].split("## What stops it")[1].split("## Files")[0].split())
    assert (promised or "periods in a row overrun") in stops
    assert ("hangs" in stops) == (promised is not None)
    assert ("`feed_watchdog`" in stops) == (board == "arduino")


# a board is a folder


def test_a_board_of_ones_own_is_a_folder(tmp_path):
    shutil.copytree(load_board("host").folder, tmp_path / "mine")
    (tmp_path / "mine" / "board.toml").write_text(
        (tmp_path / "mine" / "board.toml").read_text().replace('title = "', 'title = "my ')
    )
    (tmp_path / "mine" / "extra.h").write_text("// mine\n")
    project = make_project(lamp(), load_rig("lamp-xc330"), load_board(tmp_path / "mine"))
    assert project.files["board/extra.h"] == "// mine\n"
    assert "my native twin" in project.files["README.md"]
    assert json.loads(project.files["servolve.json"])["board"] == "mine"


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ('sources = ["hal.c"]', 'sources = ["lost.c"]', "no file lost.c"),
        ('sources = ["hal.c"]', 'sources = ["../hal.c"]', "no file"),
        ('sources = ["hal.c"]', 'sources = "hal.c"', "list of texts"),
        ("format = 1", "format = 2", "format 2"),
        ("title =", "titel =", "'titel' is not known"),
        ('compiler = "cc"', "", "compiler is missing"),
        ('elf = "firmware"', 'elf = "robot.elf"', "elf is 'robot.elf'; write firmware and what shall follow"),
        ('elf = "firmware"', 'elf = "../firmware"', "elf is '../firmware'"),
    ],
)
def test_a_board_that_is_wrong_is_refused_with_its_line(before, after, sentence, tmp_path):
    shutil.copytree(load_board("host").folder, tmp_path / "mine")
    text = (tmp_path / "mine" / "board.toml").read_text()
    assert before in text
    (tmp_path / "mine" / "board.toml").write_text(text.replace(before, after))
    with pytest.raises(InputError, match=re.escape(sentence)):
        load_board(tmp_path / "mine")


def test_a_project_that_changes_its_board_leaves_nothing_of_the_other(tmp_path):
    write_project(project_of("stm32f405"), tmp_path)
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "CMakeCache.txt").write_text("of another compiler")
    write_project(project_of("host"), tmp_path)
    assert tree(tmp_path) == {k: v.encode() for k, v in project_of("host").files.items()}


# sentences


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--rig", "lamp-xc330"), f"--board is missing; give it one of {LISTED}, or"),
        (
            ("--rig", "lamp-xc330", "--board", "uno"),
            f"board 'uno' is not known; choose one of {LISTED}, or",
        ),
        (("--rig", "lamp-ax12", "--board", "host"), "speak dynamixel-1.0, and firmware speaks"),
        (("--rig", "paper-lamp", "--board", "host"), "exists in simulation only, and firmware needs a bus"),
        (("--rig", "jumper-xc330", "--board", "host"), "give one output for each joint"),
        (("--rig", "nonesuch", "--board", "host"), "there is no rig 'nonesuch'"),
        (("--rig", "lamp-sts3215", "--board", "host", "--fast-sync-read"), "sts3215 servos have no fast sync read"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, sentence, tmp_path, capsys):
    assert firmware(*arguments, "--out", tmp_path / "out") == 2
    told = capsys.readouterr().err
    assert sentence in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("board", "there", "package"),
    [
        ("host", (), "cmake"),
        ("stm32f405", ("cmake",), "gcc-arm-none-eabi"),
        ("host", ("cmake",), "gcc"),
        ("host", ("cmake", "cc"), "ninja-build"),
    ],
)
def test_a_missing_tool_is_named_with_its_package(board, there, package, tmp_path, monkeypatch):
    for tool in there:
        (tmp_path / tool).symlink_to(shutil.which(tool))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=rf"apt-get install {package}$"):
        require_tools(load_board(board))


def test_what_does_not_compile_is_told_in_one_sentence(tmp_path):
    write_project(project_of(), tmp_path)
    (tmp_path / "src" / "rig.c").write_text("int rig = what;\n")
    with pytest.raises(RuntimeError, match=r"'what' undeclared|.what. undeclared"):
        build_project(tmp_path, load_board("host"))


# names


@pytest.mark.parametrize(
    "name",
    ["main", "rig", "program", "hal", "sv", "sv_robot", "servolve_rig", "int", "stdint", "Rig", "-" * 60, "a.b-c"],
)
def test_controllers_with_hostile_names_build(name, tmp_path):
    project = project_of(name=name)
    assert project.unit.name.isidentifier()
    write_project(project, tmp_path)
    paths = [f"-I{tmp_path / folder}" for folder in ("src", "runtime", "board")]
    sources = [str(tmp_path / path) for path in project.files if path.endswith(".c") and path.startswith("src/")]
    assert len(sources) == 4, "none has taken another's place"
    done = subprocess.run(
        ["gcc", *FLAGS, *paths, "-fsyntax-only", *sources], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("board", IMAGES)
def test_an_image_takes_what_is_on_record_and_its_sizes_are_as_binutils_counts_them(board, tmp_path, capsys):
    arguments = ("--rig", "lamp-xc330", "--board", board, "--out", tmp_path, "--build", "--json")
    assert main(["firmware", str(LAMP.with_name("lamp-robust.controller.toml")), *map(str, arguments)]) == 0
    told = json.loads(capsys.readouterr().out)
    counted = shell(f"arm-none-eabi-size {told['image']}", tmp_path).splitlines()[1].split()
    text, data, bss = map(int, counted[:3])
    found = {"text_bytes": text + data, "ram_bytes": data + bss}
    assert {key: told[key] for key in found} == found
    above = [f"{key} = {size}" for key, size in found.items() if size > 1.1 * IMAGES[board][key]]
    assert not above, f"write into tests/golden/image_sizes.toml if that is meant: {above}"
    assert found["text_bytes"] <= 16384, "vectors and constants too"
    assert found["ram_bytes"] <= 4096, "all of it, the stack too"


# the page


def test_the_page_says_what_is_on_record_of_an_image():
    page = " ".join((Path(__file__).parent.parent / "docs" / "firmware.md").read_text().split())
    said = re.search(r"an image takes ([\d.]+) KiB of flash and ([\d,]+) bytes of RAM", page)
    recorded = IMAGES["stm32f405"]
    assert 1024 * float(said[1]) == pytest.approx(recorded["text_bytes"], rel=0.05)
    assert int(said[2].replace(",", "")) == pytest.approx(recorded["ram_bytes"], rel=0.05)


def test_the_page_lists_every_board_and_command_and_its_example_is_one(tmp_path):
    page = (Path(__file__).parent.parent / "docs" / "firmware.md").read_text()
    assert set(re.findall(r"^\| `([\w-]+)` \| .* \|$", page.split("## The project")[0], re.M)) >= set(board_names())
    for command, _ in CONSOLE:
        assert f"`{command}" in page, command
    (tmp_path / "board.toml").write_text(re.findall(r"```toml\n(.*?)```", page, re.S)[0])
    for name in ("hal.c", "toolchain.cmake"):
        (tmp_path / name).write_text("")
    board = load_board(tmp_path)
    cmake = make_project(lamp(), load_rig("lamp-xc330"), board).files["CMakeLists.txt"]
    assert "add_custom_target(flash COMMAND openocd -f interface/stlink.cfg -c" in cmake
    assert "-T${CMAKE_CURRENT_SOURCE_DIR}/board/link.ld" in cmake
