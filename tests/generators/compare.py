"""Compare generated C with m2cgen-like nested doubles, SymPy's C99 printer and CasADi, for the same controllers.

    python tests/generators/compare.py [CONTROLLER.toml ...]

prints the tables of docs/transpile.md. It needs sympy and casadi (`pip install sympy casadi`), gcc, arm-none-eabi-gcc
with newlib, and qemu-system-arm; what is missing is left out and said. Nothing else of servolve needs SymPy or CasADi.
"""

# ruff: noqa: T201  it prints tables
from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1])]

from algebra import NESTED, Nested, casadi_algebra, evaluate, sympy_algebra  # noqa: E402
from instruction_count import FOLDER  # noqa: E402
from toolchain import run_tool  # noqa: E402

from controller import Controller, load_controller  # noqa: E402
from controller.reference import ReferenceProgram  # noqa: E402
from firmware_gen import generate  # noqa: E402
from firmware_gen.bounds.control_flow import UnboundedError  # noqa: E402
from firmware_gen.bounds.machine_code import read_machine_code  # noqa: E402
from firmware_gen.bounds.targets import CORTEX_M4F_TARGET  # noqa: E402
from firmware_gen.bounds.worst_case import bound_function  # noqa: E402
from firmware_gen.transpiler.vectors import bits_of, draw_inputs  # noqa: E402

GOLDEN = HERE.parent / "golden"
STEPS = 1000
HEADERS = "#include <math.h>\n#include <stdbool.h>\n"  # SymPy's conditions may be false
LIBRARIES = ("-lm", "-lc", "-lgcc")
TICKS = 25e6 * 1024e-9  # of SysTick, an instruction


def write_servolve(controller: Controller, folder: Path) -> None:
    """This project's own."""
    made = generate(controller, "made")
    (folder / "made.h").write_text(made.header, encoding="utf-8")
    source = made.source
    nstate, ninput, noutput = controller.program.nstate, len(controller.inputs), len(controller.outputs)
    before = "".join(f"  state.s[{i}] = in[{ninput + i}];\n" for i in range(nstate))
    after = "".join(f"  out[{noutput + i}] = state.s[{i}];\n" for i in range(nstate))
    wrapper = f"  made_state state;\n{before}  made_step(&state, in, out);\n{after}"
    (folder / "code.c").write_text(source + function(wrapper), encoding="utf-8")


def write_nested(controller: Controller, folder: Path) -> None:
    """One nested expression of doubles for each output, nothing shared."""
    inputs, states = [[Nested(f"x[{i}]") for i in places] for places in places_of(controller)]
    values = evaluate(controller.program, controller.period_s, NESTED, inputs, states)
    ninput = len(inputs) + len(states)
    lines = [f"  double x[{ninput}];\n", *(f"  x[{i}] = (double)in[{i}];\n" for i in range(ninput))]
    lines += [f"  out[{i}] = (float){value.text};\n" for i, value in enumerate(values)]
    (folder / "code.c").write_text(HEADERS + function("".join(lines)), encoding="utf-8")


def write_sympy(controller: Controller, folder: Path, single: bool = False) -> None:
    """SymPy's C99 printer: an expression for each output in double as it comes, or shared and in float."""
    import sympy
    from sympy.codegen.ast import float32, real

    inputs, states = [[sympy.Symbol(f"u{i}", real=True) for i in places] for places in places_of(controller)]
    values = evaluate(controller.program, controller.period_s, sympy_algebra(), inputs, states)
    shared, values = sympy.cse(values) if single else ([], values)
    kind = "float" if single else "double"
    aliases = {real: float32} if single else {}
    lines = [f"  const {kind} {x} = ({kind})in[{i}];\n" for i, x in enumerate(inputs + states)]
    # ternaries, as a Piecewise inside an expression is printed: an assigned one would be an if
    text = [sympy.ccode(value, standard="C99", type_aliases=aliases) for value in [e for _, e in shared] + list(values)]
    lines += [f"  const {kind} {name} = {code};\n" for (name, _), code in zip(shared, text, strict=False)]
    lines += [f"  out[{i}] = (float)({code});\n" for i, code in enumerate(text[len(shared) :])]
    lines += [f"  (void){x};\n" for x in inputs + states]
    (folder / "code.c").write_text(HEADERS + function("".join(lines)), encoding="utf-8")


def write_casadi(controller: Controller, folder: Path, single: bool = False) -> None:
    """CasADi's code generation over SX, in double as it comes, or with casadi_real float."""
    import casadi

    inputs, states = [[casadi.SX.sym(f"x{i}") for i in places] for places in places_of(controller)]
    values = evaluate(controller.program, controller.period_s, casadi_algebra(), inputs, states)
    made = casadi.Function("made", [casadi.vertcat(*inputs, *states)], [casadi.vertcat(*values)])
    generator = casadi.CodeGenerator("code.c", {"casadi_real": "float"} if single else {})
    generator.add(made)
    text = generator.dump()
    kind = "float" if single else "double"
    nin, nout, work = len(inputs) + len(states), len(values), made.sz_w()
    wrapper = (
        f"  {kind} x[{nin}];\n  {kind} y[{nout}];\n  {kind} w[{work + 1}];\n"
        f"  const {kind}* arg[{made.sz_arg()}];\n  {kind}* res[{made.sz_res()}];\n"
        f"  for (int i = 0; i < {nin}; i++) {{\n    x[i] = in[i];\n  }}\n  arg[0] = x;\n  res[0] = y;\n"
        f"  made(arg, res, 0, w, 0);\n  for (int i = 0; i < {nout}; i++) {{\n    out[i] = (float)y[i];\n  }}\n"
    )
    (folder / "code.c").write_text(text + function(wrapper), encoding="utf-8")


def function(body: str) -> str:
    return f"\nvoid evaluate(const float* in, float* out);\n\nvoid evaluate(const float* in, float* out) {{\n{body}}}\n"


def places_of(controller: Controller) -> tuple[range, range]:
    """Return where inputs and states are in the array of all inputs."""
    ninput = len(controller.inputs)
    return range(ninput), range(ninput, ninput + controller.program.nstate)


WRITERS: dict[str, tuple[str, Callable[[Controller, Path], None]]] = {
    "servolve": ("", write_servolve),
    "nested doubles, as m2cgen's": ("", write_nested),
    "SymPy C99, double": ("sympy", write_sympy),
    "SymPy C99, float, `cse`": ("sympy", lambda c, f: write_sympy(c, f, True)),
    "CasADi, double": ("casadi", write_casadi),
    "CasADi, `casadi_real` float": ("casadi", lambda c, f: write_casadi(c, f, True)),
}


def make_table(controller: Controller) -> tuple[np.ndarray, np.ndarray]:
    """Return bits of inputs, half of them within their ranges and half hard, and of what the reference gives."""
    program = controller.program
    rng = np.random.default_rng(0)
    words = rng.integers(0, 2**32, (2 * STEPS, len(controller.inputs), 2), dtype=np.uint32)
    words[:STEPS, :, 1] = 0
    inputs = draw_inputs(words, controller.inputs)
    states = rng.uniform(0, 1, (2 * STEPS, program.nstate)).astype(np.float32)
    machine = ReferenceProgram(program, controller.period_s)
    expected = []
    with np.errstate(all="ignore"):
        for row, state in zip(inputs, states, strict=True):
            machine._state[:] = state
            expected.append([*machine.step(list(row)), *machine._state])
    return bits_of(np.hstack([inputs, states])), bits_of(np.array(expected, np.float32))


def write_table(table: np.ndarray, nout: int, folder: Path) -> None:
    rows = ",\n".join("{" + ", ".join(f"0x{word:08x}U" for word in row) + "}" for row in table.tolist())
    sizes = f"#define NIN {table.shape[1]}\n#define NOUT {nout}\n#define NSTEP {len(table)}\n"
    (folder / "table.h").write_text(f"{sizes}static const uint32_t table[NSTEP][NIN] = {{\n{rows}}};\n")


def outputs_of(text: str, nout: int) -> tuple[np.ndarray, np.ndarray]:
    """Return bits of outputs, and the instructions of each step."""
    words = np.array([int(word, 16) for word in text.split()], np.uint32).reshape(-1, nout + 1)
    return bits_of(np.ascontiguousarray(words[:, :nout]).view(np.float32)), words[:, nout] / TICKS


def measure(controller: Controller, write: Callable[[Controller, Path], None], folder: Path) -> list[str]:
    """Return a row of the table: sizes, instructions, differences."""
    table, expected = make_table(controller)
    nout = expected.shape[1]
    write(controller, folder)
    write_table(table, nout, folder)
    harness = str(HERE / "harness.c")
    run_tool(["gcc", "-std=c99", "-Os", "-I.", "code.c", harness, "-o", "here", "-lm"], folder)
    here, _ = outputs_of(run_tool([folder / "here"], folder), nout)
    arm = [
        "arm-none-eabi-gcc",
        "-I.",
        *CORTEX_M4F_TARGET.flags,
        "-std=c99",
        "-Os",
        "-ffunction-sections",
        "-fdata-sections",
    ]
    link = ["-nostdlib", "-Wl,--gc-sections"]
    run_tool([*arm, "code.c", *link, "-Wl,--entry=evaluate", *LIBRARIES, "-o", "code.elf"], folder)
    run_tool([*arm, "-c", "code.c"], folder)
    code = read_machine_code(folder / "code.elf", "arm-none-eabi-", "")
    own = run_tool(["arm-none-eabi-nm", "--defined-only", "code.o"], folder)
    names = {line.split()[-1] for line in own.splitlines()}
    text = sum(size for name, size in code.sizes.items() if name in names)
    try:
        bound = str(bound_function(code, CORTEX_M4F_TARGET, "evaluate").instructions)
    except UnboundedError:
        bound = "none"
    there, instructions = outputs_of(emulate(folder), nout)
    (folder / "code.c").write_text(function("  (void)in;\n  (void)out;\n"), encoding="utf-8")
    # what a function that only returns takes is taken off, and that is one instruction
    instructions = instructions - outputs_of(emulate(folder), nout)[1].min() + 1
    usual = slice(0, STEPS)
    return [
        str(text),
        str(code.text_bytes - text),
        f"{np.median(instructions[usual]):.0f}",
        f"{instructions.max():.0f}",
        bound,
        *(
            f"{100 * np.mean(np.any(here[part] != expected[part], axis=1)):.1f} %"
            for part in (usual, slice(STEPS, None))
        ),
        f"{100 * np.mean(np.any(here != there, axis=1)):.1f} %",
    ]


def emulate(folder: Path) -> str:
    """Return what the harness prints on an emulated Cortex-M4F."""
    arm = ["arm-none-eabi-gcc", "-I.", *CORTEX_M4F_TARGET.flags, "-Os", "-ffunction-sections", "-fdata-sections"]
    run_tool([*arm, "-std=c99", "-c", "code.c"], folder)
    own = [str(HERE / "harness.c"), str(FOLDER / "start.c"), "-T", str(FOLDER / "layout.ld")]
    link = ["-nostdlib", "-Wl,--gc-sections", *own[2:], *LIBRARIES]
    run_tool([*arm, "-std=gnu99", "-fno-builtin", *own[:2], "code.o", *link, "-o", "run.elf"], folder)
    machine = ["qemu-system-arm", "-M", "mps2-an386", "-icount", "shift=10,sleep=off", "-display", "none"]
    machine += ["-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native"]
    return run_tool([*machine, "-kernel", "run.elf"], folder)


HEAD = ["", "own code", "library", "usual", "most", "bound", "in range", "hard inputs", "M4F not as x86"]


def main(paths: list[str]) -> None:
    """Print a table for each controller."""
    for path in paths or [str(GOLDEN / f"{name}.controller.toml") for name in ("lamp-robust", "figure7", "lamp-hop")]:
        controller = load_controller(path)
        print(f"\n{controller.name}: {len(controller.program.instructions)} operations\n")
        print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
        for name, (needs, write) in WRITERS.items():
            if needs and importlib.util.find_spec(needs) is None:
                print(f"| {name} | not measured: pip install {needs} |")
                continue
            with tempfile.TemporaryDirectory(prefix="servolve-generators-") as folder:
                row = measure(controller, write, Path(folder))
            print("| " + " | ".join([name, *row]) + " |")


if __name__ == "__main__":
    main(sys.argv[1:])
