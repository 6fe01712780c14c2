"""Machine code of a controller: linked by itself, with what it calls, and read back instruction by instruction."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from controller.errors import RunError

_HEADER: Final = re.compile(r"^([0-9a-f]+) <([^>]+)>:$")
_LINE: Final = re.compile(r"^ +([0-9a-f]+):\t([0-9a-f ]+?) *\t([a-z][\w.]*)(?:\t([^@;<]*)(?:<([^>]*)>)?)?")
_DUMP: Final = re.compile(r"^ [0-9a-f]+ ((?:[0-9a-f]{2,8} ){1,4})", re.M)
_LITERAL: Final = re.compile(r"^ +([0-9a-f]+):\t[0-9a-f ]+\t\.word\t0x([0-9a-f]+)", re.M)
_SECTION: Final = re.compile(r"^\s*\d+ (\.\S+)\s+([0-9a-f]+) ", re.M)
_SYMBOL: Final = re.compile(r"^([0-9a-f]+) ([0-9a-f]+) [Tt] (\S+)$", re.M)


@dataclass(frozen=True)
class Instruction:
    """Hold one instruction.

    Args:
        address: where it is [bytes]
        size: how long it is [bytes]
        mnemonic: as objdump prints it, condition and width included
        operands: as objdump prints them
    """

    address: int
    size: int
    mnemonic: str
    operands: str

    @property
    def target(self) -> int:
        """Return the address that a branch names, its last operand."""
        return int(self.operands.split(",")[-1].strip(), 16)


@dataclass(frozen=True, eq=False)
class MachineCode:
    """Hold a linked controller without its selftest.

    Args:
        compiler: the first line of the compiler's version
        instructions: by address
        literals: words among the instructions, by address
        entries: address of each function, by name
        sizes: length of each function, literals included, by name [bytes]
        text_bytes: code and constants together
        data_bytes: writable memory outside the state structure
        constant_words: constants that are not in the functions' own literals, as little-endian words
    """

    compiler: str
    instructions: dict[int, Instruction]
    literals: dict[int, int]
    entries: dict[str, int]
    sizes: dict[str, int]
    text_bytes: int
    data_bytes: int
    constant_words: tuple[int, ...]

    @property
    def constant_bytes(self) -> int:
        """Return the size of the constants that are not in the functions' own literals."""
        return 4 * len(self.constant_words)

    @cached_property
    def loads_constants_by_register(self) -> bool:
        """Return whether a load that names no pc may read constants, too."""
        return bool(self.constant_words) or any(
            line.mnemonic.startswith("adr") or line.operands.endswith("pc") or ", pc," in line.operands
            for line in self.instructions.values()
        )

    @cached_property
    def entry_addresses(self) -> frozenset[int]:
        """Return the addresses that functions begin at."""
        return frozenset(self.entries.values())

    def name_of(self, address: int) -> str:
        """Return the name of the function at an address, or the address in hex."""
        return next((name for name, entry in self.entries.items() if entry == address), f"{address:#x}")


def read_machine_code(image: Path, tools: str, compiler: str) -> MachineCode:
    """Disassemble a linked image.

    Args:
        image: the ELF file
        tools: what the names of the tools begin with, as "arm-none-eabi-"
        compiler: the first line of the compiler's version

    Raises:
        RunError: a tool is missing, or fails
    """
    listing = run_tool([f"{tools}objdump", "-d", "--wide", image.name], image.parent)
    instructions = {}
    for line in listing.splitlines():
        match = _LINE.match(line)
        if match and not match[3].startswith("."):
            size = len(match[2].replace(" ", "")) // 2
            address = int(match[1], 16)
            instructions[address] = Instruction(address, size, match[3], (match[4] or "").strip())
    symbols = _SYMBOL.findall(run_tool([f"{tools}nm", "-S", image.name], image.parent))
    headers = [_HEADER.match(line) for line in listing.splitlines()]
    entries = {match[2]: int(match[1], 16) for match in headers if match}
    # objdump names an address once, nm gives all names that it has
    entries |= {name: int(address, 16) & ~1 for address, _, name in symbols}
    sections = {
        name: int(size, 16)
        for name, size in _SECTION.findall(run_tool([f"{tools}objdump", "-h", image.name], image.parent))
    }
    constants = sum(size for name, size in sections.items() if name.startswith(".rodata"))
    dump = run_tool([f"{tools}objdump", "-s", "-j", ".rodata", image.name], image.parent) if constants else ""
    words = [word for row in _DUMP.findall(dump) for word in row.split()]
    return MachineCode(
        compiler=compiler,
        instructions=instructions,
        literals={int(address, 16): int(word, 16) for address, word in _LITERAL.findall(listing)},
        entries=entries,
        sizes={name: int(size, 16) for _, size, name in symbols},
        text_bytes=constants + sum(size for name, size in sections.items() if name.startswith(".text")),
        data_bytes=sum(size for name, size in sections.items() if name.startswith((".data", ".bss"))),
        constant_words=tuple(int.from_bytes(bytes.fromhex(word), "little") for word in words),
    )


def run_tool(command: list[str], folder: Path) -> str:
    """Run a tool of a tool chain and return what it prints.

    Args:
        command: the tool and its arguments
        folder: where it runs

    Raises:
        RunError: it is missing, or fails
    """
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    except FileNotFoundError:
        raise RunError(f"there is no {command[0]} here; install it: apt-get install binutils-arm-none-eabi") from None
    if done.returncode != 0:
        raise RunError(f"{' '.join(command)} failed: {done.stderr.strip().splitlines()[-1:]}")
    return done.stdout
