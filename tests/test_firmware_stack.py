"""The stack of a whole image is known: the deepest chain of calls fits, with an interrupt and a fault upon it."""

import re
import subprocess
from pathlib import Path

import pytest
from toolchain import run_tool

from controller import load_controller, load_rig, parse_controller
from firmware_gen.projects.board import load_board
from firmware_gen.projects.project import make_project, write_project
from firmware_gen.projects.project_cmake import ARITHMETIC

GOLDEN = Path(__file__).parent / "golden"
LAMP = GOLDEN / "lamp-robust.controller.toml"
HOP = GOLDEN / "lamp-hop.controller.toml"
FRAME = 104 + 4  # what a Cortex-M4F with an FPU stacks for an interrupt, and to align it
# these begin on a stack that is empty again, and never return
ANEW = {"board_die", "board_fault"}
HANDLERS = r"board_on_\w+|board_send_answers"  # all of one priority: none stands upon another


def call_graph(folder):
    """Return bytes of stack of each function, and what each calls, as gcc tells them.

    Files that include the same function have a copy each, of which gcc may keep one: copies count as one function.
    """
    sizes, calls = {}, {}
    for path in folder.glob("*.ci"):
        text = re.sub(r"\.lto_priv\.\d+", "", path.read_text())
        for name, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', text):
            told = re.search(r"(\d+) bytes \((\w+)\)", label)
            if told:
                assert told[2] == "static", f"{name}: its stack depends on what it is given"
                sizes[name] = max(int(told[1]), sizes.get(name, 0))
        for caller, called in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls.setdefault(caller, set()).add(called)
    return sizes, calls


def depth(sizes, calls, name, callers=()):
    """Return bytes of stack of a function with all that it calls."""
    assert name not in callers, f"{name} calls itself"
    assert name in sizes, f"{callers[-1:]} calls {name}, of which nothing is known"
    if name in ANEW and callers:
        return 0
    return sizes[name] + max(
        (depth(sizes, calls, called, (*callers, name)) for called in calls.get(name, ())), default=0
    )


def network(size, neuron):
    """Return a controller of neurons, each of which all outputs need at the end of the step."""
    neurons = " ".join(f"(h{i} {neuron.format(i=i, next=f'h{(i + 1) % size}')})" for i in range(size))
    sums = (" ".join(["(+"] * (size - 1) + ["h0"] + [f"(* {k}.{i}1 h{i}))" for i in range(1, size)]) for k in range(3))
    head = HOP.read_text().split('"""')
    return parse_controller('"""'.join([head[0], f"(let ({neurons}) (list {' '.join(sums)}))", head[2]]), "network")


CONTROLLERS = {
    "lamp": load_controller(LAMP),
    "forward": network(120, "(tanh (* 0.{i}1 px))"),
    "recurrent": network(120, "(tanh (+ (* 0.{i}1 px) (last {next})))"),
    "oscillators": network(200, "(osc-wave 0.{i}1 (delay px))"),
}


@pytest.mark.parametrize(
    ("board", "rig", "controller"),
    [
        ("stm32f405", "lamp-xc330", "lamp"),
        ("stm32f405", "lamp-sts3215", "lamp"),
        ("mps2-an386", "lamp-xc330", "lamp"),
        ("stm32f405", "lamp-xc330", "forward"),
        ("mps2-an386", "lamp-xc330", "recurrent"),
        ("stm32f405", "lamp-sts3215", "oscillators"),
    ],
)
def test_the_deepest_chain_of_calls_an_interrupt_and_a_fault_fit_the_stack(board, rig, controller, tmp_path):
    found = load_board(board)
    write_project(make_project(CONTROLLERS[controller], load_rig(rig), found), tmp_path)
    graph = tmp_path / "graph"
    graph.mkdir()
    paths = [f"-I{tmp_path / folder}" for folder in ("src", "runtime", "board")]
    command = [found.compiler, *ARITHMETIC, *found.flags, "-fcallgraph-info=su"]
    # as CMakeLists.txt says: all but the board's files as one
    for folder, whole in (("src", ["-flto"]), ("runtime", ["-flto"]), ("board", [])):
        sources = [str(path) for path in sorted(tmp_path.glob(f"{folder}/*.c"))]
        run_tool([*command, *whole, *paths, "-c", *sources], graph)
    links = [flag.replace("{board}", str(tmp_path / "board")) for flag in found.link_flags]
    links += re.findall(r"-Wl,--defsym=\w+=\d+", (tmp_path / "CMakeLists.txt").read_text())
    run_tool([*command, "-flto", *map(str, sorted(graph.glob("*.o"))), *links, "-o", "firmware.elf"], graph)
    sizes, calls = call_graph(graph)
    main, last_words = (depth(sizes, calls, name) for name in ("main", "board_last_words"))
    handlers = {name: depth(sizes, calls, name) for name in sizes if re.fullmatch(HANDLERS, name)}
    assert {"board_on_tick", "board_on_bus", "board_on_sensors", "board_on_console", "board_on_nmi"} <= set(handlers)
    symbols = subprocess.run(["arm-none-eabi-nm", graph / "firmware.elf"], capture_output=True, text=True, check=True)
    stack = int(re.search(r"^(\w+) \w stack_size$", symbols.stdout, re.M)[1], 16)
    needed = main + FRAME + max(handlers.values()) + FRAME
    assert needed <= stack, f"main {main}, handlers {handlers}, frames {2 * FRAME}"
    assert last_words + FRAME <= stack
