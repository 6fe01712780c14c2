"""Control tables as manuals print them, and what a master may expect to read: written without the servos' own code."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from controller.rig_file import load_rig

GOLDEN = Path(__file__).parent / "golden"


@dataclass(frozen=True)
class Item:
    """One line of a control table.

    `initial` is None where the manual gives no number; `sign_bit` is the bit of a sign-magnitude number, else None.
    """

    name: str
    address: int
    size: int
    eeprom: bool
    writable: bool
    initial: int | None
    low: int
    high: int
    big: bool = False
    sign_bit: int | None = None

    @property
    def end(self) -> int:
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        if self.sign_bit is not None and value < 0:
            value = -value | 1 << self.sign_bit
        return (value % (1 << 8 * self.size)).to_bytes(self.size, "big" if self.big else "little")

    def decode(self, data: bytes) -> int:
        value = int.from_bytes(data, "big" if self.big else "little")
        if self.sign_bit is not None:
            return -(value & ~(1 << self.sign_bit)) if value >> self.sign_bit & 1 else value
        return value - (1 << 8 * self.size) if self.low < 0 and value >> (8 * self.size - 1) else value


def load_items(file: str, product: str, *, big: bool = False) -> dict[str, Item]:
    """Read a product's column of a golden table: `initial:low:high`, then `:sN` where bit N is a sign."""
    lines = [line for line in (GOLDEN / file).read_text().splitlines() if not line.startswith("#")]
    items = {}
    for row in csv.DictReader(lines):
        if row[product]:
            initial, low, high, *sign = row[product].split(":")
            items[row["name"]] = Item(
                row["name"],
                int(row["address"]),
                int(row["size"]),
                row["area"] == "E",
                row["access"] == "rw",
                int(initial) if initial else None,
                int(low),
                int(high),
                big,
                int(sign[0][1:]) if sign else None,
            )
    return items


class Memory:
    """What a servo's items should hold; None where the manual does not say, until a reply tells."""

    def __init__(self, items: dict[str, Item], measured: frozenset[str]) -> None:
        self.items = items
        self.measured = measured
        self.values: dict[str, int | None] = {}
        self.start(eeprom=True)

    def start(self, *, eeprom: bool) -> None:
        for item in self.items.values():
            if eeprom or not item.eeprom:
                self.values[item.name] = item.initial

    def __getitem__(self, name: str) -> int | None:
        return self.values[name]

    def __setitem__(self, name: str, value: int | None) -> None:
        self.values[name] = value

    def forget(self, *names: str) -> None:
        for name in names:
            if name in self.values:
                self.values[name] = None

    def covered(self, address: int, length: int) -> list[Item]:
        """Return the items that lie wholly in a block."""
        return [item for item in self.items.values() if address <= item.address and item.end <= address + length]

    def check(self, address: int, data: bytes) -> None:
        """Hold what was read to what is expected, and learn what was not known."""
        for item in self.covered(address, len(data)):
            held = item.decode(data[item.address - address : item.end - address])
            if item.name in self.measured:
                assert item.low <= held <= item.high, f"{item.name} reads {held}"
                continue
            expected = self.values[item.name]
            assert expected is None or held == expected, f"{item.name} reads {held}, should hold {expected}"
            self.values[item.name] = held


def scs_text() -> str:
    """Return a rig file of the small lamp on SCS0009 servos, of which no rig is shipped."""
    changed = {
        "zero_tick = 2048": "zero_tick = 511",
        "watchdog_s = 0.1": "watchdog_s = 0.0",
        "p_gain = 1450": "p_gain = 100",
        "pwm_limit = 885\n": "\n",
        '"xl330-m288"': '"scs0009"',
        '"dynamixel-2.0"': '"feetech-scs"',
    }
    text = load_rig("lamp-xl330").text
    for old, new in changed.items():
        text = text.replace(old, new)
    return text
