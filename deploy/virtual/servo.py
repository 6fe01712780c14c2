"""A virtual Dynamixel X330 servo: its control table, its answers, and how its registers drive a shaft.

What it does not have is refused, never ignored: operating modes but position control, reverse and time-based drive
modes, integral and feed-forward gains, another PWM slope, a secondary id and other protocols answer "result fail" (1).
Instructions beyond those of `INSTRUCTIONS` answer "instruction error" (2), as a servo that lacks them would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

from controller.products import Product
from controller.registers import X330_BAUD, Register, registers
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.control_table import ControlTable
from deploy.virtual.drive import Drive, Law, Shaft
from deploy.virtual.profile import Profile

POSITION_MODE: Final = 3
WATCHDOG_TRIPPED: Final = 255
WATCHDOG_UNIT_NS: Final = 20_000_000
REBOOT_NS: Final = 300_000_000
"""How long a servo is silent when it boots. Not in the manual: an estimate."""

HOMING_OFFSET_MAX: Final = 1024
"""Position mode ignores larger offsets. Source: e-Manual, control_table_homingoffset.md."""

ERROR_VOLTAGE: Final = 0x01
ERROR_HEAT: Final = 0x04
ERROR_OVERLOAD: Final = 0x20

AMBIENT_C: Final = 25.0
# Estimates, for the manual has none: a servo that stalls at full PWM is overloaded in 2 s and 70 degrees hot in 16 s;
# a load of a fifth of its stall torque, which ROBOTIS calls continuous, warms it by 14 degrees.
OVERLOAD_LOAD: Final = 0.8
OVERLOAD_SPEED: Final = 0.05
OVERLOAD_S: Final = 2.0
THERMAL_RESISTANCE_K_W: Final = 40.0
THERMAL_TIME_S: Final = 120.0

_EMULATED: Final[Mapping[str, frozenset[int]]] = {
    "operating_mode": frozenset({POSITION_MODE}),
    "drive_mode": frozenset({0, 8}),
    "protocol_type": frozenset({2}),
    "secondary_id": frozenset({253, 254, 255}),
    "startup_configuration": frozenset({0}),
    "pwm_slope": frozenset({140}),
    "position_i_gain": frozenset({0}),
    "feedforward_1st_gain": frozenset({0}),
    "feedforward_2nd_gain": frozenset({0}),
}
"""Registers of which only these values have an effect here."""

_GOALS: Final = frozenset({"goal_pwm", "goal_current", "goal_velocity", "goal_position"})
_DRIVE: Final = frozenset(
    {"torque_enable", "position_p_gain", "position_d_gain", "pwm_limit", "goal_pwm", "goal_position", "homing_offset"}
)
_TORQUE_ON_BY_GOAL: Final = 8
_PRESENT_LOW, _PRESENT_HIGH = 120, 148  # registers that the servo measures
_TICK_PERIOD: Final = 32768


class VirtualServo:
    """Answer packets as one servo does, and drive a shaft by its registers.

    Args:
        product: which servo
        shaft: what it turns
        eeprom: what its EEPROM holds where that is not the factory's: register name => count
    """

    def __init__(self, product: Product, shaft: Shaft, eeprom: Mapping[str, int]) -> None:
        self.product = product
        self.table = ControlTable(registers(product))
        for name, value in eeprom.items():
            self.table[name] = value
        self._shaft = shaft
        self._lines = self.table.lines
        self._resistance = product.voltage_v / product.stall_current_a
        self._temperature_c = AMBIENT_C
        self._silent_until_ns = 0
        self.eeprom_changed = False
        self._start(0)

    def reboot(self, now_ns: int) -> None:
        """Start anew with what the EEPROM holds, torque off; be silent meanwhile.

        Args:
            now_ns: time [ns]
        """
        self._start(now_ns)
        self._silent_until_ns = now_ns + REBOOT_NS

    def _start(self, now_ns: int) -> None:
        table = self.table
        table.restore(eeprom=False)
        table["goal_pwm"] = table["pwm_limit"]
        table["goal_current"] = table["current_limit"]
        self._booted_ns = now_ns
        self._heard_ns = now_ns
        self._overload_s = 0.0
        self.profile = Profile(self._shaft.ticks())
        self.moving = False
        self._read_addresses()
        table["goal_position"] = self._position()
        self._drive()

    # what the bus needs to know

    def silent(self, now_ns: int) -> bool:
        """Return whether the servo is booting.

        Args:
            now_ns: time [ns]
        """
        return now_ns < self._silent_until_ns

    def hear(self, now_ns: int) -> None:
        """Note that a packet was on the bus, for whomever: the bus watchdog starts anew.

        Args:
            now_ns: time [ns]
        """
        self._heard_ns = now_ns

    def watchdog_ns(self) -> int | None:
        """Return when the bus watchdog will trip, or None while it is not armed [ns]."""
        count = self.table["bus_watchdog"]
        if 0 < count < WATCHDOG_TRIPPED and self.table["torque_enable"]:
            return self._heard_ns + count * WATCHDOG_UNIT_NS
        return None

    def trip_watchdog(self) -> None:
        """Stop where the shaft is, and take no goals until 0 is written to the bus watchdog."""
        self.table["bus_watchdog"] = WATCHDOG_TRIPPED
        self.table["profile_velocity"] = 0
        self.table["profile_acceleration"] = 0
        self.table["goal_position"] = min(
            max(self._position(), self.table["min_position_limit"]), self.table["max_position_limit"]
        )
        self._aim()

    # packets

    def answer(self, packet: dxl.Packet, now_ns: int) -> bytes | None:
        """Carry out a packet for this servo alone, or for all; return the status packet, or None for silence.

        Args:
            packet: with this servo's id, or `dynamixel2.BROADCAST`
            now_ns: time [ns]
        """
        # the answer to a change of id, return level or boot state comes from the servo as it was
        servo = self.id
        level = self.table["status_return_level"]
        alert = self._alert()
        handler, needed = INSTRUCTIONS.get(packet.instruction, (_unknown, 2))
        error, data = handler(self, packet.parameters, now_ns)
        if level < needed or (packet.id == dxl.BROADCAST and packet.instruction != dxl.PING):
            return None
        return dxl.encode_status(servo, error | alert, data)

    def answer_sync_read(self, address: int, length: int, now_ns: int) -> bytes | None:
        """Return the status packet of this servo's part of a sync read, or None for silence.

        Args:
            address: first byte
            length: bytes
            now_ns: time [ns]
        """
        if self.table["status_return_level"] < 1:
            return None
        error, data = self.read(address, length, now_ns)
        return dxl.encode_status(self.id, error | self._alert(), data)

    def read(self, address: int, length: int, now_ns: int) -> tuple[int, bytes]:
        """Return an error number and registers as they are now.

        Args:
            address: first byte
            length: bytes
            now_ns: time [ns]
        """
        if (address < _PRESENT_HIGH and address + length > _PRESENT_LOW) or address >= 208:
            self._measure(now_ns)
        return self.table.read(address, length)

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """Write registers by the rules; return an error number. All of a block is written, or nothing.

        Args:
            address: first byte
            data: the bytes
            now_ns: time [ns]
        """
        error, changes = self.table.check(address, data)
        for line, value in changes:
            error = error or self._refusal(line, value)
        if error:
            return error
        for line, value in changes:
            self.table[line.name] = value
            self.eeprom_changed |= line.eeprom
        names = {line.name for line, _ in changes}
        if (
            "goal_position" in names
            and self.table["drive_mode"] & _TORQUE_ON_BY_GOAL
            and not self.table["torque_enable"]
        ):
            if self.table["hardware_error_status"]:
                return dxl.RESULT_FAIL
            self.table["torque_enable"] = 1
            names.add("torque_enable")
        if "torque_enable" in names or "bus_watchdog" in names:
            self._heard_ns = now_ns
        if "torque_enable" in names:
            self.profile.jump(self._shaft.ticks())
        if names & _DRIVE:
            self._drive()
        if names & {"id", "baud_rate", "return_delay_time"}:
            self._read_addresses()
        return 0

    # time

    def step(self, dt: float) -> None:
        """Move the profile.

        Args:
            dt: time step [s]
        """
        table = self.table
        velocity = (
            table["profile_velocity"] * self._lines["profile_velocity"].scale / self._lines["goal_position"].scale
        )
        acceleration = (
            table["profile_acceleration"]
            * self._lines["profile_acceleration"].scale
            / self._lines["goal_position"].scale
        )
        self.moving = self.profile.step(self._goal(), velocity, acceleration, dt)
        self._shaft.aim(self.profile.position)

    def protect(self, dt: float) -> None:
        """Warm up, and shut down what overheats, stalls or has the wrong supply.

        Args:
            dt: time since the last call [s]
        """
        product = self.product
        load = abs(self._shaft.torque()) / product.stall_torque_nm
        heat_w = (load * product.stall_current_a) ** 2 * self._resistance
        warm_c = AMBIENT_C + heat_w * THERMAL_RESISTANCE_K_W
        self._temperature_c += (warm_c - self._temperature_c) * dt / THERMAL_TIME_S
        stalled = load >= OVERLOAD_LOAD and abs(self._shaft.speed()) < OVERLOAD_SPEED * product.no_load_speed_rad_s
        self._overload_s = self._overload_s + dt if stalled else 0.0
        table = self.table
        error = 0
        if self._overload_s > OVERLOAD_S:
            error |= ERROR_OVERLOAD
        if self._temperature_c > table["temperature_limit"]:
            error |= ERROR_HEAT
        volts = round(10.0 * self._shaft.supply())
        if not table["min_voltage_limit"] <= volts <= table["max_voltage_limit"]:
            error |= ERROR_VOLTAGE
        if error & ~table["hardware_error_status"]:
            self.fail(error)

    def fail(self, error: int) -> None:
        """Report hardware errors; torque goes off for good where the shutdown register names one of them.

        Args:
            error: bits of the hardware error status
        """
        self.table["hardware_error_status"] |= error
        if error & self.table["shutdown"]:
            self.table["torque_enable"] = 0
            self._drive()

    def power_off(self) -> None:
        """Let the shaft go, as a servo without power does."""
        self.table["torque_enable"] = 0
        self._drive()

    def supply_changed(self) -> None:
        """Drive the shaft with the supply as it is now."""
        self._drive()

    # inside

    def _read_addresses(self) -> None:
        self.id = self.table["id"]
        self.baud = X330_BAUD[self.table["baud_rate"]]
        self.return_delay_ns = 2000 * self.table["return_delay_time"]

    def _refusal(self, line: Register, value: int) -> int:
        """Return the error of a write that the table's own rules allow."""
        name = line.name
        if name in _GOALS and self.table["bus_watchdog"] == WATCHDOG_TRIPPED:
            return dxl.DATA_RANGE_ERROR
        if name == "bus_watchdog" and value and self.table["bus_watchdog"] == WATCHDOG_TRIPPED:
            return dxl.DATA_RANGE_ERROR
        if name in _EMULATED and value not in _EMULATED[name]:
            return dxl.RESULT_FAIL
        if name == "torque_enable" and value and self.table["hardware_error_status"] & self.table["shutdown"]:
            return dxl.RESULT_FAIL
        return 0

    def _alert(self) -> int:
        return dxl.ALERT if self.table["hardware_error_status"] else 0

    def _offset(self) -> int:
        offset = self.table["homing_offset"]
        return offset if abs(offset) <= HOMING_OFFSET_MAX else 0

    def _position(self) -> int:
        return round(self._shaft.ticks()) + self._offset()

    def _goal(self) -> float:
        return float(self.table["goal_position"] - self._offset())

    def _drive(self) -> None:
        table = self.table
        self._shaft.drive(Drive(on=table["torque_enable"] != 0, mode="position", law=self._law()))
        self._aim()

    def _law(self) -> Law:
        table, product = self.table, self.product
        counts_per_rad = product.ticks_per_turn / (2.0 * math.pi)
        return Law(
            kp=table["position_p_gain"] / product.p_divisor / product.duty_full * counts_per_rad,
            kd=table["position_d_gain"] / product.d_divisor / product.duty_full * counts_per_rad,
            duty_max=min(table["pwm_limit"], abs(table["goal_pwm"])) / product.duty_full,
        )

    def _aim(self) -> None:
        if self.table["profile_velocity"] and self.table["torque_enable"]:
            self.moving = True
        else:
            self.moving = False
            self.profile.jump(self._goal())
            self._shaft.aim(self.profile.position)

    def _measure(self, now_ns: int) -> None:
        """Bring the registers that the servo measures up to date."""
        table, shaft, product = self.table, self._shaft, self.product
        position = self._position()
        velocity = round(shaft.speed() / product.velocity_unit_rad_s)
        table["present_position"] = position
        table["present_velocity"] = velocity
        table["present_current"] = round(1e3 * product.stall_current_a * shaft.torque() / product.stall_torque_nm)
        table["present_pwm"] = round(shaft.duty() * product.duty_full)
        table["present_input_voltage"] = round(10.0 * shaft.supply())
        table["present_temperature"] = round(self._temperature_c)
        table["realtime_tick"] = (now_ns - self._booted_ns) // 1_000_000 % _TICK_PERIOD
        table["moving"] = int(self.moving or abs(velocity) > table["moving_threshold"])
        table["position_trajectory"] = round(self.profile.position) + self._offset()
        table["velocity_trajectory"] = round(
            self.profile.velocity * self._lines["goal_position"].scale / product.velocity_unit_rad_s
        )
        there = abs(position - table["goal_position"]) <= 1 and not self.moving
        kind = 0 if not table["profile_velocity"] else 3 if table["profile_acceleration"] else 1
        table["moving_status"] = int(there) | int(self.moving) << 1 | kind << 4


Handler = Callable[[VirtualServo, bytes, int], tuple[int, bytes]]


def _unknown(servo: VirtualServo, parameters: bytes, now_ns: int) -> tuple[int, bytes]:
    return dxl.INSTRUCTION_ERROR, b""


def _ping(servo: VirtualServo, parameters: bytes, now_ns: int) -> tuple[int, bytes]:
    model = servo.table["model_number"]
    return 0, bytes((model & 0xFF, model >> 8, servo.table["firmware_version"]))


def _read(servo: VirtualServo, parameters: bytes, now_ns: int) -> tuple[int, bytes]:
    if len(parameters) != 4:
        return dxl.DATA_LENGTH_ERROR, b""
    return servo.read(parameters[0] | parameters[1] << 8, parameters[2] | parameters[3] << 8, now_ns)


def _write(servo: VirtualServo, parameters: bytes, now_ns: int) -> tuple[int, bytes]:
    if len(parameters) < 3:
        return dxl.DATA_LENGTH_ERROR, b""
    return servo.write(parameters[0] | parameters[1] << 8, parameters[2:], now_ns), b""


def _reboot(servo: VirtualServo, parameters: bytes, now_ns: int) -> tuple[int, bytes]:
    if parameters:
        return dxl.DATA_LENGTH_ERROR, b""
    servo.reboot(now_ns)
    return 0, b""


INSTRUCTIONS: Final[Mapping[int, tuple[Handler, int]]] = {
    dxl.PING: (_ping, 0),
    dxl.READ: (_read, 1),
    dxl.WRITE: (_write, 2),
    dxl.REBOOT: (_reboot, 2),
}
"""What a servo carries out, and the status return level from which it answers."""
