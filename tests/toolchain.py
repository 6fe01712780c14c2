"""Run compilers, emulators and their like, which must be there and must succeed."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

SECONDS_MAX = 600.0


def run_tool(command: Sequence[str | Path], folder: Path) -> str:
    """Run a program of the toolchain; return what it prints."""
    assert shutil.which(command[0]), f"{command[0]} is not installed; .ci/system-packages fetches it"
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=SECONDS_MAX)
    assert done.returncode == 0, (
        f"{' '.join(map(str, command[:6]))} … ended with {done.returncode}: {done.stderr[-3000:]}"
    )
    return done.stdout + done.stderr
