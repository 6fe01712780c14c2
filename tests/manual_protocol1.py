"""What a master may expect of AX-12A, STS and SCS servos, by their manuals: none of the servos' own code is here.

Sources: ROBOTIS e-Manual, protocol1.md and ax/ax-12a.md; Feetech's communication manual and memory tables. Feetech's
servos answer a write with how they are, never with what became of it: what is out of range is left alone or clipped.
"""

from __future__ import annotations

import dataclasses

from manual import Item, Memory

PING, READ, WRITE, REG_WRITE, ACTION, SYNC_READ, SYNC_WRITE = 1, 2, 3, 4, 5, 0x82, 0x83
ALL = 0xFE
VOLTAGE, ANGLE, HEAT, RANGE, CHECKSUM, OVERLOAD, INSTRUCTION = 1, 2, 4, 8, 16, 32, 64
AX_STATES = VOLTAGE | HEAT | OVERLOAD
AX_BAUD = {1: 1_000_000, 3: 500_000, 7: 250_000, 16: 115_200, 34: 57_600}
FEETECH_BAUD = dict(enumerate((1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)))
MEASURED = frozenset(
    {
        *("present_position", "present_speed", "present_load", "present_voltage", "present_temperature"),
        *("present_current", "moving", "async_flag", "status", "registered"),
    }
)
HOME, MIDDLE = 128, 2048


def frame(servo, instruction, parameters=b""):
    body = bytes([servo, len(parameters) + 2, instruction]) + parameters
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


def statuses(data):
    """Cut a stream into status packets (id, error, data), of which nothing may be left over."""
    found = []
    while data:
        assert data[:2] == b"\xff\xff", data.hex()
        end = 4 + data[3]
        packet, data = data[:end], data[end:]
        assert packet[-1] == ~sum(packet[2:-1]) & 0xFF, packet.hex()
        found.append((packet[2], packet[4], packet[5:-1]))
    return found


@dataclasses.dataclass
class Servo:
    """A servo as its manual describes it."""

    memory: Memory
    family: str
    registered: tuple | None = None

    @property
    def id(self):
        return self.memory["id"]

    @property
    def baud(self):
        return (AX_BAUD if self.family == "ax" else FEETECH_BAUD)[self.memory["baud_rate"]]

    @property
    def lock_name(self):
        return "lock_scs" if self.family == "scs" else "lock"

    def answers(self, instruction):
        """Return whether an instruction to this servo alone is answered."""
        if instruction == PING:
            return True
        if self.family == "ax":
            return self.memory["status_return_level"] >= (1 if instruction == READ else 2)
        return instruction == READ or self.memory["response_level"] == 1

    def verdict(self, item: Item, value: int) -> tuple[int | None, bool | None]:
        """Return the error bits of a write and whether it is done; None where the manual leaves it open."""
        if self.family == "ax":
            return self.ax_verdict(item, value)
        if not item.writable:
            return 0, False
        return 0, True if item.low <= value <= item.high else None

    def ax_verdict(self, item, value):
        memory = self.memory
        if not item.writable:
            return None, False
        torque = memory["torque_enable"]
        if item.eeprom and (memory["lock"] or torque is None or torque):
            # that the lock closes EEPROM is in the manual, that torque does too is in the notes of its includes
            return None, False if memory["lock"] or torque else None
        if not item.low <= value <= item.high:
            return RANGE, False
        low, high = memory["cw_angle_limit"], memory["ccw_angle_limit"]
        if item.name == "moving_speed" and value > 1023 and not low == high == 0:
            # bit 10 is the direction of wheel mode, in which both limits are 0
            return (None, None) if (low or 0) == (high or 0) == 0 else (RANGE, False)
        if item.name == "goal_position" and not low == high == 0:
            if low is None or high is None:
                return None, None
            return (0, True) if low <= value <= high else (ANGLE, False)
        if item.name == "lock" and memory["lock"] and not value:
            return None, False
        return 0, True

    def take(self, item: Item, value: int) -> None:
        """Note a write that was done."""
        memory = self.memory
        memory[item.name] = value
        if item.name == "goal_position":
            if self.family == "ax":
                memory.forget("torque_enable")
            else:
                memory["torque_enable"] = 1
        if item.name == "torque_enable":
            memory.forget("goal_position", "torque_limit" if self.family == "ax" else "")
        if item.name in ("operating_mode", "homing_offset", "phase", "min_angle_limit", "max_angle_limit"):
            memory.forget("goal_position", "goal_time", "goal_speed")
        if item.name == "max_torque":
            memory.forget("torque_limit")
        if item.name in ("cw_angle_limit", "ccw_angle_limit"):
            memory.forget("goal_position", "moving_speed")

    def doubtful(self) -> None:
        """Note that the servo may have shut down: what protection takes is open until it is read."""
        self.memory.forget("torque_enable")
        if self.family == "ax":
            self.memory.forget("torque_limit")
