"""A pseudo terminal as one end of a serial line: clients open its path as they would open a device."""

from __future__ import annotations

import array
import fcntl
import os
import select
import struct
import termios
import time
import tty
from types import TracebackType
from typing import Final

from controller.errors import RunError

QUEUE_MAX: Final = 4000
"""Bytes that may wait for a client: the terminal's own queue holds 4,095."""

_CHUNK: Final = 65536
_TCGETS2: Final = 0x802C542A  # termios with its speeds as numbers, on x86, Arm and RISC-V
_TERMIOS2: Final = struct.Struct("=4I20B2I")
_ARRIVAL_S_MAX: Final = 10.0


class PtyLine:
    """Hold a pseudo terminal open at both ends, so that clients may come and go.

    Raises:
        RunError: the machine gives no pseudo terminal
    """

    def __init__(self) -> None:
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise RunError(
                f"the machine gives no pseudo terminal ({error.strerror}); close some and try again"
            ) from None
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)

    def __enter__(self) -> PtyLine:
        """Return the line."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the line."""
        self.close()

    def close(self) -> None:
        """Close both ends; a client sees its device vanish."""
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)
        self._master = self._slave = -1

    def fileno(self) -> int:
        """Return the file descriptor to wait on."""
        return self._master

    def read(self, expected: int = 0) -> bytes:
        """Return what clients have sent.

        Args:
            expected: bytes that are known to have been sent: wait for them, for the kernel hands them over later

        Raises:
            RunError: they do not come
        """
        data = self._read_now()
        deadline = time.monotonic() + _ARRIVAL_S_MAX
        while len(data) < expected:
            _wait(self._master, deadline, self.path)
            data += self._read_now()
        return data

    def write(self, data: bytes) -> int:
        """Send to the client; return how many bytes were taken.

        Args:
            data: the bytes
        """
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def write_through(self, data: bytes) -> int:
        """Send to the client, and return when it can read all that was taken; return how much that is.

        Only for a client that does not read meanwhile, as one in the same thread.

        Args:
            data: the bytes

        Raises:
            RunError: they do not arrive
        """
        before = self.queued()
        taken = self.write(data[: max(0, QUEUE_MAX - before)])
        deadline = time.monotonic() + _ARRIVAL_S_MAX
        while self.queued() < before + taken:
            _wait(self._slave, deadline, self.path)
        return taken

    def queued(self) -> int:
        """Return how many bytes wait for the client."""
        count = array.array("i", [0])
        fcntl.ioctl(self._slave, termios.FIONREAD, count)
        return count[0]

    def drop_queued(self) -> None:
        """Forget what waits for a client that does not read."""
        termios.tcflush(self._slave, termios.TCIFLUSH)

    def baud(self) -> int | None:
        """Return the bit rate that the client has set, or None where the machine does not tell."""
        try:
            answer = fcntl.ioctl(self._master, _TCGETS2, bytes(_TERMIOS2.size))
        except OSError:
            return None
        return int(_TERMIOS2.unpack(answer)[-1])

    def _read_now(self) -> bytes:
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""


def _wait(end: int, deadline: float, path: str) -> None:
    """Wait for the kernel to hand bytes over."""
    if time.monotonic() > deadline:
        raise RunError(f"{path}: the pseudo terminal lost bytes; restart the rig")
    select.select([end], [], [], 1e-3)
