"""The order of bus transactions in a period, from the same C code that the firmware runs."""

from __future__ import annotations

from ctypes import byref
from dataclasses import dataclass
from enum import IntEnum

from controller.library import HEALTH_MAX, SvBlock, SvSchedule, SvTransaction, library
from controller.registers import registers
from controller.rig import Rig


class TransactionKind(IntEnum):
    """Name the kinds of `sv_transaction_kind` of `runtime/sv_schedule.h`."""

    READ_STATE = 0
    RUN_CYCLE = 1
    WRITE_GOALS = 2
    READ_HEALTH = 3


@dataclass(frozen=True)
class Transaction:
    """Describe one step of a period.

    Args:
        kind: what happens
        servo: index of the rig's joint for a health read, -1: all joints
        address: first register read or written
        size: bytes read or written for each servo, 0: none
    """

    kind: TransactionKind
    servo: int
    address: int
    size: int


@dataclass(frozen=True)
class Schedule:
    """Describe what is read and written in a run: `sv_schedule` of `runtime/sv_schedule.h`.

    Args:
        nservo: servos on the bus
        state: (address, size) of the block read from every servo in every period
        goal: (address, size) of the block written to every servo in every period
        health: (address, size) of the blocks read from one servo at a time, at most 4
        health_every: periods from one health read to the next
    """

    nservo: int
    state: tuple[int, int]
    goal: tuple[int, int]
    health: tuple[tuple[int, int], ...]
    health_every: int = 1


def schedule_of(rig: Rig) -> Schedule:
    """Return the schedule of a rig: its servos' position, velocity and load, goals, and health registers.

    The servos of a line share their blocks. Those without sync read are asked for their state one by one, in bus order.

    Args:
        rig: the rig

    Returns:
        the schedule
    """
    joint = rig.joints[0]
    table, family, goal = registers(joint.product), joint.family, joint.family.goal(joint.mode)

    def block(first: str, last: str) -> tuple[int, int]:
        return table[first].address, table[last].address + table[last].size - table[first].address

    return Schedule(
        nservo=len(rig.joints),
        state=block(*family.state),
        goal=block(goal, goal),
        health=tuple(block(*names) for names in family.health),
    )


def period(schedule: Schedule, k: int) -> tuple[Transaction, ...]:
    """List what happens in one period, in order.

    Args:
        schedule: the schedule
        k: periods since the start

    Returns:
        the transactions: read, cycle, write, and in some periods one health read
    """
    packed = SvSchedule(
        schedule.nservo,
        SvBlock(*schedule.state),
        SvBlock(*schedule.goal),
        len(schedule.health),
        (SvBlock * HEALTH_MAX)(*(SvBlock(*block) for block in schedule.health)),
        schedule.health_every,
    )
    due = SvTransaction()
    listed: list[Transaction] = []
    while library().sv_schedule_due(byref(packed), k, len(listed), byref(due)):
        kind, block = TransactionKind(due.kind), due.block[0]
        address, size = (0, 0) if kind == TransactionKind.RUN_CYCLE else (block.address, block.size)
        listed.append(Transaction(kind, due.servo, address, size))
    return tuple(listed)
