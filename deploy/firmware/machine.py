"""What a machine that runs firmware promises to the bench: it works while time stands still, and asks when to wake."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Given:
    """Hold what the world gives a machine when it wakes.

    Args:
        now_us: time since the machine was switched on [us]; it never goes back
        inputs: which inputs are active, `sv_input` of sv_hal.h ORed
        bus: bytes that have come from the servos
        sensors: bytes that have come from the sensor node
        console: bytes that have come from a person
    """

    now_us: int
    inputs: int = 0
    bus: bytes = b""
    sensors: bytes = b""
    console: bytes = b""


@dataclass(frozen=True)
class Taken:
    """Hold what a machine has done until it waits again.

    Args:
        until_us: to when it waits, if nothing comes [us]
        bus: packets that it has sent to the servos, in order
        console: bytes of answers and log
        boot: packets that it has sent to the servos before its first wait, in order; of the first call alone
    """

    until_us: int
    bus: tuple[bytes, ...] = ()
    console: bytes = b""
    boot: tuple[bytes, ...] = ()


class Firmware(Protocol):
    """Run an image in lock step: all that it does until it waits takes no time of the rig's.

    A machine whose image has ended, or does not wait in any reasonable number of steps, raises `RunError`.
    """

    def resume(self, given: Given) -> Taken:
        """Wake the image and let it work until it waits.

        The first call boots the image, lets it come to its first wait, and wakes it there with what is given; what it
        does before and after is returned together, but for the packets of its boot.

        Args:
            given: what has come since the last call

        Returns:
            what it has done

        Raises:
            RunError: the image has died or does not come to wait
        """
        ...

    def close(self) -> None:
        """End the machine, whatever state it is in; a second call does nothing."""
        ...
