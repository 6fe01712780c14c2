"""The functions that generated C copies out of the controller runtime's headers, so that there is one source."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from controller.generate_runtime import PATH as RUNTIME_TABLE

HEADERS: Final = ("sv_math.h", "sv_operations.h")
"""Where the functions are; what a function calls stands above it."""

_FUNCTION: Final = re.compile(
    r"^(?P<text>(?://[^\n]*\n)+static inline [a-z0-9_]+ (?P<name>sv_[a-z0-9_]+)\((?P<body>.*?)^\}\n)", re.M | re.S
)
_CALL: Final = re.compile(r"\b(sv_[a-z0-9_]+)\(")
_OPERATION: Final = re.compile(r" (?:[-+*/]|[<>]=?|[=!]=) |[=?:] -(?=[a-z])")


@dataclass(frozen=True)
class RuntimeFunction:
    """Hold one static function of the runtime.

    Args:
        name: as "sv_sin"
        text: its comment and definition
        calls: the runtime functions in its body, in order, once for each place
        operations: how many float operations its body writes down, all branches counted
    """

    name: str
    text: str
    calls: tuple[str, ...]
    operations: int


def read_runtime_functions() -> dict[str, RuntimeFunction]:
    """Read every function of `HEADERS`.

    Returns:
        the functions by name, callees first
    """
    folder = RUNTIME_TABLE.parent
    functions: dict[str, RuntimeFunction] = {}
    for header in HEADERS:
        for match in _FUNCTION.finditer((folder / header).read_text(encoding="utf-8")):
            body = match["body"]
            calls = tuple(_CALL.findall(body))
            unknown = set(calls) - set(functions)
            if unknown:
                raise ValueError(f"{header}: {match['name']} calls {sorted(unknown)}, which are not above it")
            code = "\n".join(line.partition("//")[0] for line in body.splitlines())
            functions[match["name"]] = RuntimeFunction(
                match["name"], match["text"], calls, len(_OPERATION.findall(code))
            )
    return functions


def called_functions(code: Iterable[str], functions: Mapping[str, RuntimeFunction]) -> list[RuntimeFunction]:
    """Return the functions that pieces of C call, directly or not, callees first.

    Args:
        code: pieces of C
        functions: all there are, callees first
    """
    todo = [name for piece in code for name in _CALL.findall(piece)]
    needed: set[str] = set()
    while todo:
        name = todo.pop()
        if name not in needed:
            needed.add(name)
            todo.extend(functions[name].calls)
    return [function for name, function in functions.items() if name in needed]


def operations_of(code: str, functions: Mapping[str, RuntimeFunction]) -> int:
    """Bound the float operations (arithmetic, comparison, negation) that one evaluation of a piece of C does.

    Every branch counts, so the bound is not tight; there are no loops and no recursion in what it counts.

    Args:
        code: C statements or an expression
        functions: what it may call
    """
    return len(_OPERATION.findall(code)) + sum(
        functions[name].operations + sum(operations_of(f"{callee}(", functions) for callee in functions[name].calls)
        for name in _CALL.findall(code)
    )
