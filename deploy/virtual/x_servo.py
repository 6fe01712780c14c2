"""A virtual Dynamixel X servo: its control table, its answers, its states, and how it protects itself.

Sources: ROBOTIS e-Manual, docs/en/dxl/protocol2.md and docs/en/dxl/x with their includes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from controller.families import family_of
from controller.products import Product
from controller.registers import Register, registers
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.control_table import ControlTable
from deploy.virtual.drive import Shaft
from deploy.virtual.heat import AMBIENT_C, stands, warmed
from deploy.virtual.x_effects import GOALS, RESTORED, reset_goals, take_effect
from deploy.virtual.x_instructions import GROUP_INSTRUCTIONS, INSTRUCTIONS, unknown
from deploy.virtual.x_motion import GOAL_OF_MODE, POSITION, POSITION_MODES, XMotion, profile_takes

WATCHDOG_TRIPPED: Final = 255
WATCHDOG_UNIT_NS: Final = 20_000_000
REBOOT_NS: Final = 300_000_000
"""How long a servo is silent when it boots. Not in the manual: an estimate."""

ERROR_VOLTAGE: Final = 0x01
ERROR_HEAT: Final = 0x04
ERROR_OVERLOAD: Final = 0x20

OVERLOAD_LOAD: Final = 0.8
OVERLOAD_S: Final = 2.0
"""A servo that stalls at this share of its torque is overloaded after this time: estimates, the manual has none."""

TORQUE_AT_START, RESTORE_AT_START = 1, 2
"""Bits of the startup configuration."""

SECONDARY_ID_MAX: Final = 252
_PROTOCOL: Final = 2
_TORQUE_ON_BY_GOAL: Final = 8
_ADDRESSES: Final = frozenset({"id", "secondary_id", "baud_rate", "return_delay_time", "protocol_type"})
_PRESENT_LOW, _PRESENT_HIGH = 120, 147  # registers that the servo measures
_STATE_LOW, _STATE_HIGH = 126, 136  # of these: load, velocity, position
_TICK_PERIOD: Final = 32768


class XServo:
    """Answer packets as one servo does, and drive a shaft by its registers.

    Args:
        product: which servo
        shaft: what it turns
        eeprom: what its EEPROM holds where that is not the factory's: register name => count
        backup: what its backup holds, the same, or None if it has none
    """

    def __init__(
        self, product: Product, shaft: Shaft, eeprom: Mapping[str, int], backup: Mapping[str, int] | None = None
    ) -> None:
        self.product = product
        self.table = ControlTable(registers(product))
        for name, value in eeprom.items():
            self.table[name] = value
        self.backup = backup
        self.registered: bytes | None = None
        self.eeprom_changed = False
        self._bauds = family_of(product).bauds
        self._shaft = shaft
        self._indirect_low = self.table.indirect_low
        self._temperature_c = AMBIENT_C
        self._silent_until_ns = 0
        self.motion = XMotion(product, self.table, shaft)
        self._start(0)

    def reboot(self, now_ns: int) -> None:
        """Start anew with what the EEPROM holds; be silent meanwhile.

        Args:
            now_ns: time [ns]
        """
        self._start(now_ns)
        self._silent_until_ns = now_ns + REBOOT_NS

    def _start(self, now_ns: int) -> None:
        table = self.table
        table.restore(eeprom=False)
        startup = table["startup_configuration"]
        if self.backup is not None:
            table["backup_ready"] = 1
            if startup & RESTORE_AT_START:
                for name in RESTORED:
                    table[name] = self.backup[name]
        self.registered = None
        self._booted_ns = now_ns
        self._heard_ns = now_ns
        self._overload_s = 0.0
        self._read_addresses()
        self.motion.start()
        reset_goals(self.table, self.motion)
        table["torque_enable"] = startup & TORQUE_AT_START
        self.motion.drive()
        self.motion.aim()

    # what the bus needs to know

    def silent(self, now_ns: int) -> bool:
        """Return whether the servo is booting, or set to another protocol.

        Args:
            now_ns: time [ns]
        """
        return now_ns < self._silent_until_ns or self._foreign

    def hear(self, now_ns: int) -> None:
        """Note that a packet was on the bus, for whomever: the bus watchdog starts anew.

        Args:
            now_ns: time [ns]
        """
        self._heard_ns = now_ns

    @property
    def answers_reads(self) -> bool:
        """Return whether the status return level has it answer reads."""
        return self.table["status_return_level"] >= 1

    def watchdog_ns(self) -> int | None:
        """Return when the bus watchdog will trip, or None while it is not armed [ns]."""
        count = self.table["bus_watchdog"]
        if 0 < count < WATCHDOG_TRIPPED and self.table["torque_enable"]:
            return self._heard_ns + count * WATCHDOG_UNIT_NS
        return None

    def trip_watchdog(self) -> None:
        """Stop, and take no goals until 0 is written to the bus watchdog."""
        table, mode = self.table, self.motion.mode
        table["bus_watchdog"] = WATCHDOG_TRIPPED
        table["profile_velocity"] = 0
        table["profile_acceleration"] = 0
        if mode in POSITION_MODES:
            table["goal_position"] = self._within_limits(self.motion.position())
        else:
            table[GOAL_OF_MODE[mode]] = 0
        self.motion.settle()
        self.motion.drive()
        self.motion.aim()

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
        handler, needed = INSTRUCTIONS.get(packet.instruction, (unknown, 2))
        error, data = handler(self, packet, now_ns)
        if level < needed or (packet.id == dxl.BROADCAST and packet.instruction != dxl.PING):
            return None
        return dxl.encode_status(servo, error | alert, data)

    def obey(self, packet: dxl.Packet, now_ns: int) -> None:
        """Carry out a packet that was sent to the secondary id.

        Args:
            packet: the instruction
            now_ns: time [ns]
        """
        writes = packet.instruction in (dxl.WRITE, dxl.REG_WRITE)
        if packet.instruction not in GROUP_INSTRUCTIONS or (writes and self._touches_eeprom(packet.parameters)):
            return
        INSTRUCTIONS[packet.instruction][0](self, packet, now_ns)

    def tell(self, address: int, length: int, now_ns: int) -> tuple[int, bytes]:
        """Return the error byte and the data of this servo's part of a sync or bulk read.

        Args:
            address: first byte
            length: bytes
            now_ns: time [ns]
        """
        error, data = self.read(address, length, now_ns)
        return error | self._alert(), data

    def read(self, address: int, length: int, now_ns: int) -> tuple[int, bytes]:
        """Return an error number and registers as they are now.

        Args:
            address: first byte
            length: bytes
            now_ns: time [ns]
        """
        end = address + length
        if address >= _STATE_LOW and end <= _STATE_HIGH:
            self.motion.measure_state()
        elif (address < _PRESENT_HIGH and end > _PRESENT_LOW) or end > self._indirect_low:
            self._measure(now_ns)
        return self.table.read(address, length)

    def check(self, address: int, data: bytes) -> int:
        """Return the error number that a write would have now, 0 for none.

        Args:
            address: first byte
            data: the bytes
        """
        return self._check(address, data)[0]

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """Write registers by the rules; return an error number. All of a block is written, or nothing.

        Args:
            address: first byte
            data: the bytes
            now_ns: time [ns]
        """
        error, changes = self._check(address, data)
        if error:
            return error
        names = {line.name for line, _ in changes}
        wakes = self._wakes(names)
        if wakes and self.table["hardware_error_status"] & self.table["shutdown"]:
            return dxl.RESULT_FAIL
        before = {name: self.table[name] for name in ("operating_mode", "drive_mode", "torque_enable")}
        for line, value in changes:
            self.table[line.name] = value
            self.eeprom_changed |= line.eeprom
        if wakes:
            self.table["torque_enable"] = 1
            names.add("torque_enable")
        if names & {"torque_enable", "bus_watchdog"}:
            self._heard_ns = now_ns
        take_effect(self.table, self.motion, names, before)
        if names & _ADDRESSES:
            self._read_addresses()
        return 0

    def register(self, parameters: bytes | None) -> None:
        """Keep a write for the next action.

        Args:
            parameters: address and data of the write; None: forget what was kept
        """
        self.registered = parameters
        self.table["registered_instruction"] = int(parameters is not None)

    def factory_reset(self, kept: Iterable[str], now_ns: int) -> None:
        """Set the control table to the factory's, and boot.

        Args:
            kept: registers that are left as they are
            now_ns: time [ns]
        """
        values = {name: self.table[name] for name in kept}
        self.table.restore(eeprom=True)
        for name, value in values.items():
            self.table[name] = value
        self.eeprom_changed = True
        self.reboot(now_ns)

    def clear_turns(self) -> bool:
        """Count the present position within one turn, the goal with it; return False if the shaft moves."""
        motion, table = self.motion, self.table
        if motion.moving or abs(motion.velocity()) > table["moving_threshold"]:
            return False
        before = motion.position()
        motion.forget_turns()
        if motion.mode != POSITION:
            table["goal_position"] += motion.position() - before
        return True

    def back_up(self) -> None:
        """Keep a copy of the EEPROM, and of what of the RAM can be brought back."""
        table = self.table
        self.backup = {**table.eeprom(), **{name: table[name] for name in RESTORED}}
        self.eeprom_changed = True
        table["backup_ready"] = 1

    def restore_backup(self, now_ns: int) -> None:
        """Set the EEPROM to the copy, and boot.

        Args:
            now_ns: time [ns]
        """
        for name in self.table.eeprom():
            self.table[name] = (self.backup or {}).get(name, self.table[name])
        self.eeprom_changed = True
        self.reboot(now_ns)

    # time

    @property
    def moving(self) -> bool:
        """Return whether a profile is on its way, and `step` needed."""
        return self.motion.moving

    def step(self, dt: float) -> None:
        """Move along the profile.

        Args:
            dt: time step [s]
        """
        self.motion.step(dt)

    def protect(self, dt: float) -> None:
        """Warm up, and shut down what overheats, stalls or has the wrong supply.

        Args:
            dt: time since the last call [s]
        """
        product, table, shaft = self.product, self.table, self._shaft
        torque = shaft.torque()
        self._temperature_c = warmed(product, self._temperature_c, torque, dt)
        stalled = abs(torque) >= OVERLOAD_LOAD * product.stall_torque_nm and stands(product, shaft.speed())
        self._overload_s = self._overload_s + dt if stalled else 0.0
        error = 0
        if self._overload_s > OVERLOAD_S:
            error |= ERROR_OVERLOAD
        if self._temperature_c > table["temperature_limit"]:
            error |= ERROR_HEAT
        volts = round(10.0 * shaft.supply())
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
            self.power_off()

    def power_off(self) -> None:
        """Let the shaft go, as a servo without power does."""
        self.table["torque_enable"] = 0
        self.motion.settle()
        self.motion.drive()

    # inside

    def _read_addresses(self) -> None:
        table = self.table
        self.id = table["id"]
        second = table["secondary_id"]
        self.secondary_id = second if second <= SECONDARY_ID_MAX else None
        self.baud = self._bauds[table["baud_rate"]]
        self.return_delay_ns = 2000 * table["return_delay_time"]
        self._foreign = table["protocol_type"] != _PROTOCOL

    def _check(self, address: int, data: bytes) -> tuple[int, Sequence[tuple[Register, int]]]:
        error, changes = self.table.check(address, data)
        if error == dxl.DATA_LIMIT_ERROR and self.table["bus_watchdog"] == WATCHDOG_TRIPPED:
            error = dxl.DATA_RANGE_ERROR  # goals can not be written at all
        for line, value in changes:
            error = error or self._refusal(line, value)
        return error, changes

    def _refusal(self, line: Register, value: int) -> int:
        """Return the error of a write that the table's own rules allow."""
        name, table = line.name, self.table
        if table["bus_watchdog"] == WATCHDOG_TRIPPED and (name in GOALS or (name == "bus_watchdog" and value)):
            return dxl.DATA_RANGE_ERROR
        if not profile_takes(table, name, value):
            return dxl.DATA_RANGE_ERROR
        if name == "torque_enable" and value and table["hardware_error_status"] & table["shutdown"]:
            return dxl.RESULT_FAIL
        return 0

    def _wakes(self, names: set[str]) -> bool:
        """Return whether a write of these registers switches torque on by itself."""
        table = self.table
        if not table["drive_mode"] & _TORQUE_ON_BY_GOAL or table["torque_enable"]:
            return False
        return GOAL_OF_MODE.get(self.motion.mode, "goal_position") in names

    def _touches_eeprom(self, parameters: bytes) -> bool:
        return len(parameters) < 2 or (parameters[0] | parameters[1] << 8) < self.table.ram

    def _within_limits(self, position: int) -> int:
        table = self.table
        if self.motion.mode != POSITION:
            return position
        return min(max(position, table["min_position_limit"]), table["max_position_limit"])

    def _alert(self) -> int:
        return dxl.ALERT if self.table["hardware_error_status"] else 0

    def _measure(self, now_ns: int) -> None:
        """Bring the registers that the servo measures up to date."""
        table = self.table
        self.motion.measure()
        table["present_input_voltage"] = round(10.0 * self._shaft.supply())
        table["present_temperature"] = round(self._temperature_c)
        table["realtime_tick"] = (now_ns - self._booted_ns) // 1_000_000 % _TICK_PERIOD
