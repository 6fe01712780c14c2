"""The comparison of C generators, as far as it needs none but ours: tests/generators/compare.py."""

import importlib.util
import sys
from pathlib import Path

import pytest

from controller import load_controller

ROOT = Path(__file__).parent
GOLDEN = ROOT / "golden"


@pytest.fixture(scope="module")
def compare():
    before = list(sys.path)
    spec = importlib.util.spec_from_file_location("compare_generators", ROOT / "generators" / "compare.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = before


@pytest.mark.parametrize("name", ["lamp-robust", "figure7", "lamp-hop"])
def test_our_code_is_exact_and_within_its_bound(compare, name, tmp_path):
    controller = load_controller(GOLDEN / f"{name}.controller.toml")
    row = dict(zip(compare.HEAD[1:], compare.measure(controller, compare.write_servolve, tmp_path), strict=True))
    assert row["in range"] == row["hard inputs"] == row["M4F not as x86"] == "0.0 %"
    assert row["library"] == "0"
    assert 0 < int(row["usual"]) <= int(row["most"]) <= int(row["bound"])


def test_doubles_are_larger_slower_and_other_numbers(compare, tmp_path):
    controller = load_controller(GOLDEN / "figure7.controller.toml")
    rows = []
    for write in (compare.write_servolve, compare.write_nested):
        (tmp_path / write.__name__).mkdir()
        row = compare.measure(controller, write, tmp_path / write.__name__)
        rows.append(dict(zip(compare.HEAD[1:], row, strict=True)))
    ours, doubles = rows
    assert int(doubles["own code"]) > int(ours["own code"]) and int(doubles["library"]) > 1000
    assert int(doubles["usual"]) > 10 * int(ours["usual"])
    assert float(doubles["in range"].rstrip(" %")) > 10
