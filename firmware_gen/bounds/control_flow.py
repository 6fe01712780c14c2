"""The control-flow graph of machine code: where each instruction can lead, and how often a loop goes round."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from controller.errors import RunError
from firmware_gen.bounds.instruction_costs import is_conditional
from firmware_gen.bounds.machine_code import Instruction, MachineCode

_CALL: Final = re.compile(r"bl(?:eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?")
_BRANCH: Final = re.compile(r"b(?:eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?")


class UnboundedError(RunError):
    """Say why there is no bound."""


@dataclass(frozen=True)
class Way:
    """Hold a way on from an instruction.

    Args:
        to: the next instruction's address, or None where the function returns
        taken: whether a branch is taken, or control comes back from a call
    """

    to: int | None
    taken: bool


@dataclass(frozen=True)
class Loop:
    """Hold a loop that counts down.

    Args:
        first: address that the last instruction goes back to
        last: the only instruction that leaves the loop
        body: addresses of all its instructions
        rounds: how often it goes round, at most
    """

    first: int
    last: int
    body: frozenset[int]
    rounds: int


@dataclass(frozen=True)
class Graph:
    """Hold the control flow of one function, without the ways back of its loops.

    Args:
        entry: address of its first instruction
        ways: on from each instruction that can be reached
        order: instructions, each behind all that it can lead to
        loops: by the address of the last instruction
    """

    entry: int
    ways: Mapping[int, list[Way]]
    order: list[int]
    loops: Mapping[int, Loop]


def is_call(code: MachineCode, instruction: Instruction) -> bool:
    """Return whether an instruction calls a function; a bl within one is a far jump, as compilers use it on Cortex-M0.

    Args:
        code: the machine code
        instruction: the instruction
    """
    name = instruction.mnemonic.partition(".")[0]
    return _CALL.fullmatch(name) is not None and instruction.target in code.entry_addresses


@lru_cache(maxsize=1024)
def function_ways(code: MachineCode, entry: int) -> Mapping[int, list[Way]]:
    """Return the ways on from every instruction that a function can reach, its loops included.

    Args:
        code: the machine code
        entry: address of the function

    Raises:
        UnboundedError: there is a jump that can not be followed
    """
    ways: dict[int, list[Way]] = {}
    todo = [entry]
    while todo:
        address = todo.pop()
        if address in ways:
            continue
        if address not in code.instructions:
            raise UnboundedError(f"control leaves the code at {address:#x}")
        ways[address] = _ways(code, code.instructions[address], entry)
        todo += [way.to for way in ways[address] if way.to is not None]
    return ways


@lru_cache(maxsize=1024)
def function_graph(code: MachineCode, entry: int) -> Graph:
    """Follow a function's machine code, and take out the ways back of its loops.

    Args:
        code: the machine code
        entry: address of the function

    Raises:
        UnboundedError: there is a loop that does not count down from a constant, or a jump that can not be followed
    """
    ways = dict(function_ways(code, entry))
    loops = {}
    for last, first in _ways_back(entry, ways):
        if last in loops:
            raise UnboundedError(f"{code.name_of(entry)} has loops in each other at {last:#x}")
        loops[last] = _counted_loop(code, ways, entry, first, last)
    if any(a is not b and a.body & b.body for a in loops.values() for b in loops.values()):
        raise UnboundedError(f"{code.name_of(entry)} has loops in each other")
    for last, loop in loops.items():
        ways[last] = [way for way in ways[last] if way.to != loop.first]
    return Graph(entry, ways, _order(entry, ways), loops)


def _ways(code: MachineCode, instruction: Instruction, entry: int) -> list[Way]:
    name, operands = instruction.mnemonic.partition(".")[0], instruction.operands
    onward = Way(instruction.address + instruction.size, False)
    if _CALL.fullmatch(name):
        if is_call(code, instruction):
            return [Way(onward.to, True)]
        if name == "bl":
            return [Way(instruction.target, True)]
    if name in ("cbz", "cbnz"):
        return [onward, Way(instruction.target, True)]
    if _returns(instruction):
        leave = Way(None, True)
        return [onward, leave] if is_conditional(instruction) else [leave]
    if _BRANCH.fullmatch(name):
        branch = Way(instruction.target, True)
        return [branch] if name == "b" else [onward, branch]
    if name == "mov" and re.match(r"pc\b", operands):
        targets = [word for word in code.constant_words if _within(code, word, instruction.address)]
        if targets:
            return [Way(target, True) for target in sorted(set(targets))]
    if name.startswith(("bx", "blx", "tb")) or re.match(r"pc\b|[^\[]*\{.*\bpc\b", operands):
        raise UnboundedError(f"{code.name_of(entry)} jumps or calls through a register ({name} {operands})")
    return [onward]


def _within(code: MachineCode, word: int, address: int) -> bool:
    """Return whether a constant names an instruction of the function that an address lies in: a place to jump to."""
    for name, size in code.sizes.items():
        start = code.entries[name]
        if start <= address < start + size:
            return start <= word < start + size and word in code.instructions
    return False


def _returns(instruction: Instruction) -> bool:
    name, operands = instruction.mnemonic, instruction.operands
    if name.startswith("bx"):
        return operands == "lr"
    if name.startswith(("pop", "ldm", "ldr")) and (operands.startswith("sp!") or "[sp]" in operands or name[0] == "p"):
        return re.search(r"\bpc\b", operands) is not None
    return name.startswith("mov") and operands == "pc, lr"


def _depth_first(entry: int, ways: Mapping[int, list[Way]]) -> Iterator[tuple[str, int, int]]:
    """Yield ("back", from, to) for each way to an instruction that is being followed, ("done", 0, address) at ends."""
    finished: dict[int, bool] = {entry: False}
    stack: list[tuple[int, Iterator[Way]]] = [(entry, iter(ways[entry]))]
    while stack:
        address, onward = stack[-1]
        for way in onward:
            if way.to is None or finished.get(way.to) is True:
                continue
            if way.to in finished:
                yield "back", address, way.to
                continue
            finished[way.to] = False
            stack.append((way.to, iter(ways[way.to])))
            break
        else:
            finished[address] = True
            yield "done", 0, address
            stack.pop()


def _ways_back(entry: int, ways: Mapping[int, list[Way]]) -> list[tuple[int, int]]:
    return [(start, end) for kind, start, end in _depth_first(entry, ways) if kind == "back"]


def _order(entry: int, ways: Mapping[int, list[Way]]) -> list[int]:
    return [address for kind, _, address in _depth_first(entry, ways) if kind == "done"]


def _counted_loop(code: MachineCode, ways: Mapping[int, list[Way]], entry: int, first: int, last: int) -> Loop:
    """Recognise "subs r, #1; (cmp r, #0;) bne first" with constants in r before the loop; refuse other loops."""
    before: dict[int, list[int]] = {}
    for address, onward in ways.items():
        for way in onward:
            if way.to is not None:
                before.setdefault(way.to, []).append(address)
    body = {first, last}
    todo = [last]
    while todo:
        address = todo.pop()
        todo += [a for a in before.get(address, []) if a not in body and address != first]
        body |= set(before.get(address, [])) if address != first else set()
    refusal = UnboundedError(f"{code.name_of(entry)} has a loop at {first:#x} whose rounds are not known")
    leaves = [a for a in body if any(way.to not in body for way in ways[a])]
    counter = _counter(code, before, last)
    if leaves != [last] or counter is None or (entry in body and entry != first):
        raise refusal
    down = [a for a in body if _writes(code.instructions[a], counter)]
    if len(down) != 1 or not re.fullmatch(rf"{counter}, (?:{counter}, )?#1", code.instructions[down[0]].operands):
        raise refusal
    if any(is_call(code, code.instructions[a]) for a in body):
        raise refusal
    starts = _constants(code, before, counter, [a for a in before[first] if a not in body])
    # from 0 it would count through all of 2^32
    if not starts or 0 in starts:
        raise refusal
    return Loop(first, last, frozenset(body), max(starts))


def _counter(code: MachineCode, before: Mapping[int, list[int]], last: int) -> str | None:
    """Return the register that a loop's last instruction has compared with 0, or None."""
    if not code.instructions[last].mnemonic.startswith("bne"):
        return None
    for _ in range(2):
        if len(before[last]) != 1:
            return None
        last = before[last][0]
        instruction = code.instructions[last]
        match = re.fullmatch(r"(r\d+), #0", instruction.operands)
        if instruction.mnemonic.startswith("subs"):
            return instruction.operands.partition(",")[0]
        if not (instruction.mnemonic.startswith("cmp") and match):
            return None
    return None


def _writes(instruction: Instruction, register: str) -> bool:
    name = instruction.mnemonic
    if name.startswith(("cmp", "cmn", "tst", "teq", "str", "b", "it", "push", "vcmp", "vstr")):
        return False
    if name.startswith(("umull", "smull", "umlal", "smlal", "ldrd", "vmov")):
        return re.search(rf"\b{register}\b", instruction.operands) is not None
    if "{" in instruction.operands:
        return re.search(rf"\b{register}\b", instruction.operands) is not None or "-" in instruction.operands
    return re.search(rf"\b{register}\b", instruction.operands.partition(",")[0]) is not None


def _constants(code: MachineCode, before: Mapping[int, list[int]], register: str, places: list[int]) -> set[int]:
    """Return the constants that a register can hold behind some instructions; none, where it may hold others."""
    found: set[int] = set()
    seen: set[int] = set()
    while places:
        address = places.pop()
        if address in seen:
            continue
        seen.add(address)
        instruction = code.instructions[address]
        if _writes(instruction, register):
            match = re.fullmatch(rf"{register}, #(\d+)", instruction.operands)
            if match is None or not instruction.mnemonic.startswith("mov"):
                return set()
            found.add(int(match[1]))
        elif is_call(code, instruction) or address not in before:
            return set()
        else:
            places += before[address]
    return found
