"""Static bounds of machine code, against what emulated Cortex-M4F and Cortex-M0 execute."""

import re
import subprocess
from dataclasses import replace

import pytest
from conftest import random_controller
from instruction_count import count_instructions, frame_sizes

from controller import load_controller
from firmware_gen import transpile
from firmware_gen.bounds.control_flow import UnboundedError
from firmware_gen.bounds.machine_code import Instruction, read_machine_code
from firmware_gen.bounds.stack_depth import stack_depth, stack_growth
from firmware_gen.bounds.targets import CORTEX_M0_TARGET, CORTEX_M4F_TARGET, FUNCTIONS, TARGETS, link_controller
from firmware_gen.bounds.worst_case import bound_function

GOLDEN = ("lamp-robust", "figure7", "lamp-hop")


@pytest.fixture
def golden(request):
    return load_controller(request.config.rootpath / "tests" / "golden" / f"{request.param}.controller.toml")


def assert_within_bounds(controller, target, level, folder):
    """Return how much of its bound on instructions each function took."""
    transpiled = transpile(controller, folder, "counted_one")
    code, tested = link_controller(transpiled, target, level)
    counted = count_instructions(transpiled, target, level, folder)
    parts = {}
    for function in FUNCTIONS:
        bound = bound_function(code, target, f"counted_one_{function}")
        assert 0 < counted[function].instructions <= bound.instructions, function
        assert counted[function].stack_bytes <= bound.stack_bytes, function
        assert all(cycles >= bound.instructions for cycles in bound.cycles), function
        parts[function] = counted[function].instructions / bound.instructions
    deepest = stack_depth(tested, tested.entries["counted_one_selftest"])
    assert 0 < counted["selftest"].stack_bytes <= deepest < counted["selftest"].stack_bytes + 64
    return parts


@pytest.mark.parametrize("level", ["-Os", "-O2"])
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@pytest.mark.parametrize("golden", GOLDEN, indirect=True)
def test_no_input_takes_more_than_the_bound(golden, target, level, tmp_path):
    parts = assert_within_bounds(golden, target, level, tmp_path)
    # a bound far off would hold, too: with an FPU nearly all of it is met, software floats have rare branches
    assert min(parts.values()) > (0.8 if target is CORTEX_M4F_TARGET else 0.4), parts


@pytest.mark.parametrize("seed", range(4))
def test_no_input_takes_more_than_the_bound_of_a_random_program(seed, tmp_path):
    controller = replace(random_controller(seed, 3.0), filter=0.5, slew_rad_s=9.0)
    for target in TARGETS:
        assert_within_bounds(controller, target, "-O2", tmp_path)


@pytest.mark.parametrize("golden", GOLDEN, indirect=True)
def test_the_stack_of_a_leaf_is_what_the_compiler_says(golden, tmp_path):
    transpiled = transpile(golden, tmp_path, "counted_one")
    code, _ = link_controller(transpiled, CORTEX_M4F_TARGET, "-Os")
    frames = frame_sizes(transpiled, "-Os", tmp_path)
    for function in ("init", "clamp"):
        name = f"counted_one_{function}"
        assert bound_function(code, CORTEX_M4F_TARGET, name).stack_bytes == frames[name]
    step = bound_function(code, CORTEX_M4F_TARGET, "counted_one_step").stack_bytes
    assert frames["counted_one_step"] <= step <= sum(frames.values())


# --- by hand ---------------------------------------------------------------------------------------------------------


def assembled(text, folder, cpu="cortex-m4"):
    """Return machine code of functions written in assembly."""
    (folder / "code.s").write_text(f".syntax unified\n.cpu {cpu}\n.fpu softvfp\n.thumb\n.align 4\n{text}")
    subprocess.run(["arm-none-eabi-as", "code.s", "-o", "code.o"], cwd=folder, check=True)
    subprocess.run(["arm-none-eabi-ld", "-Ttext=0x8000", "-e", "f", "code.o", "-o", "code.elf"], cwd=folder, check=True)
    return read_machine_code(folder / "code.elf", "arm-none-eabi-", "as")


def function(name, body):
    return f".global {name}\n.thumb_func\n.type {name}, %function\n{name}:\n{body}\n.size {name}, .-{name}\n"


DIAMOND = """
  push {r4, lr}
  cmp r0, #0
  beq 1f
  ldr r1, [r2]
  mul r1, r1, r1
  b 2f
1: udiv r1, r1, r2
2: bl g
  pop {r4, pc}
"""


def test_the_longest_path_by_hand(tmp_path):
    code = assembled(function("f", DIAMOND) + function("g", "  sub sp, #8\n  add sp, #8\n  bx lr"), tmp_path)
    bound = bound_function(code, CORTEX_M4F_TARGET, "f")
    # push, cmp, beq, ldr, mul, b, bl, (sub, add, bx), pop
    assert bound.instructions == 11
    # push 1 + 2, cmp 1, beq not taken 1, ldr 2, mul 1, b 1 + 3 = 12; beq taken 1 + 3, udiv 12 = 20 is longer;
    # bl 1 + 3, sub 1, add 1, bx 1 + 3, pop 1 + 2 + 3
    assert bound.cycles[0] == 20 + 4 + 1 + 1 + 4 + 6
    # five taken branches (beq, bl, bx, pop, and the call of f: two) wait for lines of the flash, too
    assert bound.cycles[1] >= bound.cycles[0] + 5 * (4 * 3 + 2)
    assert bound.stack_bytes == 8 + 8


def test_a_large_frame_of_a_small_core(tmp_path):
    body = "  push {r4, lr}\n  ldr r4, 1f\n  add sp, r4\n  nop\n  movs r3, #150\n  lsls r3, r3, #2\n  add sp, r3\n"
    code = assembled(function("f", body + "  pop {r4, pc}\n.align 2\n1: .word -600"), tmp_path, "cortex-m0")
    assert bound_function(code, CORTEX_M0_TARGET, "f").stack_bytes == 608


def test_a_call_on_a_condition_counts(tmp_path):
    body = "  push {r4, lr}\n  cmp r0, #0\n  it ne\n  blne g\n  pop {r4, pc}"
    code = assembled(function("f", body) + function("g", "  nop\n  nop\n  bx lr"), tmp_path)
    assert bound_function(code, CORTEX_M4F_TARGET, "f").instructions == 5 + 3


def test_constants_behind_a_register_wait_for_the_flash(tmp_path):
    plain, table = (
        "  ldmia r0, {r1, r2, r3}\n  bx lr",
        "  adr r0, 1f\n  ldmia r0, {r1, r2, r3}\n  bx lr\n.align 2\n1: nop",
    )
    bounds = [
        bound_function(assembled(function("f", body), tmp_path), CORTEX_M4F_TARGET, "f") for body in (plain, table)
    ]
    hits, misses = (after - before for before, after in zip(bounds[0].cycles, bounds[1].cycles, strict=True))
    assert hits == 1 and misses == 1 + 3 * 5


COUNTED = """
  cmp r1, #0
  beq 1f
  movs r0, #5
  b 2f
1: movs r0, #7
2: adds r2, #1
  cmp r2, r1
  bhi 3f
  adds r2, #2
3: subs r0, #1
  cmp r0, #0
  bne 2b
  bx lr
"""


def test_a_loop_that_counts_down_from_constants_has_a_bound(tmp_path):
    bound = bound_function(assembled(function("f", COUNTED), tmp_path), CORTEX_M4F_TARGET, "f")
    # cmp, beq, movs; 7 rounds of adds, cmp, bhi, adds, subs, cmp, bne; with movs and b 5 rounds at most, but 7 counts
    assert bound.instructions == 4 + 7 * 7 + 1
    short = assembled(function("f", COUNTED.replace("#7", "#2")), tmp_path)
    assert bound_function(short, CORTEX_M4F_TARGET, "f").instructions == 4 + 5 * 7 + 1


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("1: ldr r1, [r0], #4\n  cmp r1, #0\n  bne 1b\n  bx lr", "loop"),
        ("1: subs r0, #1\n  bne 1b\n  bx lr", "loop"),  # from an argument, not from a constant
        ("  movs r0, #3\n1: subs r0, #1\n  cmp r1, r2\n  bne 1b\n  bx lr", "loop"),
        ("  movs r0, #3\n1: adds r0, #1\n  subs r0, #1\n  bne 1b\n  bx lr", "loop"),
        ("  movs r0, #0\n1: subs r0, #1\n  bne 1b\n  bx lr", "loop"),
        ("  movs r0, #3\n1: umull r1, r0, r2, r3\n  subs r0, #1\n  bne 1b\n  bx lr", "loop"),
        ("  movs r0, #3\n1: bl g\n  subs r0, #1\n  bne 1b\n  bx lr", "loop"),
        ("  movs r0, #3\n1: cbz r1, 2f\n  subs r0, #1\n  bne 1b\n2: bx lr", "loop"),
        ("  push {r4, lr}\n  bl f\n  pop {r4, pc}", "calls itself"),
        ("  push {r4, lr}\n  blx r0\n  pop {r4, pc}", "through a register"),
        ("  bx r0", "through a register"),
        ("  tbb [pc, r0]\n  nop", "through a register"),
        ("  ldr pc, [r0]", "through a register"),
        ("  push {r4}\n  nop", "leaves the code|depends on the way"),
        ("  cbz r0, 1f\n  push {r4}\n1: nop\n  bx lr", "depends on the way"),
        ("  sub sp, sp, r0\n  bx lr", "by a register"),
    ],
)
def test_what_has_no_bound_is_refused(body, reason, tmp_path):
    code = assembled(function("g", "  bx lr") + function("f", body), tmp_path)
    with pytest.raises(UnboundedError, match=reason):
        bound_function(code, CORTEX_M4F_TARGET, "f")


def test_an_unknown_instruction_is_refused(tmp_path):
    code = assembled(function("f", "  wfi\n  bx lr"), tmp_path)
    with pytest.raises(Exception, match="no cycle count is known for 'wfi'"):
        bound_function(code, CORTEX_M4F_TARGET, "f")


@pytest.mark.parametrize(
    ("mnemonic", "operands", "growth"),
    [
        ("push", "{r4, r5, lr}", 12),
        ("push", "{r4-r7, lr}", 20),
        ("vpush", "{d8-d9}", 16),
        ("vpop", "{s16}", -4),
        ("stmdb", "sp!, {r4, r5}", 8),
        ("ldmia.w", "sp!, {r4-r8, pc}", -24),
        ("str.w", "lr, [sp, #-8]!", 8),
        ("ldr.w", "pc, [sp], #8", -8),
        ("sub", "sp, #24", 24),
        ("add.w", "sp, sp, #512", -512),
        ("ldr", "r0, [sp, #4]", 0),
        ("add", "r0, sp, #4", 0),
    ],
)
def test_what_moves_the_stack(mnemonic, operands, growth):
    assert stack_growth(Instruction(0, 2, mnemonic, operands)) == growth


def test_software_division_has_its_27_rounds(tmp_path):
    """The loop of libgcc's division makes a bit of the quotient each round: 24, and three to round."""
    golden = load_controller("tests/golden/figure7.controller.toml")
    code, _ = link_controller(transpile(golden, tmp_path, "lamp"), CORTEX_M0_TARGET, "-Os")
    division = bound_function(code, CORTEX_M0_TARGET, "__aeabi_fdiv")
    disassembly = [code.instructions[a] for a in sorted(code.instructions) if a >= code.entries["__aeabi_fdiv"]]
    loop = next(i for i, line in enumerate(disassembly) if re.match(r"r0, #27", line.operands))
    assert disassembly[loop].mnemonic.startswith("movs")
    # nine instructions a round, where the divisor is taken off
    assert 27 * 9 < division.instructions < 27 * 9 + 250
