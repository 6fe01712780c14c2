"""Lower expressions to a program: constants folded, equal values shared, no bit changed.

Folding calls the operations' own reference, and keeps for run time what would not be finite. Only stateless
operations are folded or shared: two stateful ones are two, however alike. Nothing is rewritten that some input
could tell: `(- a a)` stays, as it is NaN for an infinity.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from controller.errors import InputError
from controller.operations import BY_NAME, BY_OPCODE, OPERATIONS
from controller.program import INSTRUCTION, Program
from controller.source import Apply, Constant, Expression, Name, Source
from controller.verifier import INPUT_MAX, INSTRUCTION_MAX, OUTPUT_MAX, STATE_MAX

NODE_MAX: Final = 200_000
"""Nodes of a source, shared subexpressions counted at each use."""

# While a program grows, a value is a number: inputs from 0 (constants after them once it is known which are used),
# the result of instruction i is _RESULT + i, and a constant not yet used is -1 - its index in the pool.
_RESULT: Final = 1 << 15

_ADD: Final = BY_NAME["+"].opcode
_MULTIPLY: Final = BY_NAME["*"].opcode
_DIVIDE: Final = BY_NAME["%"].opcode
_IF: Final = BY_NAME["if"].opcode
_SELECT: Final = {_IF, BY_NAME["ifltz"].opcode}
_ONE: Final = np.float32(1)
_LOAD: Final = BY_NAME["load"].opcode
_STORE: Final = BY_NAME["store"].opcode
_ROW: Final = {o.name: (o.opcode, o.arity, o.nstate) for o in OPERATIONS if not o.internal}
_UNKNOWN: Final = (0, -1, 0)
_SHAPE: Final = {o.opcode: (o.arity, o.nstate) for o in OPERATIONS}


def lower(source: Source, inputs: Sequence[str]) -> Program:
    """Lower a source to a program.

    Args:
        source: the program as written
        inputs: names of the terminals, in order

    Returns:
        the program, which passes `verify`

    Raises:
        InputError: it names what is not there, or exceeds a bound
    """
    growing = _Growing(inputs)
    for name, expression in source.definitions:
        growing.define(name, expression)
    outputs = [growing.expression(expression) for expression in source.outputs]
    growing.store_definitions()
    return growing.finish(outputs, prune=bool(source.definitions) or growing.dropped)


def lower_outputs(outputs: Sequence[Expression], inputs: Sequence[str]) -> Program:
    """Lower one expression for each output, as trees are.

    Args:
        outputs: the expressions, without `last`
        inputs: names of the terminals, in order

    Returns:
        the program

    Raises:
        InputError: it names what is not there, or exceeds a bound
    """
    return lower(Source(tuple(outputs)), inputs)


class _Growing:
    """Hold a program that grows by one expression after the other."""

    def __init__(self, inputs: Sequence[str]) -> None:
        self.inputs = tuple(inputs)
        self.names: dict[str, int] = {name: i for i, name in enumerate(inputs)}
        self.words: list[int] = []  # instructions, op | a << 16 | b << 32 | c << 48
        self.known: dict[int, int] = {}  # stateless instruction => its result
        self.pool: list[np.float32] = []
        self.pooled: dict[bytes, int] = {}
        self.constants: dict[int, int] = {}  # constant in the pool => its register, in order of first use
        self.defined: list[str] = []
        self.loads: dict[str, tuple[int, int]] = {}  # name => (result, slot)
        self.nstate = 0
        self.dropped = False  # whether some instruction may have no use

    def define(self, name: str, expression: Expression) -> None:
        """Add a definition, for the expressions after it."""
        if name in self.names:
            raise InputError(f"'{name}' is defined twice, or is a terminal; give each definition its own name")
        self.names[name] = self.expression(expression)
        self.defined.append(name)

    def expression(self, root: Expression) -> int:
        """Add an expression's instructions, operands first and left to right; return its value."""
        values: list[int] = []
        push, pop = values.append, values.pop
        names = self.names
        for node in reversed(_preorder(root)):
            if isinstance(node, Apply):
                opcode, arity, nstate = _ROW.get(node.operation, _UNKNOWN)
                if len(node.operands) != arity:
                    raise InputError(
                        f"'{node.operation}' is no operation of {len(node.operands)} operands; see the table"
                    )
                if arity == 2:
                    b = pop()
                    values[-1] = self.apply(opcode, nstate, (values[-1], b))
                else:
                    operands = tuple(values[-arity:])
                    del values[-arity:]
                    push(self.apply(opcode, nstate, operands))
            elif isinstance(node, Name):
                try:
                    push(names[node.name])
                except KeyError:
                    raise InputError(f"unknown terminal '{node.name}'; known: {' '.join(names)}") from None
            elif isinstance(node, Constant):
                push(self.literal(node.value))
            else:
                push(self.load(node.name))
        return values[0]

    def apply(self, opcode: int, nstate: int, operands: tuple[int, ...]) -> int:
        """Add one operation, or find its value without."""
        if nstate:
            return self.stateful(opcode, nstate, operands)
        if min(operands) < 0:
            value = self.fold(opcode, operands)
            if value is not None:
                return value
            operands = tuple(v if v >= 0 else self.constant(v) for v in operands)
        # a + b and b + a are the same bits
        if opcode in (_ADD, _MULTIPLY) and operands[0] > operands[1]:
            operands = (operands[1], operands[0])
        word = opcode
        shift = 16
        for value in operands:
            word |= value << shift
            shift += 16
        result = self.known.get(word)
        if result is None:
            result = self.known[word] = _RESULT + len(self.words)
            self.words.append(word)
        return result

    def fold(self, opcode: int, operands: tuple[int, ...]) -> int | None:
        """Return the value of an operation that constants decide, or None."""
        if max(operands) < 0:
            pool = self.pool
            with np.errstate(all="ignore"):
                value = BY_OPCODE[opcode].reference(*[pool[-1 - v] for v in operands])
            return self.literal(value) if np.isfinite(value) else None
        if opcode in _SELECT and operands[0] < 0:
            condition = self.pool[-1 - operands[0]]
            first = condition > 0 if opcode == _IF else condition < 0
            chosen, other = operands[1:] if first else operands[:0:-1]
            self.drop(other)
            return chosen
        if opcode == _DIVIDE and operands[1] < 0 and self.pool[-1 - operands[1]] == 0:
            self.drop(operands[0])
            return self.literal(_ONE)
        return None

    def drop(self, value: int) -> None:
        """Note that a value has one use less: an instruction may have none left."""
        if value >= _RESULT:
            self.dropped = True

    def stateful(self, opcode: int, nstate: int, operands: tuple[int, ...]) -> int:
        """Add one operation with a state of its own."""
        word = opcode
        shift = 16
        for value in operands:
            word |= (value if value >= 0 else self.constant(value)) << shift
            shift += 16
        self.words.append(word | self.nstate << shift)
        self.nstate += nstate
        self.check_size()
        return _RESULT + len(self.words) - 1

    def load(self, name: str) -> int:
        """Return the value that a definition had the step before."""
        if name not in self.loads:
            self.words.append(_LOAD | self.nstate << 16)
            self.loads[name] = (_RESULT + len(self.words) - 1, self.nstate)
            self.nstate += 1
            self.check_size()
        return self.loads[name][0]

    def store_definitions(self) -> None:
        """Keep, after all else, what the next step loads."""
        for name, (_, slot) in self.loads.items():
            if name not in self.defined:
                raise InputError(f"(last {name}): '{name}' is not a definition; name one of the enclosing let")
            value = self.names[name]
            self.words.append(_STORE | (value if value >= 0 else self.constant(value)) << 16 | slot << 32)

    def literal(self, value: np.float32) -> int:
        """Return the pooled constant with these bits."""
        key = value.tobytes()
        at = self.pooled.get(key)
        if at is None:
            if not np.isfinite(value):
                raise InputError(f"the constant {value} is not finite; write finite numbers")
            at = self.pooled[key] = len(self.pool)
            self.pool.append(value)
        return -1 - at

    def constant(self, value: int) -> int:
        """Give a pooled constant a register."""
        register = self.constants.get(value)
        if register is None:
            register = self.constants[value] = len(self.inputs) + len(self.constants)
            self.check_size()
        return register

    def check_size(self) -> None:
        """Refuse what register numbers could not hold."""
        if len(self.words) > INSTRUCTION_MAX or len(self.constants) > INSTRUCTION_MAX or self.nstate > STATE_MAX:
            raise InputError(
                f"the program needs more than {INSTRUCTION_MAX} operations or {STATE_MAX} state values; "
                "write a smaller one"
            )

    def finish(self, outputs: list[int], prune: bool) -> Program:
        """Give every value its register; with `prune`, leave out what no output needs."""
        self.check_size()
        if len(set(self.inputs)) != len(self.inputs):
            raise InputError("two terminals have the same name; give each its own")
        if len(self.inputs) > INPUT_MAX:
            raise InputError(f"the program has {len(self.inputs)} inputs; use at most {INPUT_MAX}")
        if not 1 <= len(outputs) <= OUTPUT_MAX:
            raise InputError(f"the program has {len(outputs)} outputs; write 1 to {OUTPUT_MAX}")
        results = [v if v >= 0 else self.constant(v) for v in outputs]
        self.check_size()
        registers = list(self.constants)
        constants = np.array([self.pool[-1 - v] for v in registers], np.float32)
        words = np.array(self.words, np.uint64).view(np.uint16).reshape(-1, 4)
        if prune:
            words, results, constants, self.nstate = _prune(words, results, constants, len(self.inputs))
        shift = len(self.inputs) + len(constants) - _RESULT
        # opcodes and state slots are all below _RESULT
        words = np.where(words >= _RESULT, words.astype(np.int64) + shift, words).astype("<u2")
        outputs_ = np.array([v if v < _RESULT else v + shift for v in results], np.uint16)
        instructions = np.ascontiguousarray(words).view(INSTRUCTION).reshape(-1)
        return Program(self.inputs, constants, instructions, outputs_, self.nstate)


def _preorder(root: Expression) -> list[Expression]:
    """Return the nodes so that the reversed list has operands before their operation, left to right."""
    order: list[Expression] = []
    todo = [root]
    while todo:
        node = todo.pop()
        order.append(node)
        if isinstance(node, Apply):
            todo.extend(node.operands)
            if len(order) > NODE_MAX:
                raise InputError(f"an expression has more than {NODE_MAX} nodes; write a smaller one")
    return order


def _prune(
    words: npt.NDArray[np.uint16], outputs: list[int], constants: npt.NDArray[np.float32], ninput: int
) -> tuple[npt.NDArray[np.uint16], list[int], npt.NDArray[np.float32], int]:
    """Leave out instructions, constants and state that no output needs, and number the rest afresh."""
    rows: list[list[int]] = words.tolist()
    stores = {row[2]: i for i, row in enumerate(rows) if row[0] == _STORE}
    live: set[int] = set()
    todo = [value - _RESULT for value in outputs if value >= _RESULT]
    while todo:
        i = todo.pop()
        if i in live:
            continue
        live.add(i)
        row = rows[i]
        todo.extend(value - _RESULT for value in row[1 : 1 + _SHAPE[row[0]][0]] if value >= _RESULT)
        if row[0] == _LOAD:
            todo.append(stores[row[1]])
    renumbered: dict[int, int] = {i: i for i in range(ninput)}
    slots: dict[int, int] = {}
    kept: list[list[int]] = []
    used: list[int] = []
    nstate = 0

    def renumber(value: int) -> int:
        if value not in renumbered:  # a constant at its first use
            renumbered[value] = ninput + len(used)
            used.append(value - ninput)
        return renumbered[value]

    for i in sorted(live):
        row = rows[i]
        arity, size = _SHAPE[row[0]]
        fresh = [row[0], *(renumber(value) for value in row[1 : 1 + arity])]
        if size:
            if row[1 + arity] not in slots:
                slots[row[1 + arity]] = nstate
                nstate += size
            fresh.append(slots[row[1 + arity]])
        renumbered[_RESULT + i] = _RESULT + len(kept)
        kept.append(fresh + [0] * (4 - len(fresh)))
    results = [renumber(value) for value in outputs]
    return np.array(kept, np.uint16).reshape(-1, 4), results, constants[used], nstate
