"""What README tells a newcomer to type works, in that order."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

from servolve.cli import main

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")

# a run as small as may be: what is tested is that the commands fit together
SMALL = [
    *("--population", "12", "--generations", "2", "--quiet"),
    *("--set", "time_limit_s=1", "--set", "goals=2", "--set", "race_goals=1"),
    *("--set", "decision_goals=3", "--set", "held_out_goals=3", "--set", "hall_of_fame=2"),
]


def road() -> list[list[str]]:
    """Return the commands of the shell block, without their comments."""
    block = re.search(r"```sh\n(.*?)```", README, re.S)
    assert block is not None
    lines = [shlex.split(line, comments=True) for line in block.group(1).splitlines()]
    assert all(line[0] == "servolve" for line in lines)
    return [line[1:] for line in lines]


def test_the_road_can_be_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    for command in road():
        extra = SMALL if command[0] == "evolve" else []
        status = main([*command, *extra])
        # a run this small breeds lamps that fall: the loop must then stop with status 1 and leave its log
        assert status == 0 or (command[0] == "deploy" and status == 1), (command, capsys.readouterr().err)
    for file in ("runs/lamp/best.controller.toml", "strip.png", "firmware/lamp_robust.c", "rig.mcap", "report.html"):
        assert (tmp_path / file).stat().st_size > 0, file


@pytest.mark.parametrize("target", ["demo", "test"])
def test_the_two_commands_are_targets(target: str):
    assert f"make {target} " in README
    assert re.search(rf"^{target}: \$\(VENV\)/ready", (ROOT / "Makefile").read_text(), re.M)


def test_what_it_points_to_is_there():
    paths = re.findall(r"\]\(([^)#]+)\)", README)
    assert "docs/firmware.md" in paths
    for path in paths:
        assert (ROOT / path).exists(), path
    folders = set(re.findall(r"`(\w+)/`", README.split("## Rooms")[1].split("`DESIGN.md`")[0]))
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["root_packages"]
    assert folders == {*packages, "tests", "hil_tests"}
    assert all((ROOT / folder).is_dir() for folder in folders)
