"""Files that are good until a test spoils them, and what a refusal must look like."""

from __future__ import annotations

import re
import shutil

from controller import load_rig
from servolve.cli import main

CONTROLLER = '''format = 1
program = """
(list
  (* 20 (osc-wave 1.5 0))
  (+ a0 (% px 0.1))
  (ifltz px -10 10))
"""

[controller]
name = "nod"
period_s = 0.02

[[input]]
name = "a0"
unit = "rad"
low = -1.06
high = 1.06

[[input]]
name = "px"
unit = "m"
low = -1.0
high = 1.0

[[output]]
name = "a0"
kind = "position"
unit = "deg"
low = -60.0
high = 60.0
neutral = 0.0

[[output]]
name = "a1"
kind = "position"
unit = "deg"
low = -65.0
high = 65.0
neutral = 0.0

[[output]]
name = "a2"
kind = "position"
unit = "deg"
low = -65.5
high = 65.5
neutral = 0.0
'''

TASK = """
from evolve.task import Task

def fitness(rollouts, goal_m):
    return rollouts.statistics["final_error"], 0.0 * goal_m

TASK = Task(name="walk", rig="lamp-xc330", terminals=("t", "px"), fitness=fitness)
"""

TWIN = 'format = 1\n[twin]\nname = "weak"\ntorque_scale = 0.8\n'

RIG = load_rig("lamp-xc330").text


def edit(text, old, new, count=1):
    """Replace the first occurrences; every case must really change its file."""
    assert old in text, old
    return text.replace(old, new, count)


def refused(capsys, arguments, *places, status=2):
    """Check that a command ends with one sentence that names the places, each a regular expression."""
    assert main([str(argument) for argument in arguments]) == status
    printed = capsys.readouterr()
    check_sentence(printed.err, *places)
    assert printed.out == ""


def check_sentence(err, *places):
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    (line,) = lines
    assert line.startswith("servolve: ")
    assert "Traceback" not in line
    for place in places:
        assert re.search(place, line, re.IGNORECASE), (place, line)
    # what is wrong; what to do
    assert re.search(r"; \S+ \S+", line), line
    assert len(line) < 600, line


def good_files(tmp_path):
    shutil.copy(load_rig("lamp-xc330").body, tmp_path / "lamp.xml")
    (tmp_path / "good.controller.toml").write_text(CONTROLLER)
    return tmp_path
