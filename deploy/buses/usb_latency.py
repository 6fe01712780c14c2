"""Shorten the time for which a USB serial adapter holds replies back, where Linux lets it be set."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from controller.errors import RunError

DEVICES: Final = Path("/sys/bus/usb-serial/devices")
BEST_MS: Final = 1


def slow_timer(port: str, devices: Path = DEVICES) -> Path | None:
    """Return the file that says for how long a port's adapter waits, if that is longer than need be.

    Args:
        port: device path
        devices: where Linux lists USB serial adapters
    """
    timer = devices / Path(port).resolve().name / "latency_timer"
    try:
        return timer if int(timer.read_text()) > BEST_MS else None
    except (OSError, ValueError):
        return None


def shorten_timer(timer: Path) -> None:
    """Let an adapter wait for 1 ms, until it is unplugged.

    Args:
        timer: as `slow_timer` returns it

    Raises:
        RunError: it is not permitted
    """
    try:
        timer.write_text(f"{BEST_MS}\n")
    except OSError as error:
        raise RunError(f"{timer}: can not be set ({error.strerror}); run `echo {BEST_MS} | sudo tee {timer}`") from None
