"""Static checks of generated C: it comes out clean, and the checks are able to find something."""

import re
import subprocess

import pytest
from made_controllers import SHAPES, make_controller

from controller import load_controller
from firmware_gen import transpile
from firmware_gen.bounds.footprint import measure_footprint
from firmware_gen.bounds.targets import CORTEX_M0_TARGET
from firmware_gen.static_checks import DEVIATIONS, TOOLS, ToolRow, check_statically

CLEAN = ("gcc -fanalyzer and warnings", "clang-tidy", "cppcheck, MISRA C:2012")
UNDEFINED = "Frama-C EVA, undefined behaviour"
GOLDEN = ("lamp-robust", "lamp-hop", "figure7")


def load(root, name):
    return SHAPES[name] if name in SHAPES else load_controller(root / "tests" / "golden" / f"{name}.controller.toml")


def rows_of(transpiled, *names):
    rows = {row.tool: row for row in check_statically(transpiled, names)}
    assert list(rows) == list(names or [tool.name for tool in TOOLS])
    for tool in CLEAN:
        assert tool not in rows or rows[tool].findings is not None, f"{tool}: {rows[tool].version} {rows[tool].first}"
    return rows


@pytest.mark.parametrize("name", [*GOLDEN, "everything", "no_terminal", "no_operation"])
def test_generated_code_is_clean(name, request, tmp_path):
    tools = (*CLEAN, UNDEFINED) if name in GOLDEN else CLEAN
    rows = rows_of(transpile(load(request.config.rootpath, name), tmp_path, name.replace("-", "_")), *tools)
    for tool in CLEAN:
        assert rows[tool].findings == 0, rows[tool]
        assert re.fullmatch(r"[\d.]+", rows[tool].version)
    if UNDEFINED in rows and not rows[UNDEFINED].version.startswith("not installed"):
        # in any number of periods, wherever the inputs are in their ranges
        assert rows[UNDEFINED] == ToolRow(UNDEFINED, rows[UNDEFINED].version, 0, "")


@pytest.mark.parametrize(
    ("tool", "old", "new"),
    [
        (CLEAN[0], "made_init(&state);", "made_init(&state);\n  i = command[0];"),
        (CLEAN[0], "1.5F;", "1.5;"),
        (CLEAN[1], "float y;", "int32_t* nowhere = 0;\n  float y = (float)*nowhere;"),
        (CLEAN[2], "if (value != value) {", "if (value) {"),
        (CLEAN[2], "  return value > high ? high : value;", "  return (int32_t)(value + high) > 0 ? high : value;"),
        (UNDEFINED, "state->s[0] = 0.0F;", "state->s[state->s[0] > 1.0F ? 1 : -1] = 0.0F;"),
    ],
)
def test_a_defect_is_found(tool, old, new, tmp_path):
    transpiled = transpile(made(), tmp_path, "made")
    text = transpiled.source.read_text()
    assert old in text
    transpiled.source.write_text(text.replace(old, new))
    row = rows_of(transpiled, tool)[tool]
    if row.version.startswith("not installed"):
        assert tool == UNDEFINED
        return
    assert row.findings > 0
    assert "made.c:" in row.first and "/tmp" not in row.first


def made():
    return make_controller("(list (* a0 1.5) (integrate (sin a1)))")


def test_what_is_missing_is_named_with_its_package(tmp_path, monkeypatch):
    transpiled = transpile(SHAPES["no_operation"], tmp_path, "made")
    monkeypatch.setenv("PATH", str(tmp_path))
    rows = list(check_statically(transpiled))
    assert [row.version for row in rows] == [
        f"not installed: apt-get install {package}"
        for package in ("gcc", "clang-tidy", "cppcheck", "frama-c-base", "frama-c-base")
    ]
    assert all(row.findings is None for row in rows)


def test_every_rule_that_is_deviated_from_is_needed(tmp_path):
    found = set()
    for name in ("everything",):
        transpile(SHAPES[name], tmp_path, name)
        command = [
            "cppcheck",
            "--quiet",
            "--std=c99",
            "--enable=style",
            "--addon=misra",
            "--template={id}",
            f"{name}.c",
        ]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        found |= set(re.findall(r"misra-c2012-([\d.]+)", done.stderr + done.stdout))
    # 8.7 shows where a file uses its own interface only
    assert found <= set(DEVIATIONS) and set(DEVIATIONS) - found <= {"8.7"}


def test_the_page_names_every_deviation(request):
    page = (request.config.rootpath / "docs" / "transpile.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+\.\d+) \| (.*) \|$", page, re.M)
    assert {rule: why.replace("`", "") for rule, why in rows} == dict(DEVIATIONS)


def test_software_floats_need_a_library_and_have_bounds(tmp_path):
    footprint = measure_footprint(transpile(made(), tmp_path, "made"), CORTEX_M0_TARGET, "-Os")
    assert footprint.library_bytes > 1000 and footprint.refusals == {}
    assert footprint.period.instructions > 1000
