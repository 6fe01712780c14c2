"""Servo control tables: one line a register, from which codecs, checks, pages and the virtual servos are derived."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from controller import registers_ax, registers_feetech, registers_x
from controller.products import Product
from controller.register import Encoding, Register, decode_register, encode_register
from controller.registers_x import X330_BAUD, X330_OPERATING_MODES

__all__ = [
    "X330_BAUD",
    "X330_OPERATING_MODES",
    "Encoding",
    "Register",
    "decode_register",
    "encode_register",
    "registers",
]

_TABLES: Final[Mapping[str, Mapping[str, Register]]] = MappingProxyType(
    {**registers_x.TABLES, **registers_ax.TABLES, **registers_feetech.TABLES}
)


def registers(product: Product) -> Mapping[str, Register]:
    """Return a product's control table by register name, in order of address.

    Args:
        product: the servo

    Returns:
        name => register
    """
    return _TABLES[product.name]
