"""What a generated selftest notices, and what refuses to compile."""

import re
import shutil

import pytest
from made_controllers import FLUSH, SLOW, make_controller, run_command

from firmware_gen import transpile

MAIN = """
#include <stdio.h>
#include "made.h"
int main(void) {{
  {before}
  printf("%d", (int)made_selftest());
  return 0;
}}
"""


def selftest_of(folder, *, before="", includes="", flags=("-O2",), compiler="gcc", libraries=()):
    """Compile and run the selftest of made.c as a program of its own."""
    (folder / "main.c").write_text(includes + MAIN.format(before=before))
    done = run_command(compiler, "-std=c99", *flags, "main.c", "made.c", "-o", "main", *libraries, cwd=folder)
    assert done.returncode == 0, done.stderr
    return int(run_command("./main", cwd=folder).stdout)


def change(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


@pytest.fixture
def made(tmp_path):
    return transpile(make_controller("(list (* a0 1.5) (integrate (sin a1)))"), tmp_path, "made")


def test_selftest_passes_as_generated(made, tmp_path):
    assert selftest_of(tmp_path) == 0


@pytest.mark.parametrize(
    ("old", "new", "status"),
    [
        ("1.5F;", "1.50000012F;", 1),
        ("0.00833218824F", "0.0083331F", None),
        ("return y;\n}\n\nvoid made_init", "return s[0] = y + 0.0F * dt, dt;\n}\n\nvoid made_init", -5),
        ("state->s[0] = 0.0F", "(void)state", None),
        ("if (value != value)", "if (0)", -4),
        ("return low;", "return value;", -4),
        ("(-50.0F), 50.0F, 1.5F", "(-50.0F), 50.5F, 1.5F", -4),
        ("  y = factor * factor;\n  y = y + square;", "  y = __builtin_fmaf(factor, factor, square);", -2),
    ],
)
def test_selftest_notices_a_change_of_the_code(made, tmp_path, old, new, status):
    change(made.source, old, new)
    found = selftest_of(tmp_path, libraries=("-lm",))
    assert found == status if status is not None else found != 0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("3.0F - y", "3.0F + y"),  # branches that the program reaches after a second
        ("y - 1.0F;\n  } else", "y + 1.0F;\n  } else"),
        ("x < 0.5F", "x < 0.75F"),
        ("x > -8388608.0F", "x > 8388608.0F"),
        ("y < 1.0F ? y : 0.99999994F", "y"),
        ("y = y - 1.0F;\n  }\n  y = x - y", "y = y + 1.0F;\n  }\n  y = x - y"),
        ("6.28318548F", "6.28318596F"),
        ("0.00138873095F", "0.00138873905F"),
        ("quadrant & 2U", "quadrant & 1U"),
        ("magnitude < 0.625F", "magnitude < 0.5F"),
        ("if (x > 88.7228317F", "if (x > 80.0F"),
        ("if (x < 1.17549435e-38F", "if (x < 0.0F"),
        ("w > 1.0F ? 1.0F : w", "w"),
    ],
)
def test_selftest_notices_changed_functions_of_slow_programs(old, new, tmp_path):
    source = transpile(make_controller(SLOW), tmp_path, "made").source
    head, mark, tail = source.read_text().partition("void made_init(")
    assert old in head
    source.write_text(head.replace(old, new, 1) + mark + tail)
    assert selftest_of(tmp_path) == -5


@pytest.mark.parametrize("step", [1, 12, 13, 24])
@pytest.mark.parametrize("table", ["inputs", "outputs"])
def test_selftest_notices_one_changed_bit_of_its_vectors(made, tmp_path, step, table):
    head, name, tail = made.source.read_text().partition(f"made_recorded_{table}[24]")
    rows = tail.split("\n")
    word = re.search(r"0x([0-9a-f]{8})U", rows[step])[1]
    rows[step] = rows[step].replace(word, f"{int(word, 16) ^ 0x00010000:08x}", 1)
    made.source.write_text(head + name + "\n".join(rows))
    assert selftest_of(tmp_path) == step


def test_selftest_notices_flushed_subnormals(made, tmp_path):
    assert selftest_of(tmp_path, includes=FLUSH, before="FLUSH();") == -1


@pytest.mark.parametrize("mode", ["FE_UPWARD", "FE_DOWNWARD", "FE_TOWARDZERO"])
def test_selftest_notices_another_rounding(made, tmp_path, mode):
    status = selftest_of(tmp_path, includes="#include <fenv.h>\n", before=f"fesetround({mode});", libraries=("-lm",))
    assert status == -3


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast"])
def test_refuses_to_compile_with_fast_arithmetic(made, tmp_path, compiler, flag):
    done = run_command(compiler, flag, "-c", "made.c", cwd=tmp_path)
    assert done.returncode != 0
    assert "needs IEEE-754 arithmetic" in done.stderr


def test_refuses_a_header_of_another_run(made, tmp_path):
    other = transpile(make_controller("(list (* a0 1.25) (integrate (sin a1)))"), tmp_path / "other", "made")
    shutil.copy(other.header, made.header)
    done = run_command("gcc", "-c", "made.c", cwd=tmp_path)
    assert done.returncode != 0
    assert "are not of the same run" in done.stderr


def test_refuses_a_header_of_another_generator(made, tmp_path):
    change(made.header, "made_GENERATOR 3", "made_GENERATOR 4")
    assert "are not of the same run" in run_command("gcc", "-c", "made.c", cwd=tmp_path).stderr
