"""`servolve replay`: a log through its own controller again, bit for bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from controller.errors import RunError
from deploy.logs.replay import replay as replay_log


def replay(
    log: Path,
    /,
    *,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Put a log's raw counts through its embedded controller: the same terminals, outputs and goals, bit for bit.

    Args:
        log: a log that `servolve deploy --log` recorded
        json_: print one JSON object

    Returns:
        exit status; 1: something differs
    """
    found = replay_log(log)
    if json_:
        told = {"log": str(log), "controller": found.controller.name, "rig": found.rig.name, "cycles": found.cycles}
        print(json.dumps(told | {"bitwise": found.difference is None, "difference": found.difference}))
    elif found.difference is None:
        end = "" if found.log.complete else ", as far as the log goes"
        print(f"{log}: {found.cycles} periods of {found.controller.name} are the same, bit for bit{end}")
    if found.difference is not None:
        raise RunError(
            f"{log}: {found.difference}; the log was changed or has gaps, or this is another servolve than recorded it"
        )
    return 0
