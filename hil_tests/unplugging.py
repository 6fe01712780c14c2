"""Pull the plug of the servos' adapter and put it in again: on a virtual rig by a fault, on a real one by hand."""

from __future__ import annotations

import json
import socket
from functools import partial

AWAY_S = 0.5
HAND_S = 60.0


def unplug_virtual(rig):
    """Unplug a virtual rig of this process for a while; return in what time it is plugged in again [s]."""
    from deploy.virtual.faults import parse_fault

    rig.set_faults([parse_fault(_fault(rig.now))])
    return 2 * AWAY_S


def unplugger(config):
    """Return what unplugs a rig that is not of this process, or None if nobody is there to do it."""
    if config.getoption("--control"):
        return partial(unplug_served, config.getoption("--control"))
    if config.getoption("--hands"):
        return partial(unplug_by_hand, config)
    return None


def unplug_served(path):
    """Unplug a served rig for a while through its control socket; return in what time it is plugged in again [s]."""
    with socket.socket(socket.AF_UNIX) as control:
        control.connect(str(path))
        lines = control.makefile("rw")

        def ask(request):
            lines.write(json.dumps(request) + "\n")
            lines.flush()
            return json.loads(lines.readline())

        answer = ask({"faults": [_fault(ask({"time": None})["time"])]})
        assert "error" not in answer, answer
    return HAND_S  # the rig's time stands still while its machine is busy


def unplug_by_hand(config):
    """Ask a person to do it; return in what time it should be done [s]."""
    plugins = config.pluginmanager
    with plugins.getplugin("capturemanager").global_and_fixture_disabled():
        plugins.getplugin("terminalreporter").write_line(
            f"\n>>> pull the plug of the servos' USB adapter, and put it in again within {HAND_S:g} s"
        )
    return HAND_S


def _fault(now):
    return f"unplug@{now:.6f}-{now + AWAY_S:.6f}"
