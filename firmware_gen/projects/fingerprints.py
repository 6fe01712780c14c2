"""Numbers that say which files a log belongs to: 32 bits of a hash."""

from __future__ import annotations

import hashlib

from controller import Controller, controller_text, program_hash
from controller.rig import Rig


def rig_fingerprint(rig: Rig, controller: Controller) -> int:
    """Return the number of a rig with a controller on it: of the texts of both.

    Args:
        rig: the rig
        controller: the controller
    """
    return _number(f"{rig.text}\0{controller_text(controller)}")


def program_fingerprint(controller: Controller) -> int:
    """Return the number of a controller's program.

    Args:
        controller: the controller
    """
    return _number(program_hash(controller.program))


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")
