"""The firmware under libFuzzer with sanitizers, for a short while: no bytes, whenever they come, break it."""

import pytest
from fuzz_firmware import IMAGES, PARSERS, build_image, build_parser, fuzz, write_corpus

RUNS = {"packets": 20_000, "lines": 10_000, "bus": 5_000, "lamp-xc330": 100, "lamp-sts3215": 100, "jumper-xc330": 60}


@pytest.mark.parametrize("name", PARSERS)
def test_any_bytes_are_parsed_soundly(tmp_path, name):
    figures = fuzz(build_parser(name, tmp_path), write_corpus(name, tmp_path), f"-runs={RUNS[name]}", "-seed=1")
    assert figures.executions >= RUNS[name]


@pytest.mark.parametrize("rig", IMAGES)
def test_any_bytes_leave_the_whole_firmware_sound_and_torque_off(tmp_path, rig):
    figures = fuzz(build_image(rig, tmp_path), write_corpus(rig, tmp_path), f"-runs={RUNS[rig]}", "-seed=1")
    assert figures.executions >= RUNS[rig]
