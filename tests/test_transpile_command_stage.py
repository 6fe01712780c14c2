"""Generated C from outputs to commands, against the control cycle that every rig and rollout runs."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from controller import Controller, Input, Output, load_rig, lower, parse
from controller.cycle import resolve_cycle
from controller.native import NativeCycle
from controller.reference import ReferenceCommand, ReferenceCycle, ReferenceProgram
from firmware_gen import compile_controllers, generate, transpile
from firmware_gen.transpiler.compiled import run_compiler
from firmware_gen.transpiler.vectors import bits_of, draw_inputs, selftest_vectors

PROGRAMS = (
    "(list (* 80 (sin (* 7 t))) (% a1 a0_vel) (+ (* 30 (osc-tri 1.3 a2)) s0))",
    "(list (* 900 (- a0 a1)) (integrate (* 100 a2)) (ifltz a0 -1e9 1e9))",
    "(let ((n (tanh (- a0 (* 1.5 (last n)))))) (list (* 70 n) (% 0 (- a1 a1)) (* 40 (differentiate a2))))",
)
STAGES = ((0.6, 12.0), (1.0, 3.0), (0.05, 0.0), (1.0, 0.0), (0.3, 0.7))
TERMINALS = {"t": "s", "a0": "rad", "a1": "rad", "a2": "rad", "a0_vel": "rad/s", "s0": "N"}


def make(text, stage=(0.6, 12.0), unit="deg", neutral=1.5):
    source = parse(text, list(TERMINALS))
    high = 60.7 if unit == "deg" else 1.06
    return Controller(
        name="made",
        period_s=0.02,
        inputs=tuple(Input(name, unit, -2.0, 2.0) for name, unit in TERMINALS.items()),
        outputs=tuple(Output(f"a{i}", "position", unit, -high, high, min(neutral, high)) for i in range(3)),
        source=source,
        program=lower(source, list(TERMINALS)),
        filter=stage[0],
        slew_rad_s=stage[1],
    )


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_commands_are_those_of_the_cycle(unit):
    rig = load_rig("lamp-xc330")
    rng = np.random.default_rng(5)
    made = [make(text, stage, unit) for text in PROGRAMS for stage in STAGES]
    moved = 0
    with compile_controllers(made, flags=("-O3",)) as built:
        for controller, compiled in zip(made, built, strict=True):
            assert compiled.selftest() == 0
            spec = resolve_cycle(controller, rig)
            # counts as fine as floats, so that no difference rounds away
            fine = [replace(o, count_scale=2.0**24, count_low=-(2**30), count_high=2**30) for o in spec.outputs]
            spec = replace(spec, outputs=tuple(fine))
            for cycle in (NativeCycle(spec), slow_cycle(controller, rig, spec)):
                raw = rng.integers(-3000, 3000, (60, rig.nraw), dtype=np.int32)
                rows = [cycle.step(0.3, 0.0, row) for row in raw]
                outputs = compiled.run(np.array([row[0] for row in rows]))
                commands = compiled.command(outputs)
                counts = np.array([o.zero for o in fine]) + np.rint(commands * np.float32(2.0**24)).astype(np.int64)
                assert np.array_equal(counts, np.array([row[2] for row in rows]))
                moved += len(np.unique(counts))
    assert moved > 2000


def slow_cycle(controller, rig, spec):
    cycle = ReferenceCycle(controller, rig)
    cycle.spec = spec
    return cycle


@pytest.mark.parametrize("stage", STAGES)
def test_hard_outputs_give_the_reference_bits(stage):
    controller = make(PROGRAMS[0], stage)
    words = np.random.default_rng(2).integers(0, 2**32, (400, 3, 2), dtype=np.uint32)
    values = draw_inputs(words, [Input("a", "deg", -70.0, 70.0)] * 3)
    reference = ReferenceCommand(controller)
    expected = np.array([reference.step(list(row)) for row in values], np.float32)
    with compile_controllers([controller]) as (compiled,):
        assert np.array_equal(bits_of(compiled.command(values)), bits_of(expected))
    assert np.isfinite(expected).all()


@pytest.mark.parametrize("change", [{"filter": 0.61}, {"slew_rad_s": 12.1}, {"period_s": 0.021}])
def test_the_fingerprint_covers_the_output_stage(change):
    controller = make(PROGRAMS[0])
    assert generate(controller).unit.fingerprint != generate(replace(controller, **change)).unit.fingerprint


def test_without_filter_and_slew_nothing_is_held():
    generated = generate(make(PROGRAMS[0], (1.0, 0.0)))
    assert "held" not in generated.source + generated.header.partition("typedef struct")[2]
    assert generated.unit.state_bytes == 4 * generated.unit.controller.program.nstate
    assert "counts = zero + round(command * counts per rad)" in generated.header


MAIN = '#include <stdio.h>\n#include "made.h"\nint main(void) { printf("%d", (int)made_selftest()); return 0; }\n'


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.600000024F * step", "0.600000083F * step"),
        ("step > 0.239999995F", "step > 0.2F"),
        ("step < (-0.239999995F)", "step > (-0.239999995F)"),
        ("command[made_output_a0] = outputs[made_output_a0]", "command[made_output_a0] = outputs[made_output_a1]"),
        ("held - 0.239999995F", "held + 0.239999995F"),
        ("target = held + step", "target = step"),
        ("command[made_output_a1] * 0.0174532924F", "command[made_output_a1] * 0.0174533F"),
        ("state->held[made_output_a1] = 0.0261799395F", "state->held[made_output_a1] = 0.0F"),
        ("command[made_output_a2] = state->held[made_output_a2]", "command[made_output_a2] = command[made_output_a2]"),
    ],
)
def test_the_selftest_notices_a_changed_output_stage(old, new, tmp_path):
    source = transpile(make(PROGRAMS[0]), tmp_path, "made").source
    text = source.read_text()
    assert old in text
    (tmp_path / "main.c").write_text(MAIN)
    for changed, status in ((text, b"0"), (text.replace(old, new), b"-6")):
        source.write_text(changed)
        run_compiler(["gcc", "-std=c99", "main.c", "made.c", "-o", "main"], tmp_path)
        assert subprocess.run(["./main"], cwd=tmp_path, capture_output=True, check=True).stdout == status


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.25F * y", "0.25000003F * y"),
        ("command[i % made_noutput]", "command[0]"),
        ("made_command(&state, outputs, command);\n    made_feed_back", "made_feed_back"),
    ],
)
def test_the_selftest_notices_a_loop_that_closes_otherwise(old, new, tmp_path):
    source = transpile(make(PROGRAMS[0]), tmp_path, "made").source
    text = source.read_text()
    assert old in text
    (tmp_path / "main.c").write_text(MAIN)
    source.write_text(text.replace(old, new))
    run_compiler(["gcc", "-std=c99", "main.c", "made.c", "-o", "main"], tmp_path)
    assert subprocess.run(["./main"], cwd=tmp_path, capture_output=True, check=True).stdout == b"-7"


def test_the_recorded_loop_is_what_its_rule_says():
    controller = make(PROGRAMS[2])
    recorded = selftest_vectors(controller)
    program, stage = ReferenceProgram(controller.program, controller.period_s), ReferenceCommand(controller)
    inputs = recorded.inputs[0].view(np.float32)
    low, high = (np.array([getattr(i, field) for i in controller.inputs], np.float32) for field in ("low", "high"))
    assert np.all((low <= inputs) & (inputs <= high))
    for expected in recorded.loop:
        outputs = program.step(list(inputs))
        assert np.array_equal(bits_of(np.array(outputs)), expected)
        commands = np.resize(np.array(stage.step(outputs)), len(inputs))
        inputs = np.clip(inputs + np.float32(0.25) * (commands - inputs), low, high)
    assert len(np.unique(recorded.loop)) > len(recorded.loop)
