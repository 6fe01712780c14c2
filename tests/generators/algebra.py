"""A controller's program once more, over whatever numbers a generator has: texts of C, SymPy's or CasADi's symbols."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from controller.operations import BY_OPCODE


@dataclass(frozen=True)
class Algebra:
    """What a generator offers besides + - * /: constants, a choice, and functions by their names in C.

    Args:
        constant: of a float
        choose: (a, b, x, y) => x where a < b, else y
        equal: (a, b, x, y) => x where a == b, else y
        function: (name, x) => sin, cos, tanh, exp, log, atan, floor of x
    """

    constant: Any
    choose: Any
    equal: Any
    function: Any


class Nested:
    """A nested expression of C over doubles, as m2cgen writes them."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __add__(self, other):
        return Nested(f"({self.text} + {other.text})")

    def __sub__(self, other):
        return Nested(f"({self.text} - {other.text})")

    def __mul__(self, other):
        return Nested(f"({self.text} * {other.text})")

    def __truediv__(self, other):
        return Nested(f"({self.text} / {other.text})")


NESTED = Algebra(
    constant=lambda value: Nested(f"({value!r})"),
    choose=lambda a, b, x, y: Nested(f"({a.text} < {b.text} ? {x.text} : {y.text})"),
    equal=lambda a, b, x, y: Nested(f"({a.text} == {b.text} ? {x.text} : {y.text})"),
    function=lambda name, x: Nested(f"{name}({x.text})"),
)


def sympy_algebra() -> Algebra:
    """SymPy's."""
    import sympy

    functions = {"floor": sympy.floor, "atan": sympy.atan, "log": sympy.log, "exp": sympy.exp}
    functions |= {"sin": sympy.sin, "cos": sympy.cos, "tanh": sympy.tanh}
    return Algebra(
        constant=sympy.Float,
        choose=lambda a, b, x, y: sympy.Piecewise((x, a < b), (y, True)),
        equal=lambda a, b, x, y: sympy.Piecewise((x, sympy.Eq(a, b)), (y, True)),
        function=lambda name, x: functions[name](x),
    )


def casadi_algebra() -> Algebra:
    """CasADi's."""
    import casadi

    return Algebra(
        constant=casadi.SX,
        choose=lambda a, b, x, y: casadi.if_else(a < b, x, y),
        equal=lambda a, b, x, y: casadi.if_else(a == b, x, y),
        function=lambda name, x: getattr(casadi, name)(x),
    )


def evaluate(program, dt: float, algebra: Algebra, inputs: list[Any], states: list[Any]) -> list[Any]:
    """Return a program's outputs and its next states.

    Args:
        program: the program
        dt: period [s]
        algebra: what to compute with
        inputs: terminals, (ninput,)
        states: before the step, (nstate,)
    """
    registers = inputs + [algebra.constant(float(value)) for value in program.constants]
    after = list(states)
    for row in program.instructions.tolist():
        operation = BY_OPCODE[row[0]]
        values = [registers[i] for i in row[1 : 1 + operation.arity]]
        if operation.nstate:
            slot = row[1 + operation.arity]
            result, after[slot] = _stateful(algebra, dt, operation.name, after[slot], *values)
        else:
            result = _stateless(algebra, operation.name, *values)
        registers.append(result)
    return [registers[i] for i in program.outputs.tolist()] + after


def _stateless(algebra: Algebra, name: str, *values: Any) -> Any:
    zero, one = algebra.constant(0.0), algebra.constant(1.0)
    simple = {"+": "__add__", "-": "__sub__", "*": "__mul__"}
    if name in simple:
        return getattr(values[0], simple[name])(values[1])
    if name == "%":
        return algebra.equal(values[1], zero, one, values[0] / values[1])
    if name == "ifltz":
        return algebra.choose(values[0], zero, values[1], values[2])
    if name == "if":
        return algebra.choose(zero, values[0], values[1], values[2])
    if name == "min":
        return algebra.choose(values[0], values[1], *values)
    if name == "max":
        return algebra.choose(values[1], values[0], *values)
    if name in ("sin", "cos", "tanh", "exp", "log", "atan"):
        return algebra.function(name, values[0])
    raise NotImplementedError(name)


def _stateful(algebra: Algebra, dt: float, name: str, s: Any, *values: Any) -> tuple[Any, Any]:
    step = algebra.constant(dt)
    if name == "osc-wave":
        phase = s + step * values[0]
        phase = phase - algebra.function("floor", phase)
        turned = phase + values[1]
        turned = turned - algebra.function("floor", turned)
        return algebra.function("sin", algebra.constant(2 * math.pi) * turned), phase
    if name == "integrate":
        total = s + step * values[0]
        return total, total
    if name == "delay":
        return s, values[0]
    raise NotImplementedError(name)
