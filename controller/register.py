"""One item of a servo's control table, and how its count travels as bytes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

Encoding: TypeAlias = Literal["unsigned", "twos", "sign15", "sign11", "sign10"]
"""Unsigned, two's complement, or a magnitude with its sign in bit 15, 11 or 10."""

TURN_4096: Final = 2.0 * math.pi / 4096.0
"""[rad] a count of an encoder that has 4096 to the turn."""

REV_MIN: Final = 2.0 * math.pi / 60.0
"""[rad/s] a revolution per minute."""

_SIGN_BITS: Final = {"sign15": 15, "sign11": 11, "sign10": 10}


@dataclass(frozen=True)
class Register:
    """Describe one item of a control table.

    Args:
        name: snake-case name, as "present_position"
        address: first byte
        size: bytes
        access: "r" or "rw"
        encoding: how negative counts are written
        unit: of one scaled count, "1" where there is none
        scale: unit per count
        low: smallest count that may be written (for "r": smallest that the size holds)
        high: largest count that may be written
        initial: factory or power-up count
        eeprom: kept without power, and locked while torque is on
        source: where the line comes from, with conflicts between sources
        byte_order: which byte comes first, that of the low or of the high bits
    """

    name: str
    address: int
    size: int
    access: Literal["r", "rw"]
    encoding: Encoding
    unit: str
    scale: float
    low: int
    high: int
    initial: int
    eeprom: bool
    source: str
    byte_order: Literal["little", "big"] = "little"

    @property
    def signed(self) -> bool:
        """Return whether it holds negative counts."""
        return self.encoding != "unsigned"

    @property
    def sign_bit(self) -> int | None:
        """Return the bit that holds the sign of a magnitude, None for another encoding."""
        return _SIGN_BITS.get(self.encoding)


@dataclass(frozen=True)
class RegisterLine:
    """Write the lines of a control table.

    Args:
        source: of the lines that name none
    """

    source: str

    def __call__(
        self,
        kind: Literal["E", "R"],
        address: int,
        size: int,
        name: str,
        access: Literal["r", "rw"],
        initial: int,
        low: int,
        high: int,
        unit: str = "1",
        scale: float = 1.0,
        source: str | None = None,
        encoding: Encoding | None = None,
    ) -> Register:
        """Return a register, of kind "E" (EEPROM) or "R" (RAM); negative counts are two's complement unless said."""
        encoding = encoding or ("twos" if low < 0 else "unsigned")
        source = self.source if source is None else source
        return Register(name, address, size, access, encoding, unit, scale, low, high, initial, kind == "E", source)


def decode_register(register: Register, data: bytes) -> int:
    """Return the count that a register's bytes hold.

    Bits above a magnitude's sign are ignored, and so is the sign of 0.

    Args:
        register: the register
        data: its bytes, (register.size,)

    Returns:
        the count
    """
    value = int.from_bytes(data, register.byte_order, signed=register.encoding == "twos")
    bit = register.sign_bit
    if bit is None:
        return value
    magnitude = value & ((1 << bit) - 1)
    return -magnitude if value >> bit & 1 else magnitude


def encode_register(register: Register, value: int) -> bytes:
    """Return the bytes that hold a register's count.

    Args:
        register: the register
        value: its count

    Returns:
        its bytes, (register.size,)

    Raises:
        ValueError: the count does not fit the register
    """
    bit = register.sign_bit
    bits = 8 * register.size if bit is None else bit
    low = 0 if register.encoding == "unsigned" else -(1 << bits - 1) if bit is None else 1 - (1 << bits)
    high = (1 << bits - 1) - 1 if register.encoding == "twos" else (1 << bits) - 1
    if not low <= value <= high:
        raise ValueError(f"{register.name}: count {value} is outside {low} to {high}")
    if bit is None:
        return value.to_bytes(register.size, register.byte_order, signed=register.encoding == "twos")
    return (abs(value) | (value < 0) << bit).to_bytes(register.size, register.byte_order)
