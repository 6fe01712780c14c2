"""`servolve show`: what a controller is, and how a run went."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from controller import Controller, format_source, load_controller, program_hash
from controller.controller_file import BEST, RUN
from controller.decimals import format_decimal
from controller.errors import InputError
from controller.source import Apply, Constant, Expression, Last, Name
from servolve.tree_picture import tree_svg


def show(
    controller: Annotated[Path, Parameter(name="RUN|CONTROLLER")],
    /,
    *,
    as_: Annotated[Literal["text", "tree", "c", "svg"] | None, Parameter(name="--as", show_choices=True)] = None,
    report: Path | None = None,
) -> int:
    """Print a controller: its inputs, outputs and program, its trees, or its C; or how a run went.

    A run may be unfinished, or being written; with --as, its best controller is printed.

    Args:
        controller: a *.controller.toml, or a run folder
        as_: text, tree, c, or svg, a picture of the trees; left out: of a run its generations, its best's lineage
            and program, of a controller its text
        report: of a run: HTML file to write the run's report to

    Returns:
        exit status
    """
    run = _is_run(controller)
    if report is not None:
        _write_report(controller, run, report)
        return 0
    if run and as_ is None:
        from servolve.show_run import run_lines

        print("\n".join(run_lines(controller)))
        return 0
    if run and not (controller / BEST).is_file():
        # the history's best needs the simulation's packages; the chosen one does not
        from evolve.runs.record import best_controller

        loaded = best_controller(controller)
    else:
        loaded = load_controller(controller)
    if as_ == "c":
        from firmware_gen import generate

        print(generate(loaded).source, end="")
    elif as_ == "svg":
        print(tree_svg(loaded), end="")
    elif as_ == "tree":
        print("\n".join(tree_lines(loaded)))
    else:
        print("\n".join(text_lines(loaded)))
    return 0


def _is_run(path: Path) -> bool:
    """Tell whether there is a run, of whatever is called a path."""
    try:
        return (path / RUN).is_file()
    except (OSError, ValueError):
        return False


def _write_report(folder: Path, run: bool, path: Path) -> None:
    """Write a run's report."""
    if not run:
        raise InputError(f"{folder}: --report needs a run folder, and there is no {RUN} in it; name a run")
    from servolve.run_report import write_run_report

    write_run_report(folder, path)


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
