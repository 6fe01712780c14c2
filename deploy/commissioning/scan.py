"""Find every servo on a port, at all bit rates and in all protocols, without writing to any.

A machine that is busy with something else may let an answer come too late. So those who did not answer are asked once
more, with patience, where others did, and at the likeliest bit rates if nobody did.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from controller.errors import InputError
from controller.families import FAMILIES, family_of
from controller.products import PRODUCTS, Product
from controller.registers import decode_register, registers
from deploy.buses.pings import broadcast_ping, ping_each
from deploy.buses.port import SerialPort
from deploy.buses.servo_bus import BusError, ServoBus
from deploy.buses.table_reader import read_table

Framing: TypeAlias = Literal["dynamixel-2.0", "protocol-1"]
"""What servos must share to be asked together: Dynamixel 1.0 and Feetech ask for an answer with the same packet."""

PROTOCOLS: Final = ("dynamixel-2.0", "dynamixel-1.0", "feetech")
_READS: Final = 5
_HEAD_BYTES: Final = 6
_RETURN_DELAY_S: Final = 508e-6
"""The longest that a servo can be set to wait before it answers [s]."""
_FIRST_BAUDS: Final = (1_000_000, 57_600, 115_200)
"""What servos are shipped with, or mostly set to."""
_AGAIN_S: Final = 3.0
"""When the second pass asks nobody else [s]."""
_AGAIN_PATIENCE_S: Final = 0.1
"""How late the last answer of the second pass may be [s]."""


@dataclass(frozen=True)
class Found:
    """Hold one servo that answered.

    Args:
        id: its id
        baud: bit rate at which it answers [bits/s]
        protocol: "dynamixel-2.0", "dynamixel-1.0" or "feetech", "?" if it can not be told
        model: model number, 0 if it could not be read
        products: names of the products with that number, () if none is known
        shared: whether another servo answers to the same id
        values: register name => count, for a known product
    """

    id: int
    baud: int
    protocol: str
    model: int
    products: tuple[str, ...] = ()
    shared: bool = False
    values: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """Hold what is asked next, or was asked: one bit rate in one framing.

    Args:
        framing: of the questions
        baud: [bits/s]
        found: who answered, None before anybody was asked
        skipped: why nobody could be asked, "" if they were
        again: whether it is a second time, for those who were missing; `found` has only them then
    """

    framing: Framing
    baud: int
    found: tuple[Found, ...] | None = None
    skipped: str = ""
    again: bool = False


def scan_steps(protocols: Collection[str] = PROTOCOLS, bauds: Collection[int] = ()) -> list[tuple[Framing, int]]:
    """Return which bit rates are to be asked in which framing, the likeliest first.

    Args:
        protocols: those to look for
        bauds: the only bit rates to ask at; empty: all that servos of these protocols can be set to [bits/s]
    """
    offered: dict[Framing, set[int]] = {}
    for family in FAMILIES.values():
        if family.protocol in protocols:
            offered.setdefault(_framing(family.protocol), set()).update(family.bauds.values())
    steps = [(framing, baud) for framing, rates in offered.items() for baud in (bauds or rates)]
    return sorted(set(steps), key=lambda step: (_eagerness(step[1]), step[0], -step[1]))


def scan(
    open_port: Callable[[int], SerialPort],
    steps: Sequence[tuple[Framing, int]],
    ids: Collection[int] = (),
) -> Iterator[Step]:
    """Ask at one bit rate after the other who is there.

    Args:
        open_port: opens the port at a bit rate
        steps: as `scan_steps` gives them
        ids: the only ids to tell of; empty: all

    Yields:
        each step twice: before and after it; then those that are asked again

    Raises:
        InputError: the port can not be opened at any bit rate
    """
    refused: list[InputError] = []
    asked: list[Step] = []
    for framing, baud in steps:
        yield Step(framing, baud)
        try:
            port = open_port(baud)
        except InputError as error:
            refused.append(error)
            if len(refused) == len(steps):
                raise
            yield Step(framing, baud, (), "the port does not offer this bit rate")
            continue
        with closing(_bus(framing, port)) as bus:
            answered = _who(bus, framing, _possible(ids))
            asked.append(Step(framing, baud, _servos(bus, framing, baud, answered)))
        yield asked[-1]
    yield from _ask_again(open_port, asked, ids)


def found_servos(steps: Iterable[Step]) -> list[Found]:
    """Return every servo once, in the order of the steps; of one that was asked again, what it said last.

    Args:
        steps: as `scan` yields them
    """
    found: dict[tuple[Framing, int], dict[int, Found]] = {}
    for step in steps:
        found.setdefault((step.framing, step.baud), {}).update({servo.id: servo for servo in step.found or ()})
    return [servo for servos in found.values() for _, servo in sorted(servos.items())]


def _ask_again(open_port: Callable[[int], SerialPort], asked: Sequence[Step], ids: Collection[int]) -> Iterator[Step]:
    """Ask those who did not answer once more, for a while: where others did, or where servos most likely are."""
    likely = [step for step in asked if step.found] or [step for step in asked if step.baud in _FIRST_BAUDS]
    until_s: float | None = None
    for step in likely:
        sound = {servo.id for servo in step.found or () if servo.shared or servo.values or not servo.products}
        missing = [servo for servo in _possible(ids) if servo not in sound]
        if not missing:
            continue
        yield Step(step.framing, step.baud, again=True)
        try:
            port = open_port(step.baud)
        except InputError:  # somebody has unplugged it, or taken it
            return
        with closing(_bus(step.framing, port)) as bus:
            until_s = bus.port.now() + _AGAIN_S if until_s is None else until_s
            bus.port.latency_s = max(bus.port.latency_s, _AGAIN_PATIENCE_S)
            answered = _who(bus, step.framing, missing, until_s)
            found = _servos(bus, step.framing, step.baud, answered)
            over = bus.port.now() >= until_s
        yield Step(step.framing, step.baud, found, again=True)
        if over:
            return


def _possible(ids: Collection[int]) -> Sequence[int]:
    return sorted(ids) or range(1 + max(family.id_max for family in FAMILIES.values()))


def _servos(bus: ServoBus, framing: Framing, baud: int, answered: Mapping[int, int]) -> tuple[Found, ...]:
    servos = (_identify(bus, framing, baud, servo, model) for servo, model in sorted(answered.items()))
    return tuple(servo for servo in servos if servo is not None)


def _framing(protocol: str) -> Framing:
    return "dynamixel-2.0" if protocol == "dynamixel-2.0" else "protocol-1"


def _eagerness(baud: int) -> int:
    return _FIRST_BAUDS.index(baud) if baud in _FIRST_BAUDS else len(_FIRST_BAUDS)


def _bus(framing: Framing, port: SerialPort) -> ServoBus:
    from deploy.buses.dynamixel1_bus import Dynamixel1Bus
    from deploy.buses.dynamixel_bus import DynamixelBus

    # a Feetech servo's reads are Dynamixel 1.0's
    return (DynamixelBus if framing == "dynamixel-2.0" else Dynamixel1Bus)(port, _RETURN_DELAY_S)


def _who(bus: ServoBus, framing: Framing, possible: Sequence[int], until_s: float = math.inf) -> dict[int, int]:
    """Return id => model number, 0 where it is not known yet, of all that answer in some way."""
    if framing == "protocol-1":
        answers = ping_each(bus.port, possible, until_s)
    else:
        answers = broadcast_ping(bus.port)
    models = {servo: model for servo, model in answers.models.items() if servo in possible}
    if answers.garbled:
        # somebody was not understood: ask each alone, and take noise for an answer too
        for servo in possible:
            if bus.port.now() < until_s and servo not in models and bus.ping(servo)[0].status != "missing":
                models[servo] = 0
    return models


def _identify(bus: ServoBus, framing: Framing, baud: int, servo: int, model: int) -> Found | None:
    """Find out what a servo is, and whether it is alone with its id; return None if it was no servo."""
    if framing == "dynamixel-2.0":
        if not model:
            reply, model = bus.ping(servo)
            if reply.status != "data":
                return Found(servo, baud, framing, 0, shared=True)
        products = [product for product in PRODUCTS.values() if _protocol(product) == framing]
        products = [product for product in products if product.model_number == model]
        return _read(bus, Found(servo, baud, framing, model), products)
    reads = [bus.read(servo, 0, _HEAD_BYTES) for _ in range(_READS)]
    head = next((reply.data for reply in reads if reply.status == "data"), None)
    if head is None:
        corrupt = any(reply.status == "corrupt" for reply in reads)
        return Found(servo, baud, "?", 0, shared=True) if corrupt else None
    products = [product for product in PRODUCTS.values() if _fits(product, servo, head)]
    if products:
        found = Found(servo, baud, _protocol(products[0]), products[0].model_number)
    elif head[5] == servo:
        found = Found(servo, baud, "feetech", int.from_bytes(head[3:5], "little"))
    else:
        found = Found(servo, baud, "dynamixel-1.0", int.from_bytes(head[:2], "little"))
    return _read(bus, found, products)


def _read(bus: ServoBus, found: Found, products: Sequence[Product]) -> Found:
    """Read what the servo is set to. Two servos that say different things at once are not understood."""
    if not products:
        return found
    replies = [bus.read(found.id, *_spoken(products[0])) for _ in range(_READS)]
    lost = sum(reply.status == "corrupt" for reply in replies)
    values: dict[str, int] = {}
    if 2 * lost <= _READS:
        with suppress(BusError):
            values = read_table(bus, found.id, products[0])
    names = tuple(product.name for product in products)
    return Found(found.id, found.baud, found.protocol, found.model, names, 2 * lost > _READS, values)


def _spoken(product: Product) -> tuple[int, int]:
    """Return address and length of the block in which two servos of one kind hardly ever say the same."""
    family, table = family_of(product), registers(product)
    lines = [table[name] for name in (*family.state, family.voltage, family.temperature)]
    first = min(line.address for line in lines)
    return first, max(line.address + line.size for line in lines) - first


def _fits(product: Product, servo: int, head: bytes) -> bool:
    """Return whether the first bytes of a control table are a product's, of a servo with this id."""
    if _framing(_protocol(product)) != "protocol-1":
        return False
    table = registers(product)
    values = [decode_register(line, head[line.address :][: line.size]) for line in (table["model_number"], table["id"])]
    return values == [product.model_number, servo]


def _protocol(product: Product) -> str:
    return FAMILIES[product.family].protocol
