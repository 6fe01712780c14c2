"""Take what the sensor node has sent, without ever waiting for it."""

from __future__ import annotations

from typing import Any, Final

import serial

from deploy.buses.port import PortLostError, open_serial
from deploy.buses.port_lock import PortLock

BAUD: Final = 115200
_CHUNK: Final = 65536


class SensorPort:
    """Read a sensor node's serial device, pty or socket; close it after use.

    Args:
        path: device path or ``socket://HOST:PORT``

    Raises:
        InputError: if it can not be opened, or is in use
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._lock = PortLock(path)
        try:
            self._serial: Any = open_serial(path, BAUD)
        except BaseException:
            self._lock.close()
            raise

    def read_available(self) -> bytes:
        """Return the bytes that have arrived.

        Raises:
            PortLostError: if the port is gone
        """
        try:
            return bytes(self._serial.read(_CHUNK))
        except (OSError, serial.SerialException):
            raise PortLostError(f"{self.path}: the sensor port is gone; check cable and sensor node") from None

    def close(self) -> None:
        """Close the port and release its lock."""
        self._serial.close()
        self._lock.close()
