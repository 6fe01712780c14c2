"""The worst case of machine code: the longest path through its control-flow graph.

A call adds the callee's own bound. A loop has a bound only where it counts down from constants, as the division of
libgcc's software floats does; other loops are refused, and so are recursion and jumps through registers.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from firmware_gen.bounds.control_flow import Graph, Loop, UnboundedError, Way, function_graph, is_call
from firmware_gen.bounds.instruction_costs import instruction_cycles, register_count
from firmware_gen.bounds.machine_code import Instruction, MachineCode
from firmware_gen.bounds.stack_depth import stack_depth
from firmware_gen.bounds.targets import Target, Timing

Weight = Callable[[Instruction, Instruction | None, bool], int]
"""(instruction, the next one or None, branch taken) => cost."""


@dataclass(frozen=True)
class WorstCase:
    """Hold the bounds of one function, callees included.

    Args:
        instructions: executed, at most
        cycles: for each of the target's timings, at most
        stack_bytes: below the caller's, at most
    """

    instructions: int
    cycles: tuple[int, ...]
    stack_bytes: int


def bound_function(code: MachineCode, target: Target, name: str) -> WorstCase:
    """Bound a function of a controller.

    Args:
        code: the machine code
        target: what it was compiled for
        name: of the function

    Raises:
        UnboundedError: there is a loop without a known bound, recursion, or a jump that can not be followed
        RunError: an instruction is unknown
    """
    entry = code.entries[name]
    instructions = _longest(code, _one, entry, {}, [])
    cycles = tuple(
        # whoever calls waits for the function's first lines
        _longest(code, _cycles(code, target, timing), entry, {}, []) + 2 * timing.flash_wait
        for timing in target.timings
    )
    return WorstCase(instructions, cycles, stack_depth(code, entry))


def _one(_instruction: Instruction, _following: Instruction | None, _taken: bool) -> int:
    return 1


def _cycles(code: MachineCode, target: Target, timing: Timing) -> Weight:
    def weight(instruction: Instruction, following: Instruction | None, taken: bool) -> int:
        cycles = instruction_cycles(target.table, instruction, following, taken, timing.slow_multiply)
        return cycles + timing.flash_wait * _flash_accesses(code, timing, instruction, following, taken)

    return weight


def _flash_accesses(
    code: MachineCode, timing: Timing, instruction: Instruction, following: Instruction | None, taken: bool
) -> int:
    """Return how many times the flash is waited for until the next instruction can run."""
    line = timing.line_bytes
    literals = _literals(code, instruction)
    if taken or following is None:
        # the line fetched in vain, the target's, and the one that the target may reach into
        return literals + 3
    last = (instruction.address + instruction.size - 1) // line
    return literals + (following.address + following.size - 1) // line - last


def _literals(code: MachineCode, instruction: Instruction) -> int:
    """Return how many words an instruction may load from the flash."""
    name, operands = instruction.mnemonic, instruction.operands
    if not re.match(r"v?ld[rm]", name) or "[sp" in operands or operands.startswith("sp!"):
        return 0
    if "[pc" not in operands and not code.loads_constants_by_register:
        return 0
    return register_count(operands) if "{" in operands else 2 if name.startswith("ldrd") else 1


def _longest(code: MachineCode, weight: Weight, entry: int, known: dict[int, int], callers: list[int]) -> int:
    """Return the largest sum of weights on any path through a function; known holds what is bounded already."""
    if entry in known:
        return known[entry]
    if entry in callers:
        raise UnboundedError(f"{code.name_of(entry)} calls itself")
    graph = function_graph(code, entry)
    longest: dict[int, int] = {}
    for address in graph.order:
        instruction = code.instructions[address]
        called = (
            _longest(code, weight, instruction.target, known, [*callers, entry]) if is_call(code, instruction) else 0
        )
        again = _rounds(code, weight, graph, graph.loops[address]) if address in graph.loops else 0
        onward = max(_along(code, weight, instruction, way, longest) for way in graph.ways[address])
        longest[address] = called + again + onward
    known[entry] = longest[entry]
    return longest[entry]


def _along(code: MachineCode, weight: Weight, instruction: Instruction, way: Way, longest: dict[int, int]) -> int:
    if way.to is None:
        return weight(instruction, None, way.taken)
    return weight(instruction, code.instructions[way.to], way.taken) + longest[way.to]


def _rounds(code: MachineCode, weight: Weight, graph: Graph, loop: Loop) -> int:
    """Return what a loop adds to its last round."""
    last = code.instructions[loop.last]
    longest = {loop.last: weight(last, code.instructions[loop.first], True)}
    for address in graph.order:
        if address in loop.body and address != loop.last:
            ways = [way for way in graph.ways[address] if way.to in longest]
            longest[address] = max(_along(code, weight, code.instructions[address], way, longest) for way in ways)
    return (loop.rounds - 1) * longest[loop.first]
