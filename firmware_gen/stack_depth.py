"""How deep machine code takes the stack, callees included."""

from __future__ import annotations

import re

from firmware_gen.control_flow import UnboundedError, function_graph, is_call
from firmware_gen.instruction_costs import register_count
from firmware_gen.machine_code import Instruction, MachineCode


def stack_depth(code: MachineCode, entry: int) -> int:
    """Return how many bytes of stack a function takes, at most.

    Args:
        code: the machine code
        entry: address of the function

    Raises:
        UnboundedError: it depends on the way, or on a register, or the function calls itself
    """
    return _depth(code, entry, {}, [])


def _depth(code: MachineCode, entry: int, known: dict[int, int], callers: list[int]) -> int:
    if entry in known:
        return known[entry]
    if entry in callers:
        raise UnboundedError(f"{code.name_of(entry)} calls itself")
    graph = function_graph(code, entry)
    depths = {entry: 0}
    deepest = 0
    for address in reversed(graph.order):
        instruction = code.instructions[address]
        depth = depths[address] + stack_growth(instruction)
        inside = _depth(code, instruction.target, known, [*callers, entry]) if is_call(code, instruction) else 0
        deepest = max(deepest, depth + inside)
        for way in graph.ways[address]:
            if way.to is not None and depths.setdefault(way.to, depth) != depth:
                raise UnboundedError(f"the stack of {code.name_of(entry)} at {way.to:#x} depends on the way there")
    for loop in graph.loops.values():
        if depths[loop.first] != depths[loop.last]:
            raise UnboundedError(f"the stack of {code.name_of(entry)} grows in a loop at {loop.first:#x}")
    known[entry] = deepest
    return deepest


def stack_growth(instruction: Instruction) -> int:
    """Return by how much an instruction deepens the stack [bytes]; negative, where it takes back.

    Args:
        instruction: the instruction

    Raises:
        UnboundedError: that depends on a register
    """
    name, operands = instruction.mnemonic.partition(".")[0], instruction.operands
    size = 8 if re.search(r"\bd\d", operands) else 4
    if name.startswith(("push", "vpush", "pop", "vpop")):
        return register_count(operands) * size * (-1 if "pop" in name else 1)
    if operands.startswith("sp!"):
        return register_count(operands) * size * (1 if name.startswith(("st", "vst")) else -1)
    written_back = re.search(r"\[sp, #(-?\d+)\]!|\[sp\], #(-?\d+)", operands)
    if written_back:
        return -int(written_back[1] or written_back[2])
    if re.match(r"sp\b", operands) and name[:3] in ("add", "sub", "mov"):
        amount = re.fullmatch(r"sp(?:, sp)?, #(\d+)", operands)
        if amount is None:
            raise UnboundedError(f"'{name} {operands}' moves the stack by a register")
        return int(amount[1]) * (1 if name.startswith("sub") else -1)
    return 0
