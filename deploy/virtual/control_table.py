"""An X servo's control table: bytes, and the rules by which a master may read and write them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from controller.registers import Register
from controller.registers_x import X330_OPERATING_MODES, XL430_OPERATING_MODES
from deploy.virtual.dynamixel2 import (
    ACCESS_ERROR,
    DATA_LENGTH_ERROR,
    DATA_LIMIT_ERROR,
    DATA_RANGE_ERROR,
)

_GOAL_LIMITS: Final[Mapping[str, str]] = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
}
"""Goal => the register that bounds it either way."""

_POSITION_MODE: Final = 3
_PROTOCOLS: Final = frozenset({1, 2, 20, 21, 22})

_INDIRECT_DATA: Final = "indirect_data_"


class ControlTable:
    """Hold the registers of one servo.

    Args:
        lines: the product's registers, from `controller.registers`
    """

    def __init__(self, lines: Mapping[str, Register]) -> None:
        self.lines = lines
        self.end = max(line.address + line.size for line in lines.values())
        self.memory = bytearray(self.end)
        self._counts = dict.fromkeys(lines, 0)
        self._places = {
            name: (line.address, line.address + line.size, 1 << 8 * line.size, line.signed)
            for name, line in lines.items()
        }
        self._owner: list[Register | None] = [None] * self.end
        for line in lines.values():
            for address in range(line.address, line.address + line.size):
                self._owner[address] = line
        # data address => where the indirect address that it stands for is kept
        self._indirect = {
            line.address: lines[f"indirect_address_{name.removeprefix(_INDIRECT_DATA)}"].address
            for name, line in lines.items()
            if name.startswith(_INDIRECT_DATA)
        }
        self.indirect_low = min(self._indirect, default=self.end)
        self.ram = min(line.address for line in lines.values() if not line.eeprom)
        self._modes = X330_OPERATING_MODES if "goal_current" in lines else XL430_OPERATING_MODES
        self.restore(eeprom=True)

    def __getitem__(self, name: str) -> int:
        """Return a register's count."""
        return self._counts[name]

    def __setitem__(self, name: str, value: int) -> None:
        """Set a register's count, as the servo itself does: no rules."""
        if self._counts[name] == value:
            return
        address, end, modulus, signed = self._places[name]
        data = (value % modulus).to_bytes(end - address, "little")
        self.memory[address:end] = data
        self._counts[name] = int.from_bytes(data, "little", signed=signed)

    def restore(self, eeprom: bool) -> None:
        """Set the registers to their initial counts.

        Args:
            eeprom: those too that keep their counts without power
        """
        for name, line in self.lines.items():
            if eeprom or not line.eeprom:
                self[name] = line.initial

    def eeprom(self) -> dict[str, int]:
        """Return what the servo keeps without power, by register name, but for what nobody can write."""
        return {name: self[name] for name, line in self.lines.items() if line.eeprom and line.access == "rw"}

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Return an error number and the bytes that a master reads.

        Bytes between registers read 0, as long as the block ends within the table.

        Args:
            address: first byte
            length: bytes
        """
        if length < 1:
            return DATA_LENGTH_ERROR, b""
        end = address + length
        if end > self.end:
            return ACCESS_ERROR, b""
        if end <= self.indirect_low:
            return 0, bytes(self.memory[address:end])
        return 0, bytes(self.memory[self._target(byte)] for byte in range(address, end))

    def check(self, address: int, data: bytes) -> tuple[int, Sequence[tuple[Register, int]]]:
        """Return an error number and what a master's write would set: all of the block or nothing.

        Args:
            address: first byte
            data: the bytes
        """
        if not data:
            return DATA_LENGTH_ERROR, ()
        if address + len(data) > self.end:
            return ACCESS_ERROR, ()
        written = {self._target(address + offset): byte for offset, byte in enumerate(data)}
        changes: list[tuple[Register, int]] = []
        locked = self["torque_enable"] != 0
        previous: Register | None = None
        for byte in written:
            line = self._owner[byte]
            if line is None or line.access == "r" or (line.eeprom and locked):
                return ACCESS_ERROR, ()
            if line is previous:
                continue
            previous = line
            places = range(line.address, line.address + line.size)
            if not all(place in written for place in places):
                return DATA_LENGTH_ERROR, ()
            value = int.from_bytes(bytes(written[place] for place in places), "little", signed=line.signed)
            error = self._check_value(line, value)
            if error:
                return error, ()
            changes.append((line, value))
        return 0, changes

    def takes(self, line: Register, value: int) -> bool:
        """Return whether a register takes a count, whatever the limit registers say.

        Args:
            line: the register
            value: the count
        """
        if line.name == "operating_mode":
            return value in self._modes
        if line.name == "protocol_type":
            return line.low <= value <= line.high and value in _PROTOCOLS
        return line.low <= value <= line.high

    def _check_value(self, line: Register, value: int) -> int:
        """Return 0 or the error of a value.

        The manual has two errors for a value that is out of bounds and does not say which is whose: here a goal beyond
        its limit registers is a data limit error, any other value outside its register's range a data range error.
        """
        high_name = _GOAL_LIMITS.get(line.name)
        if high_name:
            return 0 if abs(value) <= self[high_name] else DATA_LIMIT_ERROR
        if line.name == "goal_position" and self["operating_mode"] == _POSITION_MODE:
            return 0 if self["min_position_limit"] <= value <= self["max_position_limit"] else DATA_LIMIT_ERROR
        return 0 if self.takes(line, value) else DATA_RANGE_ERROR

    def _target(self, byte: int) -> int:
        """Return the byte that an address means: an indirect data byte stands for the one its address names."""
        at = self._indirect.get(byte)
        if at is None:
            return byte
        target = self.memory[at] | self.memory[at + 1] << 8
        return target if target < self.indirect_low else byte
