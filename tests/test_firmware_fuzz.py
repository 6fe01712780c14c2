"""The firmware under libFuzzer with sanitizers, for a short while: no bytes, whenever they come, break it."""

import pytest
from fuzz_firmware import IMAGES, PARSERS, build_image, build_parser, fuzz, reached, write_corpus

RUNS = {"packets": 20_000, "lines": 10_000, "bus": 5_000, "lamp-xc330": 100, "lamp-sts3215": 100, "jumper-xc330": 60}
RUNNING = {"sv_home", "sv_cycle_step", "sv_log_cycle", "sv_look_after_health", "sv_heed_stop", "sv_release"}


@pytest.mark.parametrize("name", PARSERS)
def test_any_bytes_are_parsed_soundly(tmp_path, name):
    figures = fuzz(build_parser(name, tmp_path), write_corpus(name, tmp_path), f"-runs={RUNS[name]}", "-seed=1")
    assert figures.executions >= RUNS[name]


@pytest.mark.parametrize("rig", IMAGES)
def test_any_bytes_leave_the_whole_firmware_sound_and_torque_off(tmp_path, rig):
    target, corpus = build_image(rig, tmp_path), write_corpus(rig, tmp_path)
    # the seeds come to run
    speeds = rig.startswith("jumper")
    assert RUNNING | {"sv_judge_speeds" if speeds else "sv_judge_encoders"} <= reached(target, corpus)
    figures = fuzz(target, corpus, f"-runs={RUNS[rig]}", "-seed=1")
    assert figures.executions >= RUNS[rig]
