"""What a controller costs on a target: memory, and the worst case of each function that a firmware calls."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass

from controller.errors import RunError
from firmware_gen.bounds.machine_code import MachineCode
from firmware_gen.bounds.stack_depth import stack_depth
from firmware_gen.bounds.targets import FUNCTIONS, Target, link_controller
from firmware_gen.bounds.worst_case import WorstCase, bound_function
from firmware_gen.transpiler.generate import Transpiled


@dataclass(frozen=True)
class Footprint:
    """Hold what one build of a controller costs.

    Args:
        target: the kind of machine
        level: of optimisation, as "-Os"
        compiler: the first line of the compiler's version
        text_bytes: of the controller's own code, without its selftest
        library_bytes: of the compiler's routines that it calls, with their constants
        selftest_bytes: what a firmware that calls the selftest has besides, code and recorded steps
        selftest_stack_bytes: what the selftest takes of the stack, or None where that is not known
        data_bytes: writable memory outside the state structure: none
        sizes: code of each function [bytes], by its name without the unit's
        bounds: of each function, by its name without the unit's
        refusals: why a function has no bound, by its name without the unit's
    """

    target: Target
    level: str
    compiler: str
    text_bytes: int
    library_bytes: int
    selftest_bytes: int
    selftest_stack_bytes: int | None
    data_bytes: int
    sizes: Mapping[str, int]
    bounds: Mapping[str, WorstCase]
    refusals: Mapping[str, str]

    @property
    def period(self) -> WorstCase | None:
        """Return the bound of what runs once a period, step and command, or None where one of them has none."""
        parts = [self.bounds.get(name) for name in ("step", "command")]
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return None
        return WorstCase(
            instructions=sum(part.instructions for part in known),
            cycles=tuple(map(sum, zip(*(part.cycles for part in known), strict=True))),
            stack_bytes=max(part.stack_bytes for part in known),
        )


def has_tools(target: Target) -> bool:
    """Return whether a target's compiler and tools are here.

    Args:
        target: the kind of machine
    """
    return all(shutil.which(f"{target.tools}{tool}") for tool in ("gcc", "objdump", "nm"))


def measure_footprint(transpiled: Transpiled, target: Target, level: str) -> Footprint:
    """Build a controller for a target and bound what its functions take.

    Args:
        transpiled: the files
        target: the kind of machine
        level: of optimisation, as "-Os"

    Raises:
        InputError: there is no such compiler
        RunError: the files do not compile, or a tool fails
    """
    prefix = f"{transpiled.unit.name}_"
    code, tested = link_controller(transpiled, target, level)
    own = {name: size for name, size in code.sizes.items() if name.startswith((prefix, "sv_"))}
    # a routine may have several names
    routines = {code.entries[name]: size for name, size in code.sizes.items() if name not in own}
    library = sum(routines.values()) + (code.constant_bytes if routines else 0)
    bounds: dict[str, WorstCase] = {}
    refusals: dict[str, str] = {}
    for function in FUNCTIONS:
        try:
            bounds[function] = bound_function(code, target, prefix + function)
        except RunError as error:
            refusals[function] = str(error)
    return Footprint(
        target=target,
        level=level,
        compiler=code.compiler,
        text_bytes=code.text_bytes - library,
        library_bytes=library,
        selftest_bytes=tested.text_bytes - code.text_bytes,
        selftest_stack_bytes=_stack(tested, f"{prefix}selftest"),
        data_bytes=tested.data_bytes,
        sizes={name.removeprefix(prefix): size for name, size in own.items()},
        bounds=bounds,
        refusals=refusals,
    )


def _stack(code: MachineCode, function: str) -> int | None:
    try:
        return stack_depth(code, code.entries[function])
    except RunError:
        return None
