"""Sizes and worst cases of golden controllers on a Cortex-M4F, against what is on record."""

import tomllib
from pathlib import Path

import pytest

from controller import load_controller
from firmware_gen import transpile
from firmware_gen.bounds.footprint import measure_footprint
from firmware_gen.bounds.targets import CORTEX_M4F_TARGET

GOLDEN = Path(__file__).parent / "golden"
RECORDED = tomllib.loads((GOLDEN / "firmware_sizes.toml").read_text(encoding="utf-8"))["controller"]
ABOVE_MAX = 1.1


def measured(name, folder):
    controller = load_controller(GOLDEN / f"{name}.controller.toml")
    found = measure_footprint(transpile(controller, folder, "sized"), CORTEX_M4F_TARGET, "-Os")
    assert found.data_bytes == found.library_bytes == 0
    return {
        "text_bytes": found.text_bytes,
        "selftest_bytes": found.selftest_bytes,
        "stack_bytes": max(bound.stack_bytes for bound in found.bounds.values()),
        "instructions": found.period.instructions,
        "cycles_all_hits": found.period.cycles[0],
        "cycles_all_misses": found.period.cycles[1],
    }


@pytest.mark.parametrize("name", ["lamp-robust", "lamp-hop", "figure7"])
def test_a_golden_controller_costs_what_is_on_record(name, tmp_path):
    found = measured(name, tmp_path)
    recorded = RECORDED[name]
    assert found.keys() == recorded.keys()
    above = [
        f"{key} {value}, recorded {recorded[key]}" for key, value in found.items() if value > ABOVE_MAX * recorded[key]
    ]
    assert not above, f"write into tests/golden/firmware_sizes.toml if that is meant: {'; '.join(above)}"


def test_the_evolved_lamp_keeps_its_budget():
    lamp = RECORDED["lamp-robust"]
    assert lamp["text_bytes"] <= 1536 / ABOVE_MAX
    for cycles in (lamp["cycles_all_hits"], lamp["cycles_all_misses"]):
        assert cycles / 168 <= 10 / ABOVE_MAX  # [µs]


def test_the_page_says_what_is_on_record():
    page = (GOLDEN.parents[1] / "docs" / "transpile.md").read_text(encoding="utf-8")
    for lamp in RECORDED.values():
        hits, misses = (f"{lamp[f'cycles_all_{kind}'] / 168:.1f} µs {kind}" for kind in ("hits", "misses"))
        row = f"{lamp['text_bytes']} B | | {lamp['stack_bytes']} B | {lamp['instructions']} | {hits}, {misses} |"
        assert row in page
