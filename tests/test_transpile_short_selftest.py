"""An image's selftest: one hash instead of a recorded run, and as watchful of what an image computes."""

import subprocess

import pytest
from made_controllers import FLUSH, SLOW, make_controller

from firmware_gen.transpiler.generate import generate

FLAGS = ("-std=c99", "-ffp-contract=off", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Wmissing-prototypes", "-Werror")
SOURCE = "(list (* a0 1.5) (integrate (+ a1 (* a0 a1))))"


def selftest_of(folder, source, changes=(), before="", flags=FLAGS):
    """Return what the selftest returns after changes of the generated C."""
    made = generate(make_controller(source), "made", short=True)
    text = made.source
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "made.h").write_text(made.header)
    (folder / "made.c").write_text(text)
    main = f'{before}\n#include <stdio.h>\n#include "made.h"\n'
    first = "FLUSH(); " if before else ""
    (folder / "main.c").write_text(f'{main}int main(void) {{ {first}printf("%d", (int)made_selftest()); return 0; }}\n')
    subprocess.run(["gcc", *flags, "main.c", "made.c", "-o", "made"], cwd=folder, check=True)
    return int(subprocess.run([folder / "made"], capture_output=True, text=True, check=True).stdout)


@pytest.mark.parametrize("source", [SOURCE, SLOW, "(list 1 2)"])
def test_it_passes_as_generated(source, tmp_path):
    assert selftest_of(tmp_path, source) == 0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("1.5F;", "1.50000012F;"),
        ("state->s[0] = 0.0F", "(void)state"),
        ("in_a0 * in_a1", "in_a0 * in_a0"),
    ],
)
def test_it_notices_a_change_of_the_program(old, new, tmp_path):
    flags = [flag for flag in FLAGS if flag != "-Werror"]
    assert selftest_of(tmp_path, SOURCE, [(old, new)], flags=flags) != 0


def test_it_notices_a_changed_function(tmp_path):
    assert selftest_of(tmp_path, SLOW, [("magnitude < 0.625F", "magnitude < 0.5F")]) == -5


def test_it_notices_flushed_subnormals(tmp_path):
    assert selftest_of(tmp_path, SOURCE, before=FLUSH) == -1


def test_it_has_no_tables_of_answers(tmp_path):
    made = generate(make_controller(SOURCE), "made", short=True)
    assert "_recorded_" not in made.source
    assert "recording" not in made.header
