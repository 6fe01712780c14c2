"""The library and its Python mirror agree; a missing, stale or broken build says so."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from controller import library, terminals, verifier
from controller.errors import InputError
from controller.generate_runtime import fingerprint
from controller.lowering import lower
from controller.native import NativeProgram, pack_program
from controller.schedule import TransactionKind
from controller.text import parse

CONTROLLER = Path(library.__file__).parent
RUNTIME = CONTROLLER / "runtime"
FLAGS = ["-std=c99", "-O2", "-ffp-contract=off"]


def compile_and_run(tmp_path, source, *flags):
    file = tmp_path / "main.c"
    file.write_text(source)
    program = tmp_path / "main"
    command = ["cc", *FLAGS, "-I", str(RUNTIME), str(file), str(RUNTIME / "sv_float.c"), "-o", str(program), *flags]
    subprocess.run(command, check=True, capture_output=True)
    return subprocess.run([program], check=True, capture_output=True, text=True).stdout


def test_structures_are_laid_out_as_in_c(tmp_path):
    mirrors = {
        "sv_program": library.SvProgram,
        "sv_terminal": library.SvTerminal,
        "sv_output": library.SvOutput,
        "sv_guard": library.SvGuard,
        "sv_cycle": library.SvCycle,
        "sv_goal": library.SvGoal,
        "sv_cycle_state": library.SvCycleState,
        "sv_block": library.SvBlock,
        "sv_schedule": library.SvSchedule,
        "sv_transaction": library.SvTransaction,
    }
    lines = []
    expected = []
    for name, mirror in mirrors.items():
        lines.append(f'printf("{name} %zu\\n", sizeof({name}));')
        expected.append(f"{name} {ctypes.sizeof(mirror)}")
        for field, *_ in mirror._fields_:
            lines.append(f'printf("{name}.{field} %zu\\n", offsetof({name}, {field}));')
            expected.append(f"{name}.{field} {getattr(mirror, field).offset}")
    source = (
        '#include <stddef.h>\n#include <stdio.h>\n#include "sv_cycle.h"\n#include "sv_schedule.h"\nint main(void) {\n'
    )
    told = compile_and_run(tmp_path, source + "\n".join(lines) + "\nreturn 0;\n}\n")
    assert told.splitlines() == expected


def test_bounds_and_kinds_are_those_of_the_headers():
    text = "".join(
        (RUNTIME / name).read_text() for name in ("sv_sizes.h", "sv_program.h", "sv_cycle.h", "sv_schedule.h")
    )
    defined = {name: int(value) for name, value in re.findall(r"#define SV_(\w+_MAX) (\d+)", text)}
    assert defined == {
        "INPUT_MAX": verifier.INPUT_MAX,
        "OUTPUT_MAX": verifier.OUTPUT_MAX,
        "INSTRUCTION_MAX": verifier.INSTRUCTION_MAX,
        "CONSTANT_MAX": verifier.CONSTANT_MAX,
        "STATE_MAX": verifier.STATE_MAX,
        "COUNT_MAX": 2**30,
        "RAW_MAX": 128,
        "HEALTH_MAX": library.HEALTH_MAX,
    }
    assert library.OUTPUT_MAX == verifier.OUTPUT_MAX
    enums = dict(re.findall(r"SV_(\w+) = (\d+)", text))
    for kind in terminals.TerminalKind:
        assert int(enums[f"TERMINAL_{kind.name}"]) == kind
    # simulator and host leave no kind out
    kinds = {name: int(bits, 16) for name, bits in re.findall(r"#define SV_(\w+_KINDS) 0x(\w+)U", text)}
    assert kinds["TERMINAL_KINDS"] == sum(1 << kind for kind in terminals.TerminalKind)
    for transaction in TransactionKind:
        assert int(enums[transaction.name]) == transaction


def test_arithmetic_is_checked(tmp_path):
    source = (
        '#include <stdio.h>\n#include "sv_program.h"\nint main(void) { printf("%d", sv_check_float()); return 0; }\n'
    )
    assert compile_and_run(tmp_path, source) == "0"
    # the sources compiled as they should be, but linked with -ffast-math: its start-up code flushes subnormals
    file = tmp_path / "flush.o"
    subprocess.run(["gcc", *FLAGS, "-c", "-I", RUNTIME, RUNTIME / "sv_float.c", "-o", file], check=True)
    (tmp_path / "flush.c").write_text(source)
    program = tmp_path / "flush"
    subprocess.run(["gcc", "-I", RUNTIME, tmp_path / "flush.c", file, "-ffast-math", "-o", program], check=True)
    assert subprocess.run([program], capture_output=True, text=True, check=True).stdout == "-8"


@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
@pytest.mark.parametrize("file", ["sv_program.c", "sv_cycle.c", "sv_float.c"])
def test_fast_math_does_not_compile(tmp_path, flag, file):
    command = ["cc", "-std=c99", flag, "-c", str(RUNTIME / file), "-o", str(tmp_path / "x.o")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "servolve needs IEEE-754 arithmetic" in done.stderr


def run_copy(folder, statement):
    """Run Python in a folder that holds a copy of the controller package, without the installed one (-S)."""
    paths = os.pathsep.join((str(folder), str(Path(np.__file__).parent.parent)))
    command = [sys.executable, "-S", "-c", statement]
    environment = {**os.environ, "PYTHONPATH": paths}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return done.stderr.strip().splitlines()[-1] if done.returncode else done.stdout


USE = "from controller.library import library; library(); import controller; print(controller.__file__)"


@pytest.fixture
def copy(tmp_path):
    shutil.copytree(CONTROLLER, tmp_path / "controller", ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    return tmp_path


def test_a_missing_library_is_one_sentence(copy):
    told = run_copy(copy, USE)
    assert told.startswith("controller.errors.InputError: ") and "is not built; run `make setup`" in told
    # what does not need it works without
    assert run_copy(copy, "from controller import parse; print(parse('(list 1)', ()))").startswith("Source")


def test_a_broken_library_is_one_sentence(copy):
    (copy / "controller" / "libcontroller.so").write_bytes(b"not a library")
    assert "does not load" in run_copy(copy, USE)


def test_a_library_of_another_table_is_refused(copy):
    shutil.copy(library.PATH, copy / "controller")
    assert run_copy(copy, USE).strip() == str(copy / "controller" / "__init__.py")
    table = copy / "controller" / "operations.py"
    table.write_text(table.read_text().replace("{a} - {b}", "{b} - {a}"))
    assert "was built from another table of operations; run `make setup`" in run_copy(copy, USE)


SANITIZED = """
import numpy as np
from controller.controller import Controller, Input, Output
from controller.lowering import lower
from controller.native import NativeProgram, encode, pack_cycle
from controller.operations import OPERATIONS
from controller.rig_file import load_rig
from controller.terminals import TerminalKind, TerminalSpec, terminals_of
from controller.text import parse

edges = np.array(
    [0, -0.0, 1e-45, -1e-45, 1, 3.4e38, -3.4e38, np.inf, -np.inf, np.nan, 2**31, -(2**31), 2**23, 1e10], np.float32
)
rng = np.random.default_rng(5)
for operation in OPERATIONS:
    if not operation.internal:
        names = tuple("abc"[: operation.arity])
        program = lower(parse(f"(list ({operation.name} {' '.join(names)}))", names), names)
        NativeProgram(program).run(0.02, rng.choice(edges, (3000, len(names))))
for value in edges:
    encode(TerminalSpec("x", TerminalKind.RAW, "1", 0, -(2**30), 1e-30), float(value))
rig = load_rig("lamp-xc330")
supplied = terminals_of(rig)
source = parse("(list (* 3e38 px) (% a0 t) heading_error)", list(supplied))
controller = Controller(
    "x", 0.02, tuple(Input(name, spec.unit, -1, 1) for name, spec in supplied.items()),
    tuple(Output(joint.name, "position", "rad", -3e38, 3e38, 0.0) for joint in rig.joints),
    source, lower(source, list(supplied)), 0.5, 1e6,
)
cycle = pack_cycle(controller, rig)
for _ in range(300):
    cycle.step(3e38, 1e30, rng.choice(np.array([0, 1, -(2**31), 2**31 - 1], np.int32), rig.nraw))
print("clean")
"""


def test_no_input_reaches_undefined_behaviour(copy):
    shutil.copytree(CONTROLLER.parent / "sim_models" / "lamp", copy / "sim_models" / "lamp")
    sanitize = ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all", "-fPIC", "-shared"]
    command = ["gcc", *FLAGS, *sanitize, *map(str, RUNTIME.glob("*.c")), "-o", "controller/libcontroller.so"]
    subprocess.run(command, check=True, cwd=copy)
    assert run_copy(copy, SANITIZED) == "clean\n"


def test_the_library_is_of_this_table():
    assert library.library().sv_operations_fingerprint() == fingerprint()


def test_inputs_of_another_shape_are_refused():
    machine = NativeProgram(lower(parse("(list (+ a b))", ("a", "b")), ("a", "b")))
    for shape in [(3,), (3, 1), (2, 3), (1, 2, 2)]:
        with pytest.raises(InputError, match=r"give \(steps, 2\): a b"):
            machine.run(0.02, np.zeros(shape, np.float32))
    assert machine.run(0.02, np.zeros((0, 2), np.float32)).shape == (0, 1)
    # any layout and number type that holds float32 values
    rows = np.asfortranarray(np.array([[1, 2], [3, 4]], np.float64))
    assert machine.run(0.02, rows).tolist() == [[3], [7]]


def test_a_packed_program_keeps_its_arrays():
    programs = [pack_program(lower(parse(f"(list (+ a {i}))", ("a",)), ("a",))) for i in range(200)]
    np.zeros(100_000)  # whatever was freed may be overwritten
    constants = [ctypes.cast(p.constants, ctypes.POINTER(ctypes.c_float))[0] for p in programs]
    assert constants == list(range(200))
