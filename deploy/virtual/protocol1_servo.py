"""What servos of protocol 1 have in common: they are silent while they boot, and have no bus watchdog."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from controller.products import Product
from controller.registers import registers
from deploy.virtual.byte_table import ByteTable

BOOT_NS: Final = 300_000_000
"""How long a servo is silent when its power comes: an estimate."""


class Protocol1Servo:
    """Hold a servo's registers, let its power come back, and tell its line what it must know.

    Args:
        product: which servo
        eeprom: what its EEPROM holds where that is not the factory's: register name => count
    """

    def __init__(self, product: Product, eeprom: Mapping[str, int]) -> None:
        self.product = product
        self.table = ByteTable(registers(product))
        self.table.load(eeprom)
        self.eeprom_changed = False
        self._silent_until_ns = 0

    def reboot(self, now_ns: int) -> None:
        """Let the power come back: torque off, RAM as after power-up; be silent meanwhile.

        Args:
            now_ns: time [ns]
        """
        self.table.power_up()
        self._start()
        self._silent_until_ns = now_ns + BOOT_NS

    def _start(self) -> None:
        """Begin as after power-up, with the registers as they are: each servo in its own way."""
        raise NotImplementedError

    # what the line needs to know

    def silent(self, now_ns: int) -> bool:
        """Return whether the servo is booting.

        Args:
            now_ns: time [ns]
        """
        return now_ns < self._silent_until_ns

    def hear(self, now_ns: int) -> None:
        """Do nothing: the servo has no bus watchdog.

        Args:
            now_ns: time [ns]
        """

    def watchdog_ns(self) -> int | None:
        """Return None: the servo has no bus watchdog."""
        return None

    def trip_watchdog(self) -> None:
        """Do nothing: the servo has no bus watchdog."""
