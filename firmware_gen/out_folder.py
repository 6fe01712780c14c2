"""Folders that generated files go to: what servolve wrote there may be written again, anything else is the user's."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from controller.errors import InputError
from firmware_gen.report import REPORT_MARK

_OPENING: Final = re.compile(r"// \w+: a robot controller, written by servolve transpile; do not edit\.\n")
_READ_MAX: Final = 512


def check_out_folder(folder: Path, force: bool) -> None:
    """Refuse a folder that holds what servolve transpile did not write.

    Args:
        folder: where files are to be written, there or not
        force: take any folder

    Raises:
        InputError: there are other files in it
    """
    if force or not folder.is_dir():
        return
    others = sorted(path.name for path in folder.iterdir() if not is_transpiled(path))
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise InputError(
            f"{folder} holds {others[0]!r}{more}, not written by servolve transpile; choose another folder, or add "
            "--force to write into this one and over files of the same names"
        )


def is_transpiled(path: Path) -> bool:
    """Return whether a file is one that servolve transpile wrote.

    Args:
        path: of anything in a folder
    """
    if path.is_symlink() or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            opening = file.read(_READ_MAX).decode("utf-8", "replace")
    except OSError:
        return False
    return _OPENING.match(opening) is not None or f"\n{REPORT_MARK}\n" in opening
