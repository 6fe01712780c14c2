"""Read all that a servo's registers hold, in few questions, whatever it thinks of the bytes between them."""

from __future__ import annotations

from collections.abc import Iterator

from controller.products import Product
from controller.registers import Register, decode_register, registers
from deploy.buses.servo_bus import BusError, ServoBus

_ATTEMPTS = 3
_BLOCK_BYTES_MAX = 64
_GAP_BYTES_MAX = 8


def read_table(bus: ServoBus, servo: int, product: Product) -> dict[str, int]:
    """Read every register of a servo that it lets be read.

    Args:
        bus: the bus, at the servo's bit rate
        servo: its id
        product: what it is

    Returns:
        register name => count

    Raises:
        BusError: it does not answer
    """
    values: dict[str, int] = {}
    for block in _blocks(product):
        read = _read(bus, servo, block)
        for single in [[line] for line in block] if read is None else []:
            read = (read or {}) | (_read(bus, servo, single) or {})
        values |= read or {}
    return values


def _blocks(product: Product) -> Iterator[list[Register]]:
    """Yield registers that lie close together: a servo may refuse addresses at which it has nothing."""
    block: list[Register] = []
    for line in sorted(registers(product).values(), key=lambda line: line.address):
        end = block[-1].address + block[-1].size if block else 0
        far = bool(block) and line.address - end >= _GAP_BYTES_MAX
        if block and (far or line.address + line.size - block[0].address > _BLOCK_BYTES_MAX):
            yield block
            block = []
        block.append(line)
    yield block


def _read(bus: ServoBus, servo: int, block: list[Register]) -> dict[str, int] | None:
    """Read registers with one question, or return None if the servo refuses it."""
    first, size = block[0].address, block[-1].address + block[-1].size - block[0].address
    for _ in range(_ATTEMPTS):
        reply = bus.read(servo, first, size)
        if reply.status == "refused":
            return None
        if reply.status == "data":
            return {line.name: decode_register(line, reply.data[line.address - first :][: line.size]) for line in block}
    raise BusError(
        f"servo {servo} on {bus.port.label}: its registers can not be read; check cables and power and try again"
    )
