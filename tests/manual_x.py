"""What a master may expect of an X servo, by the e-Manual (protocol2.md, x/*.md): none of the servos' own code is here.

Where the manual allows several answers, so do the rules; what it leaves open is None until a reply tells.
"""

from __future__ import annotations

import dataclasses

from manual import Memory

PING, READ, WRITE, REG_WRITE, ACTION, RESET, REBOOT, CLEAR = 1, 2, 3, 4, 5, 6, 8, 0x10
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A
ALL, STATUS, ALERT = 0xFE, 0x55, 0x80
FAIL, UNKNOWN, CRC, RANGE, LENGTH, LIMIT, ACCESS = 1, 2, 3, 4, 5, 6, 7
BAUD = {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000}
BOOT_S = 1.0  # longer than any servo takes
WATCHDOG_S, WATCHDOG_SLACK_S, TRIPPED = 0.02, 0.005, 255
TIME_MS_MAX = 32737  # of a time-based profile, where one by velocity takes 32767
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
MODES = {"xl430-w250": (1, 3, 4, 16)}
MODES_X = (0, 1, 3, 4, 5, 16)
MEASURED = frozenset(
    {
        *("realtime_tick", "moving", "moving_status", "present_pwm", "present_current", "present_load"),
        *("present_velocity", "present_position", "velocity_trajectory", "position_trajectory"),
        *("present_input_voltage", "present_temperature", "backup_ready", "hardware_error_status"),
    }
)
# what one write makes the servo set anew, by the manual's notes on these items
RESETS = {
    "operating_mode": (
        *("velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain"),
        *("feedforward_2nd_gain", "feedforward_1st_gain", "profile_acceleration", "profile_velocity"),
        *GOALS,
    ),
    "drive_mode": ["goal_position", "profile_acceleration", "profile_velocity"],
    "torque_enable": ["goal_position", "goal_velocity", "goal_pwm", "goal_current"],
    "homing_offset": ["goal_position"],
    "min_position_limit": ["goal_position"],
    "max_position_limit": ["goal_position"],
    "pwm_limit": ["goal_pwm"],
    "current_limit": ["goal_current"],
    "velocity_limit": ["goal_velocity"],
}
APART = frozenset({"id", "baud_rate", "secondary_id", "protocol_type", "status_return_level", "startup_configuration"})
LIMITS = frozenset(
    {"min_position_limit", "max_position_limit", "min_voltage_limit", "max_voltage_limit", "temperature_limit"}
)


def crc16(data):
    """Bit by bit, as the manual's polynomial x^16 + x^15 + x^2 + 1 says."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def two(*values):
    return b"".join(value.to_bytes(2, "little") for value in values)


def frame(servo, instruction, parameters=b""):
    body = (bytes([instruction]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = b"\xff\xff\xfd\x00" + bytes([servo]) + two(len(body) + 2) + body
    return head + two(crc16(head))


def statuses(data):
    """Cut a stream into status packets, of which nothing may be left over."""
    found = []
    while data:
        assert data[:4] == b"\xff\xff\xfd\x00", data.hex()
        end = 7 + int.from_bytes(data[5:7], "little")
        packet, data = data[:end], data[end:]
        assert crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little"), packet.hex()
        assert packet[7] == STATUS
        body = packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        found.append((packet[4], body[0], body[1:]))
    return found


def fast_parts(raw, lengths):
    """Cut a fast reply into (id, error, data); every part's CRC is that of all before it."""
    assert raw[:5] == b"\xff\xff\xfd\x00\xfe"
    assert int.from_bytes(raw[5:7], "little") == 1 + sum(4 + length for length in lengths) == len(raw) - 7
    assert raw[7] == STATUS
    parts, at = [], 8
    for length in lengths:
        end = at + 2 + length
        assert crc16(raw[:end]) == int.from_bytes(raw[end : end + 2], "little")
        parts.append((raw[at + 1], raw[at], raw[at + 2 : end]))
        at = end + 2
    return parts


@dataclasses.dataclass
class Servo:
    """A servo as its manual describes it."""

    memory: Memory
    modes: tuple
    registered: tuple | None = None
    fuzzy: bool = False  # alert: the servo may have shut down at any time

    @property
    def id(self):
        return self.memory["id"]

    @property
    def baud(self):
        return BAUD[self.memory["baud_rate"]]

    @property
    def level(self):
        return self.memory["status_return_level"]

    def errors(self, item, value):
        """Return the error numbers that the manual allows for a write."""
        memory = self.memory
        if not item.writable:
            return {ACCESS}
        found = set()
        torque = memory["torque_enable"]
        if item.eeprom and (torque is None or torque or self.fuzzy):
            found.add(ACCESS)
            if torque and not self.fuzzy:
                return found
        if not item.low <= value <= item.high or (item.name == "operating_mode" and value not in self.modes):
            return found | {RANGE, LIMIT, FAIL}
        if item.name in ("profile_velocity", "profile_acceleration") and value > TIME_MS_MAX:
            drive = memory["drive_mode"]
            return {0, RANGE, LIMIT, FAIL} if drive is None else {RANGE, LIMIT, FAIL} if drive & 4 else {0}
        if item.name in GOALS:
            watchdog = memory["bus_watchdog"]
            if watchdog == TRIPPED:
                return {RANGE}
            found |= {RANGE} if watchdog is None else set()
            if self.fuzzy and self.goals_switch_on():  # which a servo that has shut down does not
                found.add(FAIL)
            return found | self.goal_errors(item, value)
        if item.name == "torque_enable" and value and self.fuzzy:
            return {0, FAIL, RANGE, LIMIT, ACCESS}
        if item.name in LIMITS or (item.name == "drive_mode" and value & 2):
            return found | {0, RANGE, LIMIT}  # whether limits may cross is not said, nor what the unused bit is
        return found | {0}

    def goal_errors(self, item, value):
        memory = self.memory
        if item.name == "goal_position":
            low, high, mode = memory["min_position_limit"], memory["max_position_limit"], memory["operating_mode"]
            if mode != 3 or low is None or high is None:
                return {0, RANGE, LIMIT}
            return {0} if low <= value <= high else {RANGE, LIMIT}
        limit = memory[item.name.removeprefix("goal_") + "_limit"]
        if limit is None:
            return {0, RANGE, LIMIT}
        return {0} if abs(value) <= limit else {RANGE, LIMIT}

    def take(self, item, value):
        """Note a write that was carried out."""
        memory = self.memory
        if item.name == "torque_enable" and self.fuzzy and value:
            memory.forget("torque_enable")
        elif item.name == "bus_watchdog" and memory["bus_watchdog"] == TRIPPED and value:
            memory.forget("bus_watchdog")
        else:
            memory[item.name] = value
        memory.forget(*(name for name in RESETS.get(item.name, ()) if name != item.name))
        if item.name in GOALS and self.goals_switch_on():
            memory.forget("torque_enable")

    def take_perhaps(self, item):
        """Note a write that nobody answered and that may have been refused."""
        memory = self.memory
        memory.forget(item.name, *RESETS.get(item.name, ()))
        if item.name in GOALS and self.goals_switch_on():
            memory.forget("torque_enable")

    def goals_switch_on(self):
        """Return whether a goal may switch torque on now."""
        drive = self.memory["drive_mode"]
        return (drive is None or bool(drive & 8)) and not self.memory["torque_enable"]

    def alerted(self):
        """Note a hardware error: torque may have gone with it, and comes back after a reboot only."""
        self.fuzzy = True
        self.memory.forget("torque_enable")

    def booted(self):
        self.memory.start(eeprom=False)
        self.registered, self.fuzzy = None, False

    def waited(self, seconds):
        """Note for how long the line was quiet."""
        memory = self.memory
        count, torque = memory["bus_watchdog"], memory["torque_enable"]
        if torque == 0 and not self.fuzzy:
            return
        if count == 0 or count == TRIPPED or seconds < (count or 1) * WATCHDOG_S - WATCHDOG_SLACK_S:
            return
        certain = torque and count and not self.fuzzy and seconds > count * WATCHDOG_S + WATCHDOG_SLACK_S
        memory["bus_watchdog"] = TRIPPED if certain else None
        memory.forget(*GOALS, "profile_velocity", "profile_acceleration")
