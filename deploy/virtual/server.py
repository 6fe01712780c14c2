"""Serve a virtual rig in real time to other processes: pseudo terminals for bus and sensor node, and TCP for the bus.

One thread waits in ``select()`` for bytes and for the rig's own deadlines. The rig's time follows the clock, but never
jumps: when the machine stalls, the rig's time slips, so that a busy machine makes the rig slow, not its servos deaf.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from pathlib import Path
from types import TracebackType
from typing import Final

from controller.errors import InputError
from deploy.virtual.control_channel import ControlChannel
from deploy.virtual.pty_line import QUEUE_MAX, PtyLine
from deploy.virtual.rig import VirtualRig

TICK_S: Final = 0.005
"""The rig moves at least this often [s]."""

STALL_S: Final = 0.02
"""A longer pause of the machine is no time for the rig [s]."""

LOOPBACK: Final = "127.0.0.1"
_CHUNK: Final = 65536


class RigServer:
    """Hold the lines of a virtual rig open to other processes.

    Args:
        rig: the virtual rig
        link: path of a symbolic link to the bus's terminal, or None
        sensor_link: path of a symbolic link to the sensor node's terminal, or None
        tcp_port: TCP port that is the bus too, 0: any free one, None: none
        host: address of this machine on which the TCP port is open
        control: path of a socket on which other programs change faults and see the state, or None

    Raises:
        InputError: a link's path is taken, or the TCP port or the control socket is
        RunError: the machine gives no pseudo terminal
    """

    def __init__(
        self,
        rig: VirtualRig,
        *,
        link: Path | None = None,
        sensor_link: Path | None = None,
        tcp_port: int | None = None,
        host: str = LOOPBACK,
        control: Path | None = None,
    ) -> None:
        if link is not None and link == sensor_link:
            raise InputError(f"{link}: is to be the link of both bus and sensor node; give them two paths")
        self.slipped_s = 0.0
        self._rig = rig
        self._now = rig.now
        self._clock = time.monotonic()
        self._links: list[tuple[Path, str]] = []
        self._client: socket.socket | None = None
        self._asked: PtyLine | socket.socket | None = None
        self._listener = _listen(host, tcp_port) if tcp_port is not None else None
        self._wake_read, self._wake_write = os.pipe()
        self._control: ControlChannel | None = None
        self._link = link
        self._plugged = True
        self._bus = PtyLine()
        self._sensors = PtyLine()
        try:
            self._make_link(link, self._bus)
            self._make_link(sensor_link, self._sensors)
            self._control = None if control is None else ControlChannel(control)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> RigServer:
        """Return the server."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the lines and remove the links."""
        self.close()

    def close(self) -> None:
        """Close the lines and remove the links."""
        self._remove_links(self._bus, self._sensors)
        self._drop_client()
        if self._control:
            self._control.close()
        if self._listener:
            self._listener.close()
        self._bus.close()
        self._sensors.close()
        for end in (self._wake_read, self._wake_write):
            os.close(end)

    @property
    def bus_path(self) -> str:
        """Return the device that the servo bus is."""
        return self._bus.path

    @property
    def sensor_path(self) -> str:
        """Return the device that the sensor node is."""
        return self._sensors.path

    @property
    def tcp_port(self) -> int | None:
        """Return the TCP port that the servo bus is too, or None."""
        return int(self._listener.getsockname()[1]) if self._listener else None

    def stop(self) -> None:
        """Make `run` return; may be called from a signal handler or another thread."""
        os.write(self._wake_write, b".")

    def run(self) -> None:
        """Serve until `stop`.

        Raises:
            RunError: the rig's physics diverged
        """
        self._clock = time.monotonic()
        while True:
            sources: list[int | PtyLine | socket.socket] = [self._wake_read]
            sources += [self._bus] if self._plugged else []
            sources += [source for source in (self._listener, self._client) if source]
            sources += self._control.sockets() if self._control else []
            ready = select.select(sources, [], [], max(0.0, self._deadline() - self._now))[0]
            self._tick()
            if self._wake_read in ready:
                os.read(self._wake_read, _CHUNK)
                return
            if self._listener in ready:
                self._accept()
            if self._bus in ready:
                self._take(self._bus, self._bus.read())
            if self._client in ready:
                self._receive()
            self._rig.advance(self._now)
            if self._control:
                self._control.serve(self._rig)
            self._plug()
            for _, reply in self._rig.replies_until(self._now):
                self._send(reply)
            self._send_lines(self._rig.sensor_until(self._now))

    def _plug(self) -> None:
        """Let the bus's port die or return, as the rig's faults say."""
        if self._plugged and self._rig.unplugged:
            self._plugged = False
            self._remove_links(self._bus)
            self._bus.close()
            self._drop_client()
            self._asked = None
        elif not self._plugged and not self._rig.unplugged:
            self._plugged = True
            self._bus = PtyLine()
            self._make_link(self._link, self._bus)

    def _deadline(self) -> float:
        """Return when something is due next [s]."""
        times = (self._now + TICK_S, self._rig.next_event(), self._rig.next_line())
        return min(at for at in times if at is not None)

    def _tick(self) -> None:
        """Move the rig's time with the clock."""
        clock = time.monotonic()
        passed = clock - self._clock
        self._clock = clock
        self._now += min(passed, STALL_S)
        self.slipped_s += max(0.0, passed - STALL_S)

    def _take(self, source: PtyLine | socket.socket, data: bytes) -> None:
        if data:
            baud = source.baud() if isinstance(source, PtyLine) else None
            self._rig.set_baud(baud or self._rig.rig.bus.baud)
            self._rig.transmit(data, self._now)
            self._asked = source

    def _send(self, reply: bytes) -> None:
        """Send to whoever asked last; what a client does not take is lost, as on a wire."""
        if isinstance(self._asked, PtyLine):
            self._asked.write(reply)
        elif self._asked is not None:
            try:
                self._asked.send(reply)
            except BlockingIOError:
                pass
            except OSError:
                self._drop_client()

    def _send_lines(self, lines: bytes) -> None:
        """Send sensor lines; a client that has not read for long gets the newest."""
        if lines:
            if self._sensors.queued() + len(lines) > QUEUE_MAX:
                self._sensors.drop_queued()
            self._sensors.write(lines)

    def _accept(self) -> None:
        assert self._listener is not None
        client, _ = self._listener.accept()
        if self._client is not None or not self._plugged:
            client.close()  # the bus has one master
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client

    def _receive(self) -> None:
        assert self._client is not None
        try:
            data = self._client.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._take(self._client, data)
        else:
            self._drop_client()

    def _make_link(self, path: Path | None, line: PtyLine) -> None:
        if path is not None:
            _link_to(path, line.path)
            self._links.append((path, line.path))

    def _remove_links(self, *lines: PtyLine) -> None:
        """Remove the links to terminals, unless others have replaced them."""
        for path, target in [link for link in self._links if link[1] in [line.path for line in lines]]:
            if path.is_symlink() and str(path.readlink()) == target:
                path.unlink()
            self._links.remove((path, target))

    def _drop_client(self) -> None:
        if self._client is not None:
            self._client.close()
            if self._asked is self._client:
                self._asked = None
            self._client = None


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(1)
    except socket.gaierror:
        listener.close()
        raise _no_address(host) from None
    except (OSError, OverflowError) as error:
        listener.close()
        if getattr(error, "errno", None) == errno.EADDRNOTAVAIL:
            raise _no_address(host) from None
        reason = getattr(error, "strerror", None) or "out of range"
        raise InputError(f"TCP port {port} can not be used ({reason}); choose another one from 1024 to 65535") from None
    listener.setblocking(False)
    return listener


def _no_address(host: str) -> InputError:
    return InputError(f"host '{host}': is no address of this machine; leave --host out for 127.0.0.1")


def _link_to(path: Path, target: str) -> None:
    """Link a path to a terminal; a link that another run left there is replaced, anything else is not touched."""
    try:
        if path.is_symlink():
            path.unlink()
        path.symlink_to(target)
    except FileExistsError:
        raise InputError(f"{path}: is there already and is no link; remove it or name another path") from None
    except OSError as error:
        raise InputError(
            f"{path}: the link can not be made ({error.strerror}); name a path in a folder of yours"
        ) from None
