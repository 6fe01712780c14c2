"""What a run writes beside its history: JSON that anyone can read, of runs that went wrong too."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest

from controller.errors import InputError
from evolve.decide import Validation
from evolve.runs.run_folder import read_validation, validation_text

GOOD = Validation(2, 0.25, 0.25, 0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 1.5, 1, 0.02, 0.25, 0.01)
LOST = dataclasses.replace(GOOD, mean_error_m=math.inf, main=math.inf)
CONDITIONS = [{"goal_m": 0.4, "final_error_m": math.inf, "hit": False}, {"goal_m": 0.5, "final_error_m": 0.1}]
BEST = {"generation": 0, "individual": 3, "program": "ab"}


def refuse(word):
    pytest.fail(f"{word} is not JSON")


def test_what_is_infinite_is_null_and_comes_back(tmp_path):
    path = tmp_path / "validation.json"
    path.write_text(validation_text(BEST, LOST, GOOD, CONDITIONS))
    written = json.loads(path.read_text(), parse_constant=refuse)
    assert written["held_out"]["mean_error_m"] is None and written["conditions"][0]["final_error_m"] is None
    found = read_validation(path)
    assert Validation(**found["held_out"]) == LOST and Validation(**found["stated"]) == GOOD
    assert found["conditions"] == CONDITIONS and found["best"] == BEST


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"best": {}}'])
def test_what_the_run_did_not_write_is_refused(tmp_path, text):
    path = tmp_path / "validation.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"validation\.json: not as the run wrote it .*; put back"):
        read_validation(path)
