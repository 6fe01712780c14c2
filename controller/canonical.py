"""The canonical form of a program, and its hash."""

from __future__ import annotations

import hashlib

from controller.program import INSTRUCTION, Program


def canonical_bytes(program: Program) -> bytes:
    """Serialise a program: equal bytes, equal behaviour.

    Terminal names and their order count; formatting and the names of definitions are gone since lowering.

    Args:
        program: the program

    Returns:
        the bytes, little endian
    """
    head = f"servolve program 1\n{' '.join(program.inputs)}\n{len(program.constants)} {len(program.instructions)} "
    return b"".join(
        (
            f"{head}{program.nstate} {len(program.outputs)}\n".encode(),
            program.constants.astype("<f4", copy=False).tobytes(),
            program.instructions.astype(INSTRUCTION, copy=False).tobytes(),
            program.outputs.astype("<u2", copy=False).tobytes(),
        )
    )


def program_hash(program: Program) -> str:
    """Return the SHA-256 of a program's canonical form, in hex.

    Args:
        program: the program

    Returns:
        64 hex digits
    """
    return hashlib.sha256(canonical_bytes(program)).hexdigest()
