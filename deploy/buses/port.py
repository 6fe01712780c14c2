"""Serve a bus to the vendor's SDK: the `PortHandler` it expects, without its busy waits and its wall clock.

The SDK polls `readPort` and `isPacketTimeout` in a tight loop. Here `readPort` waits in ``select()`` until a byte or
the deadline comes, time is monotonic, and a deadline is only past when no byte is waiting either: a process that was
descheduled does not lose a reply that has long arrived.
"""

# The SDK chose the method names.
# ruff: noqa: N802

from __future__ import annotations

import errno
import os
import re
import select
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import serial
from dynamixel_sdk.port_handler import PortHandler

from controller.errors import InputError, RunError
from deploy.buses.port_lock import PortLock

Direction: TypeAlias = Literal["tx", "rx", "stray"]
Tap: TypeAlias = Callable[[Direction, float, bytes], None]
"""Called with each frame sent, all that a transaction read, all that nobody asked for, and the time of it [s]."""

BITS_PER_BYTE: Final = 10
_SOCKET: Final = re.compile(r"socket://[^:/?#]+:\d{1,5}/?")
_CHUNK: Final = 4096
_WRITE_TIMEOUT_S: Final = 0.25
_PROCESS_LATENCY_S: Final = 0.015
"""Behind a pseudo terminal or a socket is a process that must be scheduled before it answers."""
_DEVICE_LATENCY_S: Final = 0.004
"""A device's driver must be, and this process."""


class PortLostError(RunError):
    """Report that the port is gone: nothing can be sent any more."""


def open_serial(path: str, baud: int) -> serial.SerialBase:
    """Open a serial device or a ``socket://HOST:PORT``, without waits in its reads.

    Args:
        path: device path or URL
        baud: [bits/s]

    Returns:
        the open port

    Raises:
        InputError: if it can not be opened
    """
    if path.startswith("socket://") and not _SOCKET.fullmatch(path):
        raise InputError(f"{path}: cannot be opened; write socket://HOST:PORT, as socket://localhost:4000")
    try:
        port: serial.SerialBase = serial.serial_for_url(path, baudrate=baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S)
        if "://" in path:
            # a question must not wait for the acknowledgement of the one before it
            with socket.socket(fileno=os.dup(port.fileno())) as same:
                same.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return port
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be opened as a serial port ({_reason(error)}); check the path and the cable"
        ) from None


def _reason(error: Exception) -> str:
    """Return what the operating system says, which pyserial and termios wrap each in its own way."""
    numbers = [
        error.errno if isinstance(error, OSError) else None,
        *error.args[:1],
        getattr(error, "__context__", None),
    ]
    numbers += [number.args[0] for number in numbers if isinstance(number, Exception) and number.args]
    known = next((number for number in numbers if isinstance(number, int) and number in errno.errorcode), None)
    if known is not None:
        return os.strerror(known)
    return re.sub(r"^\[Errno -?\d+\] ", "", str(error).split(": ")[-1])


def usb_latency_s(path: str) -> float | None:
    """Return how long a USB serial adapter holds bytes back, or None where it does not say.

    Args:
        path: device path

    Returns:
        latency timer [s]
    """
    timer = Path("/sys/bus/usb-serial/devices") / Path(path).resolve().name / "latency_timer"
    try:
        return int(timer.read_text()) * 1e-3
    except (OSError, ValueError):
        return None


def _latency_s(path: str) -> float:
    """Return how late a reply may come, beyond its time on the line [s]."""
    if "://" in path or str(Path(path).resolve()).startswith("/dev/pts/"):
        return _PROCESS_LATENCY_S
    return (usb_latency_s(path) or 0.0) + _DEVICE_LATENCY_S


class SerialPort(PortHandler):
    """Serve a serial device, a pty or a socket in real time.

    Args:
        path: device path or ``socket://HOST:PORT``
        baud: [bits/s]
    """

    def __init__(self, path: str, baud: int) -> None:
        PortHandler.__init__(self, path)
        self.baudrate = baud
        self.label = path
        self.tap: Tap | None = None
        self.sent = b""
        self.strays = 0
        self.latency_s = _latency_s(path)
        self.byte_s = BITS_PER_BYTE / baud
        self._serial: Any = None
        self._buffer = bytearray()
        self._received = bytearray()
        self._received_at = 0.0
        self._deadline = 0.0
        self._line_free = 0.0
        self._lock = PortLock(path)
        try:
            self.setupPort(baud)
        except BaseException:
            self._lock.close()
            raise

    # time and waiting: what lock step does otherwise

    def now(self) -> float:
        """Return the port's time [s]."""
        return time.monotonic()

    def wait(self, deadline: float) -> bool:
        """Wait for a byte.

        Args:
            deadline: until when [s]

        Returns:
            whether a byte is waiting
        """
        return self.waiting(max(0.0, deadline - self.now()))

    def waiting(self, for_s: float = 0.0) -> bool:
        """Return whether a byte can be read from the device.

        Args:
            for_s: how long one may take to come [s]
        """
        try:
            return bool(select.select([self._serial.fileno()], [], [], for_s)[0])
        except (OSError, ValueError) as error:
            raise self._lost(error) from None

    # what the SDK calls

    def setupPort(self, cflag_baud: int) -> bool:
        """Open the port; a change of baud rate opens it anew."""
        if self.is_open:
            self._serial.close()
        self._serial = open_serial(self.port_name, cflag_baud)
        self.is_open = True
        self.byte_s = BITS_PER_BYTE / cflag_baud
        self.tx_time_per_byte = 1e3 * self.byte_s
        return True

    def reopen(self) -> bool:
        """Open the port anew after it was lost; return whether it is back."""
        self.closePort()
        try:
            self._lock = PortLock(self.port_name)
            return self.setupPort(self.baudrate)
        except InputError:
            self.closePort()
            return False

    def closePort(self) -> None:
        """Close the port and release its lock."""
        if self.is_open:
            self.is_open = False
            self._serial.close()
        self._lock.close()

    def clearPort(self) -> None:
        """Drop every byte that waits: it answers nothing that will be asked now."""
        self.end_transaction()
        self.drop_waiting()

    def getBytesAvailable(self) -> int:
        """Return how many bytes could be read at once."""
        while self.waiting():
            self._take()
        return len(self._buffer)

    def readPort(self, length: int) -> bytes:
        """Return up to length bytes; wait for the first until the deadline."""
        if length <= 0:  # the SDKs ask so where a packet says that it is shorter than any
            return b""
        if not self._buffer and self.wait(self._deadline):
            self._take()
        taken = bytes(self._buffer[:length])
        del self._buffer[:length]
        return taken

    def writePort(self, packet: list[int] | bytes) -> int:
        """Send a packet; return how many bytes went out."""
        frame = self.sent = bytes(packet)
        if self.tap:
            self.tap("tx", self.now(), frame)
        try:
            sent = self._serial.write(frame)
        except serial.SerialTimeoutException:
            return 0
        except (OSError, serial.SerialException) as error:
            raise self._lost(error) from None
        self._line_free = max(self._line_free, self.now()) + len(frame) * self.byte_s
        return int(sent)

    def setPacketTimeout(self, packet_length: int) -> None:
        """Set the deadline of one reply of packet_length bytes."""
        self.expect(packet_length, 1, 0.0)

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Set the deadline msec milliseconds from now."""
        self._deadline = self.now() + 1e-3 * msec

    def isPacketTimeout(self) -> bool:
        """Return whether the deadline is past and nothing has come."""
        return self.now() >= self._deadline and not self._buffer and not self.waiting()

    def getCurrentTime(self) -> float:
        """Return the port's time [ms]."""
        return 1e3 * self.now()

    # what the bus adapter calls

    def expect(self, nbyte: int, nreply: int, return_delay_s: float) -> None:
        """Set the deadline of the replies to what has just been sent.

        Args:
            nbyte: bytes of all replies together
            nreply: how many replies
            return_delay_s: how long a servo waits before it replies [s]
        """
        asked = max(self._line_free, self.now())
        self._deadline = asked + nbyte * self.byte_s + nreply * return_delay_s + self.latency_s

    def put_back(self, data: bytes) -> None:
        """Let bytes be read again, before those that wait.

        Args:
            data: what `readPort` gave
        """
        self._buffer[:0] = data

    def drop_read(self) -> None:
        """Drop what was read and not used: it was part of a transaction that is over."""
        self._buffer.clear()

    def drop_waiting(self) -> int:
        """Drop every byte that waits; return how many that were."""
        while self.waiting():
            self._take()
        count = len(self._buffer)
        self.strays += count
        self.end_transaction("stray")
        self._buffer.clear()
        return count

    def end_transaction(self, direction: Direction = "rx") -> None:
        """Hand what was read since the last call to the tap, as one frame.

        Args:
            direction: "rx", or "stray" for bytes that nobody asked for
        """
        if self._received and self.tap:
            self.tap(direction, self._received_at, bytes(self._received))
        self._received.clear()

    def _take(self) -> None:
        try:
            data = self._serial.read(_CHUNK)
        except (OSError, serial.SerialException) as error:
            raise self._lost(error) from None
        self._received += data
        self._received_at = self.now()
        self._buffer += data

    def _lost(self, error: Exception) -> PortLostError:
        return PortLostError(
            f"{self.label}: the port is gone, so nothing more can be sent; servos that have a bus watchdog are stopped "
            f"by it; check cable and adapter ({type(error).__name__})"
        )
