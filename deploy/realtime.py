"""Ask the operating system for punctuality, where it permits: no page faults, no preemption, no garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_PRIORITY: Final = 50
_MCL_CURRENT_AND_FUTURE: Final = 3


@contextmanager
def realtime() -> Iterator[list[str]]:
    """Run the body under SCHED_FIFO, with locked memory and without garbage collection.

    Yields:
        a sentence for each thing that was not permitted
    """
    refused: list[str] = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError as error:
        refused.append(
            f"real-time priority is not permitted ({error.strerror}); run 'ulimit -r {_PRIORITY}' or as root"
        )
    libc = ctypes.CDLL(None, use_errno=True)
    locked = libc.mlockall(_MCL_CURRENT_AND_FUTURE) == 0
    if not locked:
        refused.append(
            f"memory cannot be locked ({os.strerror(ctypes.get_errno())}); run 'ulimit -l unlimited' or as root"
        )
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield refused
    finally:
        gc.enable()
        gc.unfreeze()
        if locked:
            libc.munlockall()
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
