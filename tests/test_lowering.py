"""Lowering folds and shares, and changes no bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.canonical import program_hash
from controller.errors import InputError
from controller.lowering import NODE_MAX, lower, lower_outputs
from controller.native import NativeProgram, pack_program
from controller.operations import BY_NAME, BY_OPCODE
from controller.program import INSTRUCTION, Program
from controller.reference import run_program
from controller.source import Apply, Constant, Last, Name, Source
from controller.text import parse
from controller.verifier import verify

TERMINALS = ("t", "a0", "s0")


def lowered(text, terminals=TERMINALS):
    program = lower(parse(text, terminals), terminals)
    verify(program)
    return program


def names(program):
    return [BY_OPCODE[row["op"]].name for row in program.instructions]


def test_equal_values_are_shared():
    assert names(lowered("(list (+ (sin t) (sin t)) (* (sin t) a0))")) == ["sin", "+", "*"]
    # + and * commute, bit for bit
    assert names(lowered("(list (+ t a0) (+ a0 t) (* t a0) (* a0 t))")) == ["+", "*"]
    assert names(lowered("(list (- t a0) (- a0 t) (min t a0) (min a0 t))")) == ["-", "-", "min", "min"]
    assert lowered("(list 2 2.0 2)").constants.tolist() == [2]
    assert np.signbit(lowered("(list 0 -0)").constants).tolist() == [False, True]


def test_stateful_operations_are_never_merged():
    program = lowered("(list (+ (integrate t) (integrate t)) (delay t) (delay t))")
    assert names(program) == ["integrate", "integrate", "+", "delay", "delay"]
    assert program.nstate == 4
    # a definition is one node, however often it is named
    assert names(lowered("(let ((n (integrate t))) (list n (sin n)))")) == ["integrate", "sin"]


@pytest.mark.parametrize(
    ("text", "constants", "left"),
    [
        ("(list (* (+ 1 2) t))", [3], ["*"]),
        ("(list (sin (% 1 (- 2 2))))", [np.sin(np.float32(1))], []),
        ("(list (ifltz -1 t (sin a0)))", [], []),
        ("(list (ifltz -0 (delay t) (sin a0)))", [], ["sin"]),
        ("(list (if 1 (sin t) (delay a0)))", [], ["sin"]),
        ("(list (% (sin t) 0))", [1], []),
        ("(list (% t -0))", [1], []),
    ],
)
def test_constants_are_folded(text, constants, left):
    program = lowered(text)
    assert names(program) == left
    assert program.constants.tolist() == pytest.approx(constants)


@pytest.mark.parametrize(
    ("text", "left"),
    [
        ("(list (- t t))", ["-"]),  # NaN for an infinity
        ("(list (* 0 t))", ["*"]),
        ("(list (% t t))", ["%"]),
        ("(list (+ t -0))", ["+"]),
        ("(list (+ t 0))", ["+"]),  # -0 + 0 is 0
        ("(list (* t 1))", ["*"]),
        ("(list (exp 3e38) (* 3e38 10))", ["*"]),  # infinite: left for run time
        ("(list (- (* 3e38 10) (* 3e38 10)))", ["*", "-"]),
        ("(list (smooth 1 1))", ["smooth"]),
    ],
)
def test_what_an_input_could_tell_stays(text, left):
    assert names(lowered(text)) == left


def test_what_no_output_needs_is_left_out():
    program = lowered("(let ((dead (+ (last dead) (sin 3))) (n (last k)) (k (+ n (last m))) (m 7)) (list n 5))")
    # n needs last k, k needs last m; dead needs only itself
    assert names(program) == ["load", "load", "+", "store", "store"]
    assert program.nstate == 2
    assert sorted(program.constants.tolist()) == [5, 7]


@pytest.mark.parametrize(
    ("text", "left", "constants"),
    [
        ("(list (ifltz 1 (+ t a0) (- t 7)))", ["-"], [7]),
        ("(list (ifltz -1 t (* (+ t 3) 2)))", [], []),
        ("(list (if 1 2 t) (+ t 4))", ["+"], [2, 4]),
        ("(list (% (* t 3) 0) (+ t 4))", ["+"], [1, 4]),
        ("(list (ifltz 1 (+ t 3) a0) (+ t 3))", ["+"], [3]),
        ("(list (ifltz 1 (integrate t) (delay a0)))", ["delay"], []),
    ],
)
def test_what_a_constant_decides_against_is_left_out(text, left, constants):
    program = lowered(text)
    assert names(program) == left
    assert sorted(program.constants.tolist()) == sorted(constants)


@given(st.data())
def test_nothing_stays_without_use(programs, data):
    source = Source(data.draw(programs.sources().filter(lambda source: not source.definitions)).outputs)
    program = lower(source, programs.terminals)
    first = len(program.inputs)
    used = set(program.outputs.tolist())
    for row in program.instructions.tolist():
        used.update(row[1 : 1 + BY_OPCODE[row[0]].arity])
    assert used >= set(range(first, program.nregister))


def unfolded(source):
    """Replace each constant by a terminal of its own, so that nothing can be folded."""
    values = []

    def visit(expression):
        if isinstance(expression, Constant):
            values.append(expression.value)
            return Name(f"c{len(values) - 1}")
        if isinstance(expression, Apply):
            return Apply(expression.operation, tuple(visit(operand) for operand in expression.operands))
        return expression

    definitions = tuple((name, visit(expression)) for name, expression in source.definitions)
    outputs = tuple(visit(expression) for expression in source.outputs)
    return Source(outputs, definitions), np.array(values, np.float32)


@given(st.data())
def test_folding_changes_no_bit(programs, data):
    source = data.draw(programs.sources())
    rows = data.draw(programs.rows(len(programs.terminals)))
    plain, values = unfolded(source)
    constants = tuple(f"c{i}" for i in range(len(values)))
    if len(constants) + len(programs.terminals) > 64:
        return
    wide = lower(plain, (*programs.terminals, *constants))
    program = lower(source, programs.terminals)
    verify(program)
    assert len(program.instructions) <= len(wide.instructions)
    extended = np.hstack([rows, np.tile(values, (len(rows), 1))]).astype(np.float32)
    assert programs.same(run_program(program, 0.02, rows), run_program(wide, 0.02, extended))


def evaluate(expression, row):
    """Evaluate a stateless tree by plain recursion, without any lowering."""
    if isinstance(expression, Constant):
        return expression.value
    if isinstance(expression, Name):
        return row[expression.name]
    return BY_NAME[expression.operation].reference(*(evaluate(operand, row) for operand in expression.operands))


@given(st.data())
def test_sharing_changes_no_bit(programs, data):
    source = data.draw(programs.sources().filter(is_stateless))
    rows = data.draw(programs.rows(len(programs.terminals), 3))
    with np.errstate(all="ignore"):
        expected = [
            [evaluate(output, dict(zip(programs.terminals, row, strict=True))) for output in source.outputs]
            for row in rows
        ]
    assert programs.same(run_program(lower(source, programs.terminals), 0.02, rows), expected)


def is_stateless(source):
    def visit(expression):
        if isinstance(expression, Apply):
            return BY_NAME[expression.operation].nstate == 0 and all(map(visit, expression.operands))
        return not isinstance(expression, Last)

    return not source.definitions and all(map(visit, source.outputs))


def test_the_hash_sees_meaning_only():
    hashes = {
        program_hash(lowered(text))
        for text in (
            "(let ((n (+ (last n) t)) (m (sin n))) (list m))",
            "(let ((phase (+ (last phase) t))\n  (wave (sin phase))) ; names\n (list wave))",
            "(let ((n (+ t (last n))) (dead (cos t)) (m (sin n))) (list m))",
            "(let ((n (+ (last n) t)) (m (sin n))) (list (ifltz (- 1 2) m (tanh t))))",
        )
    }
    assert len(hashes) == 1
    text = "(list (+ t 1) (sin a0))"
    different = {
        program_hash(lowered(text)),
        program_hash(lowered(text, ("a0", "t", "s0"))),
        program_hash(lowered(text, ("t", "a0", "s1"))),
        program_hash(lowered(text, ("t", "a0"))),
        program_hash(lowered("(list (+ t 1.0000001) (sin a0))")),
        program_hash(lowered("(list (sin a0) (+ t 1))")),
        program_hash(lowered("(list (- t 1) (sin a0))")),
        program_hash(lowered("(list (+ t 0) (sin a0))")),
        program_hash(lowered("(list (+ t -0) (sin a0))")),
    }
    assert len(different) == 9


def test_a_hash_is_for_ever():
    # histories and caches hold hashes: a change of the canonical form must be meant
    text = "(let ((n (+ (last n) 1.5))) (list (% t n) (osc-saw a0 s0)))"
    assert program_hash(lowered(text)) == "686b518da0746169afa69da73f2598aae87d21c87dcd1babdca179c1d352baa8"


def test_deep_trees_need_no_recursion():
    expression = Name("t")
    for _ in range(8000):
        expression = Apply("sin", (expression,))
    program = lower_outputs([expression], TERMINALS)
    assert len(program.instructions) == 8000
    assert np.isfinite(NativeProgram(program).run(0.02, np.ones((1, 3), np.float32))).all()


def chain(length):
    expression = Name("t")
    for _ in range(length):
        expression = Apply("sin", (expression,))
    return expression


@pytest.mark.parametrize(
    ("outputs", "terminals", "what"),
    [
        ([chain(8193)], TERMINALS, "8192 operations"),
        ([Apply("delay", (Name("t"),))] * 4097, TERMINALS, "4096 state values"),
        ([Name("t")] * 33, TERMINALS, "33 outputs"),
        ([], TERMINALS, "0 outputs"),
        ([Name("t0")], tuple(f"t{i}" for i in range(65)), "65 inputs"),
        ([Name("q")], TERMINALS, "unknown terminal 'q'"),
        ([Last("t")], TERMINALS, "not a definition"),
        ([Name("t")], ("t", "t"), "same name"),
        ([Constant(np.float32(np.nan))], TERMINALS, "not finite"),
        ([Apply("+", (Name("t"),))], TERMINALS, "no operation of 1 operands"),
        ([Apply("load", ())], TERMINALS, "no operation of 0 operands"),
        ([Apply("plus", (Name("t"), Name("t")))], TERMINALS, "no operation of 2 operands"),
    ],
)
def test_bounds(outputs, terminals, what):
    with pytest.raises(InputError, match=what):
        lower_outputs(outputs, terminals)


def test_shared_subtrees_can_not_blow_up():
    expression = Name("t")
    for _ in range(100):
        expression = Apply("+", (expression, expression))
    with pytest.raises(InputError, match=f"more than {NODE_MAX} nodes"):
        lower_outputs([expression], TERMINALS)


def mutate(program, words):
    """Overwrite parts of a program with given (field, place, value) triples."""
    rows = np.array([list(row) for row in program.instructions.tolist()], np.uint16).reshape(-1, 4)
    outputs, constants, nstate = program.outputs.copy(), program.constants.copy(), program.nstate
    for field, place, value in words:
        if field < 4 and len(rows):
            rows[place % len(rows), field] = value
        elif field == 4:
            outputs[place % len(outputs)] = value
        elif field == 5 and len(constants):
            constants[place % len(constants)] = np.uint32(value << 16).view(np.float32)
        elif field == 6:
            nstate = max(0, nstate + value % 3 - 1)
    instructions = np.ascontiguousarray(rows.astype("<u2")).view(INSTRUCTION).reshape(-1)
    return Program(program.inputs, constants, instructions, outputs, nstate)


@given(st.data())
def test_both_verifiers_agree_and_what_passes_runs(programs, data):
    program = lower(data.draw(programs.sources()), programs.terminals)
    value = st.one_of(st.integers(0, 40), st.integers(0, 65535))
    words = data.draw(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 99), value), max_size=3))
    changed = mutate(program, words)
    try:
        verify(changed)
    except InputError as error:
        with pytest.raises(InputError) as refused:
            pack_program(changed)
        assert str(refused.value) == str(error)
    else:
        rows = data.draw(programs.rows(len(programs.terminals), 4))
        assert programs.same(NativeProgram(changed).run(0.02, rows), run_program(changed, 0.02, rows))


def program_of(rows, nstate=0, outputs=(0,), constants=(1.0,)):
    words = np.array(rows, "<u2").reshape(-1, 4).view(INSTRUCTION).reshape(-1)
    return Program(("t",), np.array(constants, np.float32), words, np.array(outputs, np.uint16), nstate)


ADD, SIN, DELAY = BY_NAME["+"].opcode, BY_NAME["sin"].opcode, BY_NAME["delay"].opcode
LOAD, STORE, RATE = BY_NAME["load"].opcode, BY_NAME["store"].opcode, BY_NAME["differentiate"].opcode


@pytest.mark.parametrize(
    ("program", "what"),
    [
        (program_of([(0, 0, 0, 0)]), "opcode 0"),
        (program_of([(30, 0, 0, 0)]), "opcode 30"),
        (program_of([(SIN, 2, 0, 0)]), "before it is written"),
        (program_of([(ADD, 0, 65535, 0)]), "before it is written"),
        (program_of([(SIN, 0, 0, 0)], outputs=(3,)), "register 3"),
        (program_of([(DELAY, 0, 1, 0)], nstate=1), "does not exist"),
        (program_of([(RATE, 0, 0, 0)], nstate=1), "does not exist"),
        (program_of([(DELAY, 0, 0, 0), (DELAY, 0, 0, 0)], nstate=1), "another one owns"),
        (program_of([(RATE, 0, 0, 0), (DELAY, 0, 1, 0)], nstate=2), "another one owns"),
        (program_of([(LOAD, 0, 0, 0)], nstate=1), "never stored"),
        (program_of([(STORE, 0, 0, 0), (LOAD, 0, 0, 0)], nstate=1), "another one owns"),
        (program_of([(LOAD, 0, 0, 0), (DELAY, 0, 0, 0)], nstate=1), "another one owns"),
        (program_of([(LOAD, 0, 0, 0), (STORE, 0, 0, 0), (STORE, 1, 0, 0)], nstate=1), "another one owns"),
        (program_of([], constants=(np.inf,)), "not finite"),
        (program_of([], constants=(np.nan,)), "not finite"),
        (program_of([], outputs=()), "0 outputs"),
        (program_of([], outputs=(0,) * 33), "33 outputs"),
        (program_of([], nstate=4097), "4097 state"),
        (program_of([(SIN, 0, 0, 0)] * 8193), "8193 instructions"),
        (program_of([], constants=(1.0,) * 8193), "8193 constants"),
    ],
)
def test_nothing_invalid_is_verified(program, what):
    with pytest.raises(InputError, match=what):
        verify(program)
    with pytest.raises(InputError, match=what):
        pack_program(program)


def test_a_valid_load_and_store_pass():
    program = program_of([(LOAD, 0, 0, 0), (LOAD, 0, 0, 0), (ADD, 2, 1, 0), (STORE, 4, 0, 0)], nstate=1, outputs=(4,))
    verify(program)
    rows = np.zeros((3, 1), np.float32)
    assert NativeProgram(program).run(0.02, rows).tolist() == [[1], [2], [3]]
