"""What all strangers' scripts need: patience with a busy machine, and one JSON object on stdout."""

import json
import sys
import time

PATIENCE_S = 60.0
DRAIN_S = 0.25  # longer than a busy machine keeps a late reply, which these clients take for the next answer


def drained(drop):
    """Wait for late replies, and drop them."""
    time.sleep(DRAIN_S)
    drop()


def until(ask, good, patience_s=PATIENCE_S, drop=lambda: None):
    """Ask again until the answer is good or patience ends; return the last answer."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            answer = ask()
            if good(answer):
                return answer
        except (OSError, RuntimeError, TypeError, IndexError) as error:  # what clients raise when nothing came
            answer = repr(error)
        if time.monotonic() > deadline:
            return answer
        drained(drop)


def tell(seen):
    """Print what was seen."""
    json.dump(seen, sys.stdout)
    sys.stdout.write("\n")
