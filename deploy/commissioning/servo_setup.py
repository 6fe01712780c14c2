"""Give a servo another id and bit rate: found first, refused where another has them, and read back where it is then.

A servo answers such a write from where it was, and the next question where it is now. Between the two writes it stands
at its new id and its old bit rate, so nobody else may be there either.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass

from controller.errors import InputError, RunError
from controller.families import family_of
from controller.products import Product
from controller.register import Register, encode_register
from controller.registers import registers
from deploy.buses.open_bus import open_protocol
from deploy.buses.port import PortLostError, SerialPort
from deploy.buses.servo_bus import BusError, ServoBus
from deploy.commissioning.scan import Found, found_servos, scan, scan_steps
from deploy.finding import Fix

_RETURN_DELAY_S = 508e-6
"""The longest that a servo can be set to wait before it answers [s]."""
_PATIENCE_S = 0.1
_WRITE_S = 0.05
"""What a servo may take to put a byte into its EEPROM, and to go by it: an estimate [s]."""

OpenPort = Callable[[int], SerialPort]


@dataclass(frozen=True)
class Place:
    """Say where a servo answers.

    Args:
        id: its id
        baud: its bit rate [bits/s]
    """

    id: int
    baud: int


def find_servo(open_port: OpenPort, product: Product, servo: int | None, bauds: Collection[int]) -> Found:
    """Find the servo that is to be set up.

    Args:
        open_port: opens the port at a bit rate
        product: what it is
        servo: its id; None: it is the only one there
        bauds: bit rates at which to look [bits/s]

    Returns:
        the servo

    Raises:
        InputError: it is not there, or is not that product, or not the only one
    """
    ids = [] if servo is None else [servo]
    found = _scan(open_port, product, bauds, ids)
    named = "a servo" if servo is None else f"servo {servo}"
    if not found:
        rates = "the bit rate given" if len(bauds) == 1 else f"{len(bauds)} bit rates"
        raise InputError(f"{named} does not answer at {rates}; check power, cable and product, or let `rig scan` look")
    shared = next((one for one in found if one.shared), None)
    if shared is not None:
        raise InputError(f"several servos answer to id {shared.id}; connect only the one that is to be set up")
    if len(found) > 1:
        places = ", ".join(f"{one.id} at {one.baud} bit/s" for one in found)
        raise InputError(f"several servos answer: {places}; connect only one, or name it with --id and --baud")
    if product.name not in found[0].products:
        known = " or ".join(found[0].products) or f"model {found[0].model}"
        raise InputError(f"servo {found[0].id} is no {product.name} but {known}; name that with --product")
    if not found[0].values:
        raise InputError(f"servo {found[0].id} answers, but can not be read; check cables and power and try again")
    return found[0]


def require_free(open_port: OpenPort, product: Product, old: Place, new: Place) -> None:
    """Refuse an id that another servo has, where this one will be and where it passes through.

    Args:
        open_port: opens the port at a bit rate
        product: what the servo is
        old: where it answers
        new: where it shall answer

    Raises:
        InputError: somebody answers there, or the port does not offer the bit rate
    """
    for baud in sorted({old.baud, new.baud}):
        if Place(new.id, baud) == old:
            continue
        try:
            others = _scan(open_port, product, [baud], [new.id])
        except InputError as error:
            raise InputError(f"{error}; so the servo could not be set to {baud} bit/s") from None
        if others:
            raise InputError(
                f"a servo answers to id {new.id} at {baud} bit/s already; choose another id, or disconnect that servo"
            )


def changes(product: Product, found: Found, old: Place, new: Place) -> list[Fix]:
    """Return the registers that are to be written, in their order.

    Args:
        product: what the servo is
        found: what it holds
        old: where it answers
        new: where it shall answer

    Raises:
        InputError: the product knows no such id or bit rate, or its EEPROM is locked until it is switched off
    """
    family, table = family_of(product), registers(product)
    line = table[family.id]
    counts = {baud: count for count, baud in family.bauds.items()}
    if not line.low <= new.id <= line.high:
        raise InputError(f"id {new.id}: a {product.name} takes {line.low} to {line.high}; choose one of them")
    fixes = []
    if new.id != old.id:
        fixes.append(Fix(old.id, family.id, found.values[family.id], new.id, "its id"))
    if new.baud != old.baud:
        if new.baud not in counts:
            offered = ", ".join(str(baud) for baud in sorted(counts))
            raise InputError(f"{new.baud} bit/s: a {product.name} takes {offered}; choose one of them")
        held = found.values[family.baud_rate]
        fixes.append(Fix(old.id, family.baud_rate, held, counts[new.baud], f"{old.baud} to {new.baud} bit/s"))
    if fixes and family.protocol != "feetech" and family.lock is not None and found.values.get(family.lock):
        raise InputError(
            f"servo {old.id} has its EEPROM locked until it is switched off; do so, then on, and try again"
        )
    return fixes


def move_servo(port: SerialPort, product: Product, old: Place, new: Place, told: Callable[[str], None]) -> None:
    """Write id and bit rate, torque off first, and see that the servo answers where it should.

    Args:
        port: open at the old bit rate; closed afterwards
        product: what the servo is
        old: where it answers
        new: where it shall answer
        told: called with the register after each change that was read back

    Raises:
        RunError: it did not take a change; says where it answers now, if it does
    """
    family, table = family_of(product), registers(product)
    port.latency_s = max(port.latency_s, _PATIENCE_S)
    lock = table[family.lock] if family.protocol == "feetech" and family.lock is not None else None
    with closing(open_protocol(port, family.bus_protocol, _RETURN_DELAY_S)) as bus:
        try:
            try:
                bus.write_register(old.id, table[family.torque_enable], 0)
                if lock is not None:
                    bus.write_register(old.id, lock, 0)
                if new.id != old.id:
                    _write(bus, table[family.id], old, new.id, Place(new.id, old.baud))
                    told(family.id)
                if new.baud != old.baud:
                    count = next(count for count, baud in family.bauds.items() if baud == new.baud)
                    _write(bus, table[family.baud_rate], Place(new.id, old.baud), count, new)
                    told(family.baud_rate)
            finally:
                if lock is not None:
                    _close_lock(bus, lock, (new, Place(new.id, old.baud), old))
            reply, model = bus.ping(new.id)
            if reply.status != "data" or model != product.model_number:
                raise BusError(f"servo {new.id} does not answer a ping at {new.baud} bit/s")
        except (BusError, PortLostError) as error:
            raise RunError(f"{error}; {_whereabouts(bus, product, (new, Place(new.id, old.baud), old))}") from None


def _scan(open_port: OpenPort, product: Product, bauds: Collection[int], ids: Sequence[int]) -> list[Found]:
    steps = scan_steps((family_of(product).protocol,), bauds)
    return found_servos(step for step in scan(open_port, steps, ids) if step.found is not None)


def _write(bus: ServoBus, register: Register, at: Place, count: int, then: Place) -> None:
    """Write what moves a servo, and read it back where it is then; its answer to the write may be lost."""
    reply = bus.write(at.id, register.address, encode_register(register, count))
    if reply.status == "refused":
        raise BusError(f"servo {at.id} refused {count} for {register.name}: {reply.refusal}")
    bus.port.wait(bus.port.now() + _WRITE_S)
    if then.baud != at.baud:
        bus.port.setupPort(then.baud)
    held = bus.read_register(then.id, register)
    if held != count:
        raise BusError(f"servo {then.id}: {register.name} reads {held} after {count} was written")


def _close_lock(bus: ServoBus, lock: Register, places: Sequence[Place]) -> None:
    """Close a Feetech servo's lock wherever it is now."""
    for place in places:
        with suppress(BusError, PortLostError, InputError):
            bus.port.setupPort(place.baud)
            bus.write_register(place.id, lock, 1)
            return


def _whereabouts(bus: ServoBus, product: Product, places: Sequence[Place]) -> str:
    """Say where a servo answers after something went wrong."""
    for place in places:
        with suppress(PortLostError, InputError):
            bus.port.setupPort(place.baud)
            if any(bus.ping(place.id)[1] == product.model_number for _ in range(2)):
                return f"it answers to id {place.id} at {place.baud} bit/s now; try again from there"
    return "it does not answer now; switch it off and on, and let `servolve rig scan` look for it"
