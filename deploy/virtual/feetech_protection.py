"""How a Feetech servo protects itself: voltage, heat, current and overload, by its registers."""

from __future__ import annotations

from typing import Final

from controller.products import Product
from deploy.virtual.byte_table import ByteTable
from deploy.virtual.drive import Shaft
from deploy.virtual.heat import AMBIENT_C, stands, warmed

ERROR_VOLTAGE: Final = 0x01
ERROR_HEAT: Final = 0x04
ERROR_CURRENT: Final = 0x08
ERROR_OVERLOAD: Final = 0x20


class FeetechProtection:
    """Watch over a Feetech servo.

    Voltage and heat are reported while they last, current and overload until the servo is told to go on: by a write to
    torque enable, or by a goal that `relieve` lets count.

    Args:
        product: which servo
        table: its registers
        shaft: what it turns
    """

    def __init__(self, product: Product, table: ByteTable, shaft: Shaft) -> None:
        self._product = product
        self._table = table
        self._shaft = shaft
        self.temperature_c = AMBIENT_C
        self.power_up()

    def power_up(self) -> None:
        """Forget what was wrong, but not how warm the motor is."""
        self._latched = 0
        self._overload_s = 0.0
        self._current_s = 0.0
        self._push = 0.0

    def look(self, dt: float) -> None:
        """Bring what is wrong up to date.

        The motor is overloaded when it stands, or nearly so, at the overload torque for the protection time. A wheel at
        full speed is not: its PWM is high, its torque is not.

        Args:
            dt: time since the last call [s]
        """
        product, table, shaft = self._product, self._table, self._shaft
        torque = shaft.torque()
        self.temperature_c = warmed(product, self.temperature_c, torque, dt)
        stall = product.stall_torque_nm * shaft.supply() / product.voltage_v
        loaded = stands(product, shaft.speed()) and abs(torque) >= max(table["overload_torque"] / 100.0 * stall, 1e-9)
        self._overload_s = self._overload_s + dt if loaded else 0.0
        if self._overload_s > table["protection_time"] * table.lines["protection_time"].scale:
            self.latch(ERROR_OVERLOAD)
        if "protection_current" in table.lines:
            limit_a = table["protection_current"] * table.lines["protection_current"].scale
            self._current_s = self._current_s + dt if abs(shaft.current()) > limit_a else 0.0
            if self._current_s > table["overcurrent_time"] * table.lines["overcurrent_time"].scale:
                self.latch(ERROR_CURRENT)

    def latch(self, error: int) -> None:
        """Report errors until the servo is told to go on.

        Args:
            error: bits of the status
        """
        if error & ~self._latched:
            self._push = self._shaft.torque()
        self._latched |= error

    def relieve(self, way: float | None) -> None:
        """Let a command end what it can end.

        Args:
            way: from present position to a new goal, None: torque was switched. An SCS goes on with any new goal, an
                STS with one that leads away from what it pushes against: the latter is an estimate
        """
        if way is not None and "protection_current" in self._table.lines and way * self._push >= 0.0:
            return
        self._latched = 0
        self._overload_s = 0.0
        self._current_s = 0.0

    def status(self) -> int:
        """Return what is wrong: the status register, and the error byte of every reply."""
        table = self._table
        volts = round(10.0 * self._shaft.supply())
        error = self._latched
        if not table["min_voltage_limit"] <= volts <= table["max_voltage_limit"]:
            error |= ERROR_VOLTAGE
        if self.temperature_c > table["max_temperature_limit"]:
            error |= ERROR_HEAT
        return error

    def unloads(self) -> bool:
        """Return whether something is wrong that the unloading condition names, overload aside: torque goes off."""
        return bool(self.status() & self._table["unloading_condition"] & ~ERROR_OVERLOAD)

    def duty_max(self) -> float:
        """Return what is left of the duty: after an overload that the unloading condition names, the protective torque.

        Returns:
            share of full duty
        """
        overloaded = self._latched & self._table["unloading_condition"] & ERROR_OVERLOAD
        return self._table["protective_torque"] / 100.0 if overloaded else 1.0
