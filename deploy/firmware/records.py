"""Hold what a firmware's log tells, record by record; see sv_record.h for their bytes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

FORMAT: Final = 2
"""`SV_RECORD_FORMAT`: what the records below are."""

_VARINT_BYTES_MAX: Final = 5
_WORD: Final = 0xFFFFFFFF


@dataclass(frozen=True)
class Shape:
    """Say how many of each a rig and its controller have: a record does not.

    Args:
        njoint: joints
        nsensor: sensor channels
        ninput: terminals of the controller
        noutput: outputs of the controller
    """

    njoint: int
    nsensor: int
    ninput: int
    noutput: int


@dataclass(frozen=True)
class Hello:
    """Say what has booted, and why.

    Args:
        format: of the records
        rig: fingerprint of the rig
        program: fingerprint of the controller
        reset: `sv_reset_cause`
    """

    format: int
    rig: int
    program: int
    reset: int


@dataclass(frozen=True)
class Change:
    """Tell of a change of state.

    Args:
        t_us: since boot [us]
        left: `sv_state`
        entered: `sv_state`
        reason: `sv_reason`
        joint: number of the joint or sensor, 255: none
        a: what the reason is about, see sv_reason.h
        b: likewise
    """

    t_us: int
    left: int
    entered: int
    reason: int
    joint: int
    a: int
    b: int


@dataclass(frozen=True)
class Found:
    """Tell what a check has found.

    Args:
        t_us: since boot [us]
        finding: `sv_finding`, a warning from 32 on
        joint: number of the joint or sensor, 255: none
        address: of a register
        value: what was found
    """

    t_us: int
    finding: int
    joint: int
    address: int
    value: int


@dataclass(frozen=True)
class Started:
    """Tell what a run was asked to do.

    Args:
        t_us: since boot [us]
        goal_dist: distance of the goal, float32 [m]
        goal_bearing: its direction from the heading, float32 [rad]
        derate: part of the torque ceiling, float32
        periods: length of the run
        armed: whether torque may be switched on
    """

    t_us: int
    goal_dist: float
    goal_bearing: float
    derate: float
    periods: int
    armed: int


@dataclass(frozen=True)
class Cycle:
    """Tell of one control period.

    Args:
        t_us: when it started, since boot [us]
        k: its number
        late_us: start behind its schedule [us]
        read_us: time taken by reading [us]
        compute_us: by the control cycle [us]
        write_us: by writing, -1: goals were not sent [us]
        missed: bit a joint: its reply was missing or corrupt
        raw: counts that the cycle was given, (nraw,)
        ages_us: of each joint's reply, then of each sensor's value, -1: never read [us], (njoint + nsensor,)
        terminal_bits: float32 bits, (ninput,)
        output_bits: float32 bits, (noutput,)
        goals: goal counts, (noutput,)
    """

    t_us: int
    k: int
    late_us: int
    read_us: int
    compute_us: int
    write_us: int
    missed: int
    raw: tuple[int, ...]
    ages_us: tuple[int, ...]
    terminal_bits: tuple[int, ...]
    output_bits: tuple[int, ...]
    goals: tuple[int, ...]


@dataclass(frozen=True)
class Block:
    """Hold a block of registers that was read: a health block, or part of what the check reads.

    Args:
        t_us: since boot [us]
        joint: number of the joint
        address: of the first byte
        data: the bytes
        checked: whether the start-up check has read it
    """

    t_us: int
    joint: int
    address: int
    data: bytes
    checked: bool


@dataclass(frozen=True)
class Event:
    """Tell what happened.

    Args:
        t_us: since boot [us]
        event: `sv_event`
        a: see sv_reason.h
    """

    t_us: int
    event: int
    a: int


@dataclass(frozen=True)
class End:
    """Say how a run ended.

    Args:
        t_us: since boot [us]
        state: `sv_state`
        reason: `sv_reason`
        joint: number of the joint or sensor, 255: none
        a: what the reason is about
        b: likewise
        cycles: control periods
        missed_deadlines: periods that were not done in time
        missed_replies: replies that were missing or corrupt
        bus_bytes: sent and received
        dropped: records that did not fit the line
        unsure: bit a joint: its torque is not known to be off
    """

    t_us: int
    state: int
    reason: int
    joint: int
    a: int
    b: int
    cycles: int
    missed_deadlines: int
    missed_replies: int
    bus_bytes: int
    dropped: int
    unsure: int


Record: TypeAlias = Hello | Change | Found | Started | Cycle | Block | Event | End


def parse_record(body: bytes, shape: Shape) -> Record | None:
    """Return the record in bytes, or None if there is none.

    Args:
        body: type and body, as they were before CRC and code
        shape: of rig and controller
    """
    parse = _PARSERS.get(body[0]) if body else None
    if parse is None:
        return None
    reader = _Reader(body[1:])
    try:
        record = parse(reader, shape)
    except _ShortError:
        return None
    return record if reader.at == len(reader.data) else None


class _ShortError(Exception):
    """Say that a body is shorter than its record, or holds no number where one should stand."""


class _Reader:
    """Read numbers from a record's body, one after the other."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def take(self, size: int) -> bytes:
        if not 0 <= size <= len(self.data) - self.at:
            raise _ShortError
        self.at += size
        return self.data[self.at - size : self.at]

    def numbers(self, layout: str) -> tuple[Any, ...]:
        layout = f"<{layout}"
        return struct.unpack(layout, self.take(struct.calcsize(layout)))

    def varint(self) -> int:
        value = 0
        for place in range(_VARINT_BYTES_MAX):
            byte = self.take(1)[0]
            value |= (byte & 0x7F) << 7 * place
            if byte < 0x80 and value < 1 << 32:
                return value >> 1 ^ -(value & 1)
        raise _ShortError

    def varints(self, count: int) -> tuple[int, ...]:
        return tuple(self.varint() for _ in range(count))


def _started(reader: _Reader) -> Started:
    t_us, dist, bearing, derate = reader.numbers("qfff")
    return Started(t_us, dist, bearing, derate, *reader.varints(2))


def _cycle(reader: _Reader, shape: Shape) -> Cycle:
    (t_us,) = reader.numbers("q")
    k, late, read, compute, write, missed = reader.varints(6)
    raw = reader.varints(3 * shape.njoint + shape.nsensor)
    ages = reader.varints(shape.njoint + shape.nsensor)
    terminals, outputs = reader.numbers(f"{shape.ninput}I"), reader.numbers(f"{shape.noutput}I")
    goals = reader.varints(shape.noutput)
    return Cycle(t_us, k, late, read, compute, write, missed, raw, ages, terminals, outputs, goals)


def _block(reader: _Reader, checked: bool) -> Block:
    (t_us,) = reader.numbers("q")
    joint, address, size = reader.varints(3)
    return Block(t_us, joint, address, reader.take(size), checked)


def _end(reader: _Reader) -> End:
    (t_us,) = reader.numbers("q")
    numbers = list(reader.varints(11))
    numbers[8] &= _WORD  # a count of bytes without a sign
    return End(t_us, *numbers)


_PARSERS: Final[Mapping[int, Callable[[_Reader, Shape], Record]]] = {
    1: lambda reader, _: Hello(*reader.numbers("BIIB")),
    2: lambda reader, _: Change(*reader.numbers("q"), *reader.varints(6)),
    3: lambda reader, _: Found(*reader.numbers("q"), *reader.varints(4)),
    4: lambda reader, _: _started(reader),
    5: _cycle,
    6: lambda reader, _: _block(reader, False),
    7: lambda reader, _: Event(*reader.numbers("q"), *reader.varints(2)),
    8: lambda reader, _: _end(reader),
    9: lambda reader, _: _block(reader, True),
}
"""Number of `sv_record_type` => what reads the body of such a record."""
