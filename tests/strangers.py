"""Environments of strangers' clients, made once: packages that share an import name can not live in ours."""

from __future__ import annotations

import fcntl
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from served_rig import ROOT, WAIT_S

CLIENT_S_MAX = 10 * WAIT_S
CLIENTS = Path(__file__).parent / "clients"
HOME = ROOT / ".venv" / "clients"
PACKAGES = {
    "dynamixel-sdk-3": ("dynamixel-sdk==3.7.31", "pyserial==3.5"),
    "feetech-1": ("setuptools==80.9.0", "feetech-servo-sdk==1.0.0", "pyserial==3.5"),
    "feetech-2": ("ftservo-python-sdk==2.0.1", "pyserial==3.5"),
}
_NO_INDEX = re.compile(r"Connection|connection|resolution|timed out|ProxyError|Network is unreachable")


def interpreter(name):
    """Return the Python of an environment, made if need be; None: our own."""
    if name is None:
        return Path(sys.executable)
    home = HOME / name
    python = home / "bin" / "python"
    HOME.mkdir(parents=True, exist_ok=True)
    with (HOME / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = home / "ready"
        if done.exists() and done.read_text() == repr(PACKAGES[name]):
            return python
        subprocess.run([sys.executable, "-m", "venv", "--clear", home], check=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES[name]]
        made = subprocess.run(pip, capture_output=True, text=True, check=False)
        if made.returncode and _NO_INDEX.search(made.stderr):
            pytest.skip(f"{PACKAGES[name][0]} can not be had: the package index can not be reached")
        assert made.returncode == 0, made.stderr
        done.write_text(repr(PACKAGES[name]))
        return python


def run_client(name, script, *arguments):
    """Run a client's script to its end; return what it saw."""
    command = [interpreter(name), CLIENTS / script, *map(str, arguments)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=CLIENT_S_MAX)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])
