"""A controller as written: immutable expressions, before they are lowered to a program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np


@dataclass(frozen=True, slots=True)
class Constant:
    """Hold a finite binary32 literal."""

    value: np.float32


@dataclass(frozen=True, slots=True)
class Name:
    """Name an input terminal, or a definition of the enclosing ``let`` that stands earlier."""

    name: str


@dataclass(frozen=True, slots=True)
class Last:
    """Read the value that the definition ``name`` had the step before (0 at the start)."""

    name: str


@dataclass(frozen=True, slots=True)
class Apply:
    """Apply the operation named ``operation`` to its operands, evaluated left to right."""

    operation: str
    operands: tuple[Expression, ...]


Expression: TypeAlias = Constant | Name | Last | Apply


@dataclass(frozen=True, slots=True)
class Source:
    """Hold ``(let ((name expression) …) (list expression …))``; no definitions: plain ``(list …)``."""

    outputs: tuple[Expression, ...]
    definitions: tuple[tuple[str, Expression], ...] = ()
