"""A virtual Feetech servo, STS or SCS: its answers, and its registers.

A write is answered with how the servo is, never with what became of it: what is read-only or out of range is left as it
was, silently. Where sources disagree, or are silent, these are our choices:

- Lock: what is written to EEPROM while locked acts and is lost with the power (Feetech's manual and memory table;
  feetech-cli 0.1.8 models it as dropped).
- Homing by 128 is kept whatever the lock says.
- An unknown instruction is not answered. No source of Feetech's knows a reboot; one port of its SDK names 0x08.
- Factory reset makes the id 1 and the rate 1 Mbit/s (feetech-cli; the manual says "specific data").
- Several servos answer a broadcast ping one after another (LeRobot relies on it; the manual forbids it).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from controller.families import family_of
from controller.products import Product
from controller.registers import Register
from deploy.virtual import protocol1 as p1
from deploy.virtual.drive import Shaft
from deploy.virtual.feetech_motion import FeetechMotion
from deploy.virtual.feetech_protection import FeetechProtection
from deploy.virtual.protocol1_servo import Protocol1Servo

HOME: Final = 128
"""What is written to torque enable to make the present position 2048."""

_HOME_POSITION: Final = 2048
_TORQUE_VALUES: Final = frozenset({0, 1, 2, HOME})
_FACTORY_AREA: Final = 80
_MOVING_COUNTS_S: Final = 50
_ADDRESSES: Final = frozenset({"id", "baud_rate", "return_delay"})
_ALWAYS_ANSWERED: Final = frozenset({p1.PING, p1.READ})


class FeetechServo(Protocol1Servo):
    """Answer packets as a Feetech servo does, and drive a shaft by its registers.

    Args:
        product: which servo
        shaft: what it turns
        eeprom: what its EEPROM holds where that is not the factory's: register name => count
    """

    takes_turns = True

    def __init__(self, product: Product, shaft: Shaft, eeprom: Mapping[str, int]) -> None:
        super().__init__(product, eeprom)
        self.sync_read = family_of(product).sync_read
        self._bauds = family_of(product).bauds
        self._shaft = shaft
        self._registered: tuple[int, bytes] | None = None
        self._protection = FeetechProtection(product, self.table, shaft)
        self._motion = FeetechMotion(product, self.table, shaft)
        self._start()

    def _start(self) -> None:
        self._registered = None
        if "torque_limit" in self.table.lines:
            self.table["torque_limit"] = self.table["max_torque"]
        self._protection.power_up()
        self._motion.power_up()
        self._read_addresses()

    # packets

    def answer(self, packet: p1.Packet, now_ns: int) -> bytes | None:
        """Carry out a packet for this servo alone, or for all; return the status packet, or None for silence.

        Args:
            packet: with this servo's id, or `protocol1.BROADCAST`
            now_ns: time [ns]
        """
        if not packet.sound:
            return None
        # the answer to a change of id or response level comes from the servo as it was
        servo, level = self.id, self.table["response_level"]
        data = self._carry_out(packet, now_ns)
        if data is None or (level == 0 and packet.instruction not in _ALWAYS_ANSWERED):
            return None
        if packet.id == p1.BROADCAST and packet.instruction != p1.PING:
            return None
        return p1.encode_status(servo, self._protection.status(), data)

    def answer_sync_read(self, address: int, length: int, now_ns: int) -> bytes:
        """Return the status packet of this servo's part of a sync read.

        Args:
            address: first byte
            length: bytes
            now_ns: time [ns]
        """
        return p1.encode_status(self.id, self._protection.status(), self._read(address, length))

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """Write registers, each that may be written; return 0.

        Args:
            address: first byte
            data: the bytes
            now_ns: time [ns]
        """
        table, names = self.table, set()
        for line, taken, value in tuple(table.touched(address, data)):
            if not self._takes(line, value):
                continue
            if line.name == "torque_enable" and value == HOME:
                self._home(_HOME_POSITION)
                continue
            table.take(line, taken)
            names.add(line.name)
            if line.eeprom and not table["lock"]:
                table.keep(line.name)
                self.eeprom_changed = True
            if line.name == "goal_position":
                table["torque_enable"] = 1
        if address >= _FACTORY_AREA:
            table.put(address, data)
        if "torque_enable" in names:
            self._protection.relieve(None)
        if "goal_position" in names:
            self._protection.relieve(table["goal_position"] - self._motion.position())
        self._motion.changed(names, self._protection.duty_max())
        if names & _ADDRESSES:
            self._read_addresses()
        return 0

    def _carry_out(self, packet: p1.Packet, now_ns: int) -> bytes | None:
        """Return the data of the answer, None for an instruction that the servo does not know."""
        parameters = packet.parameters
        sts = self.sync_read
        if packet.instruction == p1.READ and len(parameters) == 2 and parameters[1] <= p1.DATA_MAX:
            return self._read(*parameters)
        if packet.instruction == p1.WRITE and len(parameters) > 1:
            self.write(parameters[0], parameters[1:], now_ns)
        elif packet.instruction == p1.REG_WRITE and len(parameters) > 1:
            self._registered = (parameters[0], parameters[1:])
        elif packet.instruction == p1.ACTION:
            registered, self._registered = self._registered, None
            if registered:
                self.write(*registered, now_ns)
        elif packet.instruction == p1.FACTORY_RESET:
            self.table.factory()
            self.eeprom_changed = True
            self._start()
        elif packet.instruction == p1.RESET_TURNS and sts:
            self._motion.forget_turns()
        elif packet.instruction == p1.CALIBRATE and sts and len(parameters) == 2:
            self._home(int.from_bytes(parameters, "little") % (2 * _HOME_POSITION))
        elif packet.instruction != p1.PING:
            return None
        return b""

    def _read(self, address: int, length: int) -> bytes:
        self._measure()
        return self.table.read(address, length)

    def _takes(self, line: Register, value: int) -> bool:
        if line.access == "r" or (line.name == "torque_enable" and value not in _TORQUE_VALUES):
            return False
        # a goal time has as many bits as a time needs, or a PWM with its sign
        return line.name == "goal_time" or line.low <= value <= line.high

    def _home(self, position: int) -> None:
        self._motion.home(position)
        self.table.keep("homing_offset")
        self.eeprom_changed = True

    # time

    @property
    def moving(self) -> bool:
        """Return whether the servo's profile moves, so that it must be stepped."""
        return self._motion.moving

    def step(self, dt: float) -> None:
        """Move the profile.

        Args:
            dt: time step [s]
        """
        self._motion.step(dt)

    def protect(self, dt: float) -> None:
        """Warm up, and shut down what overheats, stalls or has the wrong supply.

        Args:
            dt: time since the last call [s]
        """
        left = self._protection.duty_max()
        self._protection.look(dt)
        self._act(left)

    def fail(self, error: int) -> None:
        """Report errors until the servo is told to go on; shut down as its registers say.

        Args:
            error: bits of the status
        """
        left = self._protection.duty_max()
        self._protection.latch(error)
        self._act(left)

    def power_off(self) -> None:
        """Let the shaft go, as a servo without power does."""
        self.table["torque_enable"] = 0
        self._motion.drive(1.0)

    # inside

    def _act(self, left: float) -> None:
        """Take the torque that protection takes."""
        off = self._protection.unloads() and self.table["torque_enable"] != 0
        if off:
            self.table["torque_enable"] = 0
        if off or self._protection.duty_max() != left:
            self._motion.drive(self._protection.duty_max())

    def _read_addresses(self) -> None:
        self.id = self.table["id"]
        self.baud = self._bauds[self.table["baud_rate"]]
        self.return_delay_ns = 2000 * self.table["return_delay"]

    def _measure(self) -> None:
        """Bring the registers that the servo measures up to date."""
        table, shaft, motion = self.table, self._shaft, self._motion
        speed = motion.speed()
        table["present_position"] = motion.position()
        table["present_speed"] = speed
        table["present_load"] = round(1000.0 * shaft.duty())
        table["present_voltage"] = round(10.0 * shaft.supply())
        table["present_temperature"] = round(self._protection.temperature_c)
        table["async_flag"] = int(self._registered is not None)
        table["status"] = self._protection.status()
        table["moving"] = int(motion.moving or abs(speed) > _MOVING_COUNTS_S)
        if "present_current" in table.lines:
            table["present_current"] = round(shaft.current() / table.lines["present_current"].scale)
