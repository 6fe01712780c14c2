"""The control table of a servo with protocol 1 framing: bytes that are written one by one, and what outlives power."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from controller.registers import Register, decode_register, encode_register


class ByteTable:
    """Hold the registers of one servo, as they are now and as they will be after the next power-up.

    Args:
        lines: the product's registers, from `controller.registers`
    """

    def __init__(self, lines: Mapping[str, Register]) -> None:
        self.lines = lines
        self.end = max(line.address + line.size for line in lines.values())
        self._memory = bytearray(256)
        self._owner: dict[int, Register] = {
            address: line for line in lines.values() for address in range(line.address, line.address + line.size)
        }
        self._bytes = {line.name: line.address for line in lines.values() if line.size == 1 and not line.signed}
        self._kept = {line.name: line.initial for line in lines.values() if line.eeprom}
        self.power_up()

    def __getitem__(self, name: str) -> int:
        """Return a register's count."""
        address = self._bytes.get(name)
        if address is not None:
            return self._memory[address]
        line = self.lines[name]
        return decode_register(line, bytes(self._memory[line.address : line.address + line.size]))

    def __setitem__(self, name: str, value: int) -> None:
        """Set a register's count for now, as the servo itself does: no rules, but nearest to the value that fits."""
        line = self.lines[name]
        bits = line.sign_bit or 8 * line.size
        high = (1 << bits) - 1
        value = min(max(value, -high if line.signed else 0), high)
        self._memory[line.address : line.address + line.size] = encode_register(line, value)

    def word(self, name: str) -> int:
        """Return all bits of a register as they were written, with no sign.

        Args:
            name: the register
        """
        line = self.lines[name]
        return int.from_bytes(self._memory[line.address : line.address + line.size], line.byte_order)

    def counts(self) -> dict[str, int]:
        """Return what a master can set, by register name."""
        return {name: self[name] for name, line in self.lines.items() if line.access == "rw"}

    def keep(self, name: str) -> None:
        """Let a register's count outlive power.

        Args:
            name: a register in EEPROM
        """
        self._kept[name] = self[name]

    def eeprom(self) -> dict[str, int]:
        """Return what the servo keeps without power, by register name, but for what nobody can write."""
        return {name: value for name, value in self._kept.items() if self.lines[name].access == "rw"}

    def load(self, eeprom: Mapping[str, int]) -> None:
        """Set what the servo keeps, and power it up with it.

        Args:
            eeprom: register name => count, where they are not as they were
        """
        self._kept.update(eeprom)
        self.power_up()

    def power_up(self) -> None:
        """Set all registers to what a servo has when its power comes."""
        self._memory[:] = bytes(len(self._memory))
        for name, line in self.lines.items():
            self[name] = self._kept.get(name, line.initial)

    def factory(self) -> None:
        """Forget everything that was ever written."""
        self._kept = {name: self.lines[name].initial for name in self._kept}
        self.power_up()

    def read(self, address: int, length: int) -> bytes:
        """Return bytes; those between registers and beyond the last one are 0 unless they were put there.

        Args:
            address: first byte
            length: bytes
        """
        return bytes(self._memory[byte & 0xFF] for byte in range(address, address + length))

    def put(self, address: int, data: bytes) -> None:
        """Set bytes that belong to no register.

        Args:
            address: first byte
            data: the bytes, of which those that belong to a register are left out
        """
        for byte, value in enumerate(data, address):
            if byte not in self._owner and byte < len(self._memory):
                self._memory[byte] = value

    def touched(self, address: int, data: bytes) -> Iterator[tuple[Register, bytes, int]]:
        """Yield the registers that bytes belong to, each with its bytes and its count as they would be.

        Args:
            address: first byte
            data: the bytes
        """
        place, end = address, address + len(data)
        while place < end:
            line = self._owner.get(place)
            if line is None:
                place += 1
                continue
            merged = bytes(
                data[byte - address] if address <= byte < end else self._memory[byte]
                for byte in range(line.address, line.address + line.size)
            )
            yield line, merged, decode_register(line, merged)
            place = line.address + line.size

    def take(self, line: Register, data: bytes) -> None:
        """Set a register's bytes.

        Args:
            line: the register
            data: its bytes, (line.size,)
        """
        self._memory[line.address : line.address + line.size] = data
