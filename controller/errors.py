"""The two ways a command ends badly, each with one sentence for the user."""

from __future__ import annotations


class InputError(ValueError):
    """Report wrong input: exit status 2.

    The message is one sentence that names the file, the place in it, what is wrong and the remedy,
    as ``"lamp.rig.toml: joint 2: id 1 is used twice; give each servo its own id"``.
    """


class RunError(RuntimeError):
    """Report that correct input ran and failed (a fault, a gate that was not met): exit status 1."""
