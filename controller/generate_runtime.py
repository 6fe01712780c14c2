"""Write `runtime/sv_operations.inc`, the table of operations as C; run as ``python -m controller.generate_runtime``."""

from __future__ import annotations

import sys
import zlib
from pathlib import Path
from typing import Final

from controller.operations import OPERATIONS, Operation

PATH: Final = Path(__file__).resolve().parent / "runtime" / "sv_operations.inc"

_SYMBOLS: Final = {"+": "ADD", "-": "SUBTRACT", "*": "MULTIPLY", "%": "DIVIDE"}
_OPERANDS: Final = "abc"


def fingerprint() -> int:
    """Return a CRC-32 of the table: a library built from another table is told by it."""
    rows = [f"{o.name} {o.opcode} {o.arity} {o.nstate} {o.c}" for o in OPERATIONS]
    return zlib.crc32("\n".join(rows).encode())


def symbol(operation: Operation) -> str:
    """Return the C name of an operation's opcode.

    Args:
        operation: the operation

    Returns:
        as "SV_OP_OSC_WAVE"
    """
    name = _SYMBOLS.get(operation.name) or operation.name.upper().replace("-", "_")
    return f"SV_OP_{name}"


def runtime_text() -> str:
    """Return the text of the generated file."""
    enum = [f"  {symbol(o)} = {o.opcode},  // {o.summary}" for o in OPERATIONS]
    table = [f"  {{{o.arity}, {o.nstate}}},  // {symbol(o)}" for o in OPERATIONS]
    assert [o.opcode for o in OPERATIONS] == list(range(1, len(OPERATIONS) + 1))
    lines = [
        "// Generated from controller/operations.py by `python -m controller.generate_runtime`: do not edit.",
        "",
        "#if defined(SV_OPERATIONS_ENUM)",
        *enum,
        f"  SV_OP_END = {len(OPERATIONS) + 1}",
        "#elif defined(SV_OPERATIONS_TABLE)",
        "  {0, 0},  // no operation",
        *table,
        "#elif defined(SV_OPERATIONS_CASES)",
        *(line for operation in OPERATIONS for line in _case(operation)),
        "#else",
        f"#define SV_OPERATIONS_FINGERPRINT 0x{fingerprint():08x}U",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _case(operation: Operation) -> list[str]:
    operands = _OPERANDS[: operation.arity]
    state = f"(state + in->{'abc'[operation.arity]})" if operation.nstate else ""
    value = operation.c.format(a="a", b="b", c="c", s=state, dt="dt")
    loads = [f"  const float {operand} = registers[in->{operand}];" for operand in operands]
    return [f"case {symbol(operation)}: {{", *loads, f"  *result = {value};", "  break;", "}"]


def main() -> int:
    """Write the file, or with `--check` only say whether it is up to date.

    Returns:
        exit status; 1: it is not
    """
    if sys.argv[1:] == ["--check"]:
        if PATH.read_text(encoding="utf-8") == runtime_text():
            return 0
        sys.stderr.write(f"{PATH} is out of date; write it anew with `python -m controller.generate_runtime`\n")
        return 1
    PATH.write_text(runtime_text(), encoding="utf-8")
    sys.stderr.write(f"wrote {PATH}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
