"""Run firmware as a process of this machine, built for the `host` board: it waits where we tell it what has come.

The twin writes ``W`` and when it wants to wake, ``B`` and ``C`` with what it sends on bus and console, all little
endian; each ``W`` is answered with the time, the inputs and what has come on the three lines.
"""

from __future__ import annotations

import os
import select
import signal
import struct
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Final

from controller.errors import InputError, RunError
from deploy.firmware.machine import Given, Taken

BYTES_MAX: Final = 1 << 20
"""A twin that sends more than this between two waits is not well."""

_WORK_S_MAX: Final = 30.0
"""So long may it work between two waits: thousands of times what it needs on a busy machine."""
_CHUNK: Final = 65536
_TOLD_MAX: Final = 300


class TwinProcess:
    """Hold a process of the native twin; close it after use.

    Args:
        program: the executable, as `servolve firmware --board host --build` makes it

    Raises:
        InputError: there is no such program, or it can not be started
    """

    def __init__(self, program: str | Path) -> None:
        self._path = Path(program)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the process
        self._received = bytearray()
        self._booted = False
        self._sent = 0
        try:
            self._process = subprocess.Popen(
                [str(self._path.absolute())],
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                start_new_session=True,  # Ctrl-C is for us: we tell it to stop in its own words
            )
        except OSError as error:
            self._errors.close()
            raise InputError(
                f"{self._path}: can not be started ({error.strerror}); build it with servolve firmware --board host "
                "--build"
            ) from None

    def __enter__(self) -> TwinProcess:
        """Return the twin."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process."""
        self.close()

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        return self._process.pid

    def resume(self, given: Given) -> Taken:
        """Wake the twin and let it work until it waits.

        Args:
            given: what has come since the last call

        Returns:
            what it has done

        Raises:
            RunError: it has died, or does not come to wait
        """
        self._sent = 0
        boot: list[bytes] = []
        bus: list[bytes] = []
        console = bytearray()
        if not self._booted:
            self._booted = True
            self._until_it_waits(boot, console)
        self._answer(given)
        until_us = self._until_it_waits(bus, console)
        return Taken(until_us, tuple(bus), bytes(console), tuple(boot))

    def close(self) -> None:
        """End the process; a twin whose input has ended goes by itself."""
        if self._errors.closed:
            return
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._errors.close()

    # inside

    def _answer(self, given: Given) -> None:
        data = struct.pack("<qI", given.now_us, given.inputs)
        for line in (given.bus, given.sensors, given.console):
            data += struct.pack("<I", len(line)) + line
        stdin = self._process.stdin
        assert stdin is not None
        try:
            while data:
                data = data[stdin.write(data) :]
        except (BrokenPipeError, ValueError):
            raise self._died() from None

    def _until_it_waits(self, bus: list[bytes], console: bytearray) -> int:
        """Collect what the twin sends; return when it wants to wake [us]."""
        deadline = time.monotonic() + _WORK_S_MAX
        while True:
            (kind,) = self._take(1, deadline)
            if kind == ord("W"):
                return int.from_bytes(self._take(8, deadline), "little", signed=True)
            if kind not in b"BC":
                raise RunError(
                    f"{self._path}: sends {kind:#04x}, which no twin does; build it again with this servolve"
                )
            size = int.from_bytes(self._take(4, deadline), "little")
            self._sent += size
            if self._sent > BYTES_MAX:
                raise RunError(
                    f"{self._path}: sends more than {BYTES_MAX} bytes without waiting; this is a defect in it"
                )
            data = self._take(size, deadline)
            if kind == ord("B"):
                bus.append(data)
            else:
                console += data

    def _take(self, size: int, deadline: float) -> bytes:
        stdout = self._process.stdout
        assert stdout is not None
        while len(self._received) < size:
            if not select.select([stdout], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise RunError(f"{self._path}: has not come to wait for {_WORK_S_MAX:g} s; it hangs")
            data = os.read(stdout.fileno(), _CHUNK)
            if not data:
                raise self._died()
            self._received += data
        taken = bytes(self._received[:size])
        del self._received[:size]
        return taken

    def _died(self) -> RunError:
        """Say how the process has ended."""
        try:
            status = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return RunError(f"{self._path}: has closed its output and goes on; it is no twin, build it again")
        how = f"with exit status {status}" if status >= 0 else f"by {signal.Signals(-status).name}"
        self._errors.seek(0)
        said = " ".join(self._errors.read().decode(errors="replace").split())[:_TOLD_MAX]
        return RunError(f"{self._path}: the native twin has ended {how}" + (f"; it said: {said}" if said else ""))
