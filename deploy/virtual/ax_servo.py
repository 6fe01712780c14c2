"""A virtual Dynamixel AX-12A: its answers, its errors, and how its registers drive a shaft.

Sources: ROBOTIS e-Manual, docs/en/dxl/ax/ax-12a.md and docs/en/dxl/protocol1.md with their includes; the AX-12's own
manual of 2006 where the e-Manual is silent: a broadcast ping is answered, a factory reset makes the id 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from controller.products import Product
from controller.registers import Register
from controller.servo_law import Law, position_law
from deploy.virtual import protocol1 as p1
from deploy.virtual.drive import Drive, Shaft
from deploy.virtual.heat import AMBIENT_C, stands, warmed
from deploy.virtual.profile import Profile
from deploy.virtual.protocol1_servo import Protocol1Servo

ERROR_VOLTAGE: Final = 0x01
ERROR_ANGLE: Final = 0x02
ERROR_HEAT: Final = 0x04
ERROR_RANGE: Final = 0x08
ERROR_CHECKSUM: Final = 0x10
ERROR_OVERLOAD: Final = 0x20
ERROR_INSTRUCTION: Final = 0x40

OVERLOAD_S: Final = 2.0
"""How long a motor may stand at all the duty that its limit allows: an estimate."""

BAUD_TOLERANCE: Final = 0.03
"""How far a bit rate may be off to be understood: a tenth of a bit in the last of ten is 0.05, less some distortion."""

_USUAL_BAUDS: Final = (9600, 19_200, 57_600, 115_200, 200_000, 250_000, 400_000, 500_000, 1_000_000)
_FULL: Final = 1023
_WHEEL_MAX: Final = 2047
_ADDRESSES: Final = frozenset({"id", "baud_rate", "return_delay_time"})
_INERT: Final = frozenset({"led", "lock"})
_COMPLIANCE: Final = ("compliance_margin", "compliance_slope")
_MOVING_COUNT: Final = 10
_NEEDED_LEVEL: Final = {p1.PING: 0, p1.READ: 1}


class AxServo(Protocol1Servo):
    """Answer packets as an AX-12A does, and drive a shaft by its registers.

    Args:
        product: which servo
        shaft: what it turns
        eeprom: what its EEPROM holds where that is not the factory's: register name => count
    """

    sync_read = False
    takes_turns = False

    def __init__(self, product: Product, shaft: Shaft, eeprom: Mapping[str, int]) -> None:
        super().__init__(product, eeprom)
        self._shaft = shaft
        self._ticks_per_rad = product.ticks_per_turn / (2.0 * math.pi)
        self._temperature_c = AMBIENT_C
        self._start()

    def _start(self) -> None:
        self._registered: tuple[int, bytes] | None = None
        self._latched = 0
        self._overload_s = 0.0
        self._side = 1
        self._lopsided = False
        self._profile_moves = False
        self.profile = Profile(self._shaft.ticks())
        self.table["torque_limit"] = self.table["max_torque"]
        self.table["goal_position"] = self._position()
        self._read_addresses()
        self._drive()

    # packets

    def answer(self, packet: p1.Packet, now_ns: int) -> bytes | None:
        """Carry out a packet for this servo alone, or for all; return the status packet, or None for silence.

        Args:
            packet: with this servo's id, or `protocol1.BROADCAST`
            now_ns: time [ns]
        """
        # the answer to a change of id or return level comes from the servo as it was
        servo, level = self.id, self.table["status_return_level"]
        error, data = self._carry_out(packet, now_ns) if packet.sound else (ERROR_CHECKSUM, b"")
        self._shut_down(error)
        if level < _NEEDED_LEVEL.get(packet.instruction, 2):
            return None
        if packet.id == p1.BROADCAST and packet.instruction != p1.PING:
            return None
        return p1.encode_status(servo, error | self._status(), data)

    def answer_sync_read(self, address: int, length: int, now_ns: int) -> bytes:
        """Return no bytes: the servo knows no sync read, and the line does not ask it.

        Args:
            address: first byte
            length: bytes
            now_ns: time [ns]
        """
        return b""

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """Write registers by the rules; return error bits. All of a block is written, or nothing.

        Args:
            address: first byte
            data: the bytes
            now_ns: time [ns]
        """
        error = self._refusal(address, data)
        if error:
            self._shut_down(error)
            return error
        names = set()
        was_on = self.table["torque_enable"]
        for line, taken, _ in tuple(self.table.touched(address, data)):
            self.table.take(line, taken)
            names.add(line.name)
            if line.eeprom:
                self.table.keep(line.name)
                self.eeprom_changed = True
        if "torque_enable" in names and not was_on:
            self.profile.jump(self._shaft.ticks())
        if names & {"torque_enable", "torque_limit"}:
            self._latched = 0
            self._overload_s = 0.0
        if names & _ADDRESSES:
            self._read_addresses()
        if names == {"goal_position"} and not self._wheel():
            self._follow()
        elif not names <= _INERT:
            self._drive()
        return 0

    def _carry_out(self, packet: p1.Packet, now_ns: int) -> tuple[int, bytes]:
        parameters = packet.parameters
        if packet.instruction == p1.PING:
            return 0, b""
        if packet.instruction == p1.READ and len(parameters) == 2:
            return self._read(*parameters)
        if packet.instruction == p1.WRITE and len(parameters) > 1:
            return self.write(parameters[0], parameters[1:], now_ns), b""
        if packet.instruction == p1.REG_WRITE and len(parameters) > 1:
            error = self._refusal(parameters[0], parameters[1:])
            self._registered = self._registered if error else (parameters[0], parameters[1:])
            return error, b""
        if packet.instruction == p1.ACTION and self._registered:
            address, data = self._registered
            self._registered = None
            return self.write(address, data, now_ns), b""
        if packet.instruction == p1.FACTORY_RESET:
            self.table.factory()
            self.eeprom_changed = True
            self._start()
            return 0, b""
        return ERROR_INSTRUCTION, b""

    def _read(self, address: int, length: int) -> tuple[int, bytes]:
        if length < 1 or address + length > self.table.end:
            return ERROR_RANGE, b""
        self._measure()
        return 0, self.table.read(address, length)

    def _refusal(self, address: int, data: bytes) -> int:
        """Return the error of a write, 0 if it may be done."""
        table, error = self.table, 0
        locked = table["lock"] != 0 or table["torque_enable"] != 0
        touched = tuple(table.touched(address, data))
        if not touched or address + len(data) > table.end:
            return ERROR_RANGE
        limits = {line.name: value for line, _, value in touched if line.name.endswith("_angle_limit")}
        for line, taken, value in touched:
            error |= self._refused(line, taken, value, locked, limits)
        return error

    def _refused(self, line: Register, data: bytes, value: int, locked: bool, limits: Mapping[str, int]) -> int:
        if line.access == "r" or (line.eeprom and locked) or not line.low <= value <= line.high:
            return ERROR_RANGE
        if line.name == "lock" and value < self.table["lock"]:
            return ERROR_RANGE
        low, high = (limits.get(name, self.table[name]) for name in ("cw_angle_limit", "ccw_angle_limit"))
        wheel = low == 0 and high == 0
        if line.name == "moving_speed":
            # bit 10 says which way a wheel turns; a joint's goal says that for itself
            return ERROR_RANGE if int.from_bytes(data, line.byte_order) > (_WHEEL_MAX if wheel else _FULL) else 0
        if wheel:
            return 0
        return ERROR_ANGLE if line.name == "goal_position" and not low <= value <= high else 0

    # time

    @property
    def moving(self) -> bool:
        """Return whether the servo must be stepped: its profile moves, or its law depends on where the shaft is."""
        return self._profile_moves or self._lopsided

    def step(self, dt: float) -> None:
        """Move the profile, and choose the law of the side of the goal that the shaft is on.

        Args:
            dt: time step [s]
        """
        table = self.table
        speed = table["moving_speed"] * table.lines["moving_speed"].scale * self._ticks_per_rad
        self._profile_moves = self.profile.step(self._goal(), speed, 0.0, dt) and speed > 0.0
        if self._lopsided and self._side_of_goal() != self._side:
            self._drive()
        self._shaft.aim(self.profile.position)

    def protect(self, dt: float) -> None:
        """Warm up, and shut down what overheats, stalls or has the wrong supply.

        Args:
            dt: time since the last call [s]
        """
        product, shaft = self.product, self._shaft
        self._temperature_c = warmed(product, self._temperature_c, shaft.torque(), dt)
        limit = self.table["torque_limit"] / _FULL
        spent = limit > 0.0 and abs(shaft.duty()) >= 0.99 * limit and stands(product, shaft.speed())
        self._overload_s = self._overload_s + dt if spent else 0.0
        if self._overload_s > OVERLOAD_S:
            self._latched |= ERROR_OVERLOAD
        self._shut_down(self._status())

    def fail(self, error: int) -> None:
        """Report errors until torque is switched, or limited anew; lose torque where the shutdown register says so.

        Args:
            error: bits of the status error
        """
        self._latched |= error
        self._shut_down(error)

    def power_off(self) -> None:
        """Let the shaft go, as a servo without power does."""
        self.table["torque_enable"] = 0
        self._drive()

    # inside

    def _read_addresses(self) -> None:
        self.id = self.table["id"]
        rate = 2_000_000 // (self.table["baud_rate"] + 1)
        self.baud = next((usual for usual in _USUAL_BAUDS if abs(usual / rate - 1.0) < BAUD_TOLERANCE), rate)
        self.return_delay_ns = 2000 * self.table["return_delay_time"]

    def _wheel(self) -> bool:
        return self.table["cw_angle_limit"] == 0 and self.table["ccw_angle_limit"] == 0

    def _status(self) -> int:
        """Return what is wrong now, and what was and has not been mended."""
        table = self.table
        volts = round(10.0 * self._shaft.supply())
        error = self._latched
        if not table["min_voltage_limit"] <= volts <= table["max_voltage_limit"]:
            error |= ERROR_VOLTAGE
        if self._temperature_c > table["temperature_limit"]:
            error |= ERROR_HEAT
        return error

    def _shut_down(self, error: int) -> None:
        """Take the torque away where the shutdown register says so: the torque limit becomes 0."""
        if error & self.table["shutdown"] and self.table["torque_limit"]:
            self.table["torque_limit"] = 0
            self._drive()

    def _position(self) -> int:
        """Return where the potentiometer stands; in the 60 degrees where it has no track, its nearer end."""
        turn = self.product.ticks_per_turn
        count = round(self._shaft.ticks() % turn)
        return count if count <= _FULL else _FULL if count < 0.5 * (turn + _FULL) else 0

    def _goal(self) -> float:
        """Return where the shaft has to go [ticks], in the turn that it is in."""
        turn = self.product.ticks_per_turn
        return self.table["goal_position"] + turn * round((self._shaft.ticks() - 0.5 * _FULL) / turn)

    def _follow(self) -> None:
        """Begin to move to a new goal."""
        self._profile_moves = self._on() and self.table["moving_speed"] != 0
        if not self._profile_moves:
            self.profile.jump(self._goal())
        self._shaft.aim(self.profile.position)

    def _on(self) -> bool:
        return self.table["torque_enable"] != 0 and self.table["torque_limit"] > 0

    def _side_of_goal(self) -> int:
        """Return which way the goal is: 1 counter-clockwise, -1 clockwise."""
        return 1 if self.profile.position >= self._shaft.ticks() else -1

    def _law(self) -> Law:
        """Return the law on the side of the goal that the shaft is on.

        The manual's picture does not say which pair is whose: here the CCW pair acts where the servo turns CCW.
        """
        pair = "ccw" if self._side > 0 else "cw"
        counts = self.table.counts()
        for name in _COMPLIANCE:
            counts[f"cw_{name}"] = counts[f"ccw_{name}"] = counts[f"{pair}_{name}"]
        return position_law(self.product, counts)

    def _drive(self) -> None:
        table, shaft, on = self.table, self._shaft, self._on()
        if self._wheel():
            self._lopsided = self._profile_moves = False
            limit = table["torque_limit"] / _FULL
            shaft.drive(Drive(on=on, mode="voltage", law=Law(duty_max=limit)))
            shaft.aim(max(-limit, min(limit, table["moving_speed"] / _FULL)))
            return
        self._lopsided = on and any(table[f"cw_{name}"] != table[f"ccw_{name}"] for name in _COMPLIANCE)
        self._side = self._side_of_goal()
        shaft.drive(Drive(on=on, mode="position", law=self._law()))
        self._follow()

    def _measure(self) -> None:
        """Bring the registers that the servo measures up to date."""
        table, shaft, lines = self.table, self._shaft, self.table.lines
        speed = round(shaft.speed() / lines["present_speed"].scale)
        table["present_position"] = self._position()
        table["present_speed"] = speed
        table["present_load"] = round(_FULL * shaft.duty())
        table["present_voltage"] = round(10.0 * shaft.supply())
        table["present_temperature"] = round(self._temperature_c)
        table["registered"] = int(self._registered is not None)
        on_its_way = abs(self.profile.position - self._goal()) > 0.5 or abs(speed) > _MOVING_COUNT
        table["moving"] = int(self._on() and not self._wheel() and on_its_way)
