"""Lock a port while it is in use, so that two programs never talk over each other on one bus."""

from __future__ import annotations

import fcntl
import os
import re
import tempfile
from pathlib import Path

from controller.errors import InputError


class PortLock:
    """Hold an advisory lock (``flock``) on a port until closed; it ends with the process in any case.

    Args:
        path: device path, or a ``socket://HOST:PORT``, for which a file of this user stands in

    Raises:
        InputError: if the port does not exist or another program holds it
    """

    def __init__(self, path: str) -> None:
        self._descriptor = -1
        try:
            if "://" in path:
                stand_in = _own_folder() / f"{re.sub(r'[^A-Za-z0-9.]+', '_', path)}.lock"
                self._descriptor = os.open(stand_in, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            else:
                self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be opened ({error.strerror}); check the path, the cable and your rights"
            ) from None
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.close()
            raise InputError(f"{path}: is in use by another program; end that one first") from None

    def close(self) -> None:
        """Release the lock."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> PortLock:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self.close()


def _own_folder() -> Path:
    """Return a folder of this user alone, made if need be."""
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()) / f"servolve-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder
