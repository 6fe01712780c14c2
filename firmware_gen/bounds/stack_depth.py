"""How deep machine code takes the stack, callees included; loops need no bound for that, if none of them grows it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from firmware_gen.bounds.control_flow import UnboundedError, Way, function_ways, is_call
from firmware_gen.bounds.instruction_costs import register_count
from firmware_gen.bounds.machine_code import Instruction, MachineCode

_BY_REGISTER: Final = re.compile(r"sp, (?:sp, )?r\d+")


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
    ways = function_ways(code, entry)
    depths = {entry: 0}
    deepest = 0
    todo = [entry]
    while todo:
        address = todo.pop()
        instruction = code.instructions[address]
        amount = _amount(code, ways, address) if _BY_REGISTER.fullmatch(instruction.operands) else None
        depth = depths[address] + stack_growth(instruction, amount)
        inside = _depth(code, instruction.target, known, [*callers, entry]) if is_call(code, instruction) else 0
        deepest = max(deepest, depth + inside)
        for way in ways[address]:
            if way.to is None:
                continue
            if way.to not in depths:
                depths[way.to] = depth
                todo.append(way.to)
            elif depths[way.to] != depth:
                raise UnboundedError(f"the stack of {code.name_of(entry)} at {way.to:#x} depends on the way there")
    known[entry] = deepest
    return deepest


def _amount(code: MachineCode, ways: Mapping[int, list[Way]], address: int) -> int | None:
    """Return what the register that an instruction adds to the stack pointer holds, or None where that is not known."""
    register = code.instructions[address].operands.rpartition(" ")[2]
    shift = 0
    while True:
        before = [a for a, onward in ways.items() if any(way.to == address for way in onward)]
        if len(before) != 1:
            return None
        address = before[0]
        instruction = code.instructions[address]
        name, operands = instruction.mnemonic.partition(".")[0], instruction.operands
        shifted = re.fullmatch(rf"{register}, {register}, #(\d+)", operands)
        constant = re.fullmatch(rf"{register}, #(\d+)", operands)
        literal = re.fullmatch(rf"{register}, \[pc, #(\d+)\]", operands)
        if name == "lsls" and shifted:
            shift += int(shifted[1])
        elif name == "movs" and constant:
            return int(constant[1]) << shift
        elif name == "ldr" and literal:
            word = code.literals.get((address & ~3) + 4 + int(literal[1]))
            return None if word is None else ((word << shift) + 2**31) % 2**32 - 2**31
        elif re.search(rf"\b{register}\b", operands) or is_call(code, instruction) or "-" in operands:
            return None


def stack_growth(instruction: Instruction, amount: int | None = None) -> int:
    """Return by how much an instruction deepens the stack [bytes]; negative, where it takes back.

    Args:
        instruction: the instruction
        amount: what the register holds that it adds to the stack pointer, or None

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
    if amount is not None and name == "add":
        return -amount
    if re.match(r"sp\b", operands) and name[:3] in ("add", "sub", "mov"):
        number = re.fullmatch(r"sp(?:, sp)?, #(\d+)", operands)
        if number is None:
            raise UnboundedError(f"'{name} {operands}' moves the stack by a register")
        return int(number[1]) * (1 if name.startswith("sub") else -1)
    return 0
