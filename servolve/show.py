"""`servolve show`: what a controller is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from controller import Controller, format_source, load_controller, program_hash
from controller.decimals import format_decimal
from controller.source import Apply, Constant, Expression, Last, Name


def show(
    controller: Path,
    /,
    *,
    as_: Annotated[Literal["text", "tree", "c"], Parameter(name="--as", show_choices=True)] = "text",
) -> int:
    """Print a controller: its inputs, outputs and program, its trees, or its C.

    Args:
        controller: a *.controller.toml, or a run folder
        as_: what to print

    Returns:
        exit status
    """
    loaded = load_controller(controller)
    if as_ == "c":
        from firmware_gen import generate

        print(generate(loaded).source, end="")
    elif as_ == "tree":
        print("\n".join(tree_lines(loaded)))
    else:
        print("\n".join(text_lines(loaded)))
    return 0


def text_lines(controller: Controller) -> Iterator[str]:
    """Yield the lines that describe a controller, its program last.

    Args:
        controller: the controller
    """
    slew = f"{controller.slew_rad_s:g} rad/s" if controller.slew_rad_s else "none"
    program = controller.program
    rows: list[tuple[str, Any]] = [
        ("controller", controller.name),
        ("task", controller.task or "not said"),
        ("period", f"{controller.period_s * 1000:g} ms"),
        ("filter", f"{controller.filter:g}, slew limit {slew}"),
        ("program", f"{len(program.instructions)} instructions, {program.nstate} state, {program_hash(program)}"),
        *(("input", f"{i.name} [{i.unit}], {i.low:g} to {i.high:g}") for i in controller.inputs),
        *(
            ("output", f"{o.name} [{o.unit}], {o.low:g} to {o.high:g}, neutral {o.neutral:g}")
            for o in controller.outputs
        ),
        *((key.replace("_", " "), value) for key, value in controller.provenance.items()),
    ]
    width = max(len(key) for key, _ in rows) + 2
    yield from (f"{key:<{width}}{value}" for key, value in rows)
    yield ""
    yield format_source(controller.source)


def tree_lines(controller: Controller) -> Iterator[str]:
    """Yield a controller's expressions as trees, one node a line.

    Args:
        controller: the controller
    """
    for name, expression in controller.source.definitions:
        yield name
        yield from _branches(expression)
    for output, expression in zip(controller.outputs, controller.source.outputs, strict=True):
        yield f"{output.name} [{output.unit}]"
        yield from _branches(expression)


def _branches(root: Expression) -> Iterator[str]:
    """Yield the lines of one tree; a stack of its own, as a tree may be deeper than Python's."""
    pending: list[tuple[Expression, str, bool]] = [(root, "", True)]
    while pending:
        node, indent, last = pending.pop()
        yield f"{indent}{'└─ ' if last else '├─ '}{_label(node)}"
        if isinstance(node, Apply):
            below = indent + ("   " if last else "│  ")
            count = len(node.operands)
            pending.extend(
                (operand, below, place == count - 1) for place, operand in reversed(list(enumerate(node.operands)))
            )


def _label(node: Expression) -> str:
    """Return what stands at one node."""
    match node:
        case Apply(operation=operation):
            return operation
        case Constant():
            return format_decimal(node.value)
        case Name(name=name):
            return name
        case Last(name=name):
            return f"(last {name})"
