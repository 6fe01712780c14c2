"""Names and texts that people chose, made fit to stand in a comment or on a page."""

from __future__ import annotations

import re
from typing import Final

_ODD: Final = re.compile(r"[^A-Za-z0-9_.,:;=+() -]", re.ASCII)
_LENGTH_MAX: Final = 80


def plain(text: str) -> str:
    """Return a text in which nothing can end a comment, break a line or mark up a page.

    Args:
        text: any

    Returns:
        at most 80 characters, a question mark for each that is not plain
    """
    return _ODD.sub("?", text)[:_LENGTH_MAX]
