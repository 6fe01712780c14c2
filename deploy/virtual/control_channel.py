"""A local socket on which other programs change a virtual rig's faults, and see its time and state, while it runs.

Each line of a client is a JSON object, and is answered by one. Tests in any language can drive a rig so.
"""

from __future__ import annotations

import json
import select
import socket
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from controller.errors import InputError
from deploy.virtual.faults import read_faults
from deploy.virtual.rig import VirtualRig

REQUESTS: Final = ("faults", "state", "time", "upright")
LINE_MAX: Final = 65536
"""Bytes of a request, at most."""

_CLIENTS_MAX: Final = 16


class ControlChannel:
    """Listen at a path for programs of this machine.

    Args:
        path: where the socket shall be

    Raises:
        InputError: it can not be there
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._listener = _listen(path)
        self._clients: dict[socket.socket, bytearray] = {}

    def __enter__(self) -> ControlChannel:
        """Return the channel."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Drop all clients and remove the socket."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        self._listener.close()
        self.path.unlink(missing_ok=True)

    def sockets(self) -> list[socket.socket]:
        """Return what to wait on."""
        return [self._listener, *self._clients]

    def serve(self, rig: VirtualRig) -> None:
        """Answer what has arrived.

        Args:
            rig: the virtual rig
        """
        for ready in select.select(self.sockets(), [], [], 0.0)[0]:
            if ready is self._listener:
                self._accept()
            else:
                self._receive(ready, rig)

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        if len(self._clients) >= _CLIENTS_MAX:
            client.close()
            return
        client.setblocking(False)
        self._clients[client] = bytearray()

    def _receive(self, client: socket.socket, rig: VirtualRig) -> None:
        unread = self._clients[client]
        try:
            data = client.recv(LINE_MAX)
            unread += data
            while (end := unread.find(b"\n")) >= 0:
                line = bytes(unread[:end])
                del unread[: end + 1]
                client.sendall(answer_request(rig, line) + b"\n")
        except OSError:  # gone, or it does not read its answers
            data = b""
        if not data or len(unread) > LINE_MAX:
            client.close()
            del self._clients[client]


def answer_request(rig: VirtualRig, line: bytes) -> bytes:
    """Carry out a request; return the answer, without a line end.

    Args:
        rig: the virtual rig
        line: a JSON object, without its line end
    """
    try:
        request = _request(line)
        if "faults" in request:
            rig.set_faults(read_faults(request["faults"]))
        if "upright" in request:
            rig.set_upright()
    except InputError as error:
        return json.dumps({"error": str(error)}).encode()
    answer: dict[str, Any] = {"time": rig.now, "faults": [fault.spec for fault in rig.faults]}
    if "state" in request:
        answer["state"] = _state(rig)
    return json.dumps(answer).encode()


def _request(line: bytes) -> dict[str, Any]:
    example = '{"faults": ["dead=2"], "state": null}'
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):
        raise InputError(f"control request: is no JSON; write one object a line, as {example}") from None
    if not isinstance(request, dict) or not request or not set(request) <= set(REQUESTS):
        raise InputError(f"control request: has other keys than {', '.join(REQUESTS)}; write {example}")
    faults = request.get("faults", [])
    if not isinstance(faults, list) or not all(isinstance(fault, str) for fault in faults):
        raise InputError(f"control request: faults is not a list of texts; write {example}")
    return request


def _state(rig: VirtualRig) -> dict[str, Any]:
    truth = rig.truth()
    return {
        "base_pos": truth.base_pos.tolist(),
        "base_rpy": truth.base_rpy.tolist(),
        "joint_rad": truth.joint_rad.tolist(),
        "joint_vel": truth.joint_vel.tolist(),
        "servos": [
            {
                "id": servo.id,
                "torque_nm": shaft.torque(),
                "duty": shaft.duty(),
                "current_a": shaft.current(),
                "supply_v": shaft.supply(),
            }
            for servo, shaft in zip(rig.servos, rig.shafts, strict=True)
        ],
    }


def _listen(path: Path) -> socket.socket:
    """Open the socket; one that a run left there is replaced, anything else is not touched."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if path.is_socket() and not _is_served(path):
            path.unlink()
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen(_CLIENTS_MAX)
    except OSError as error:
        listener.close()
        reason = error.strerror or str(error)
        raise InputError(
            f"{path}: the control socket can not be there ({reason}); name a short path in a folder of yours"
        ) from None
    listener.setblocking(False)
    return listener


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        return client.connect_ex(str(path)) == 0
