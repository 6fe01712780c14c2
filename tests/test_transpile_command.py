"""`servolve transpile`: what it writes, what it checks, and what it refuses."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from controller.errors import RunError
from firmware_gen.transpiler import compiled
from servolve.cli import main

FIGURE7 = Path(__file__).parent / "golden" / "figure7.controller.toml"

BROKEN_COMPILER = """#!/bin/sh
# a compiler that gets one constant of the program wrong
sed -i 's/in_t + (-28.4382F)/in_t + (-28.4F)/' *.c
exec {compiler} "$@"
"""


def test_writes_header_source_and_report(tmp_path, capsys):
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path / "c")]) == 0
    files = ["figure7.c", "figure7.h", "figure7.report.md"]
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == files
    assert sorted(Path(line).name for line in capsys.readouterr().out.split()) == files


def test_check_compares_every_build(tmp_path, capsys):
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path), "--name", "lamp", "--check", "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [(row["compiler"], row["flags"]) for row in result["check"]] == [
        ("gcc", "-O0"),
        ("gcc", "-O3"),
        ("clang", "-O0"),
        ("clang", "-O3"),
    ]
    for row in result["check"]:
        assert row["selftest"] == row["vm_differences"] == row["reference_differences"] == 0
        assert row["steps"] == 10_000 and row["reference_steps"] > 0
    assert [Path(file).name for file in result["files"]] == ["lamp.h", "lamp.c", "lamp.report.md"]


def test_check_prints_a_table(tmp_path, capsys):
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path), "--check"]) == 0
    out = capsys.readouterr().out
    for build in ("gcc -O0", "gcc -O3", "clang -O0", "clang -O3"):
        assert build in out
    for tool in ("gcc -fanalyzer", "clang-tidy", "cppcheck", "Frama-C"):
        assert tool in out


def test_check_fails_with_a_compiler_that_gets_a_constant_wrong(tmp_path, capsys, monkeypatch):
    wrapper = tmp_path / "bin" / "clang"
    wrapper.parent.mkdir()
    wrapper.write_text(BROKEN_COMPILER.format(compiler=shutil.which("clang")))
    wrapper.chmod(0o755)
    monkeypatch.setenv("PATH", f"{wrapper.parent}{os.pathsep}{os.environ['PATH']}")
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path / "c"), "--check", "--json"]) == 1
    captured = capsys.readouterr()
    rows = json.loads(captured.out.splitlines()[-1])["check"]
    assert [row["vm_differences"] > 0 for row in rows] == [False, False, True, True]
    assert [row["reference_differences"] > 0 for row in rows] == [False, False, True, True]
    assert "clang -O0, clang -O3" in captured.err


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
        ([str(FIGURE7), "--name", "a-b"], 2, "--name 'a-b' is not a C identifier"),
        ([str(FIGURE7), "--name", "stdint"], 2, "would hide the C header <stdint.h>"),
        (["no-such.controller.toml"], 2, "no-such.controller.toml"),
        ([str(FIGURE7.parent)], 2, "best.controller.toml"),
        ([], 2, "transpile"),
    ],
)
def test_bad_input_is_one_sentence(arguments, status, sentence, tmp_path, capsys):
    assert main(["transpile", *arguments, "--out", str(tmp_path / "c")]) == status
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1 and "Traceback" not in error
    assert not (tmp_path / "c").exists()


def test_a_folder_that_can_not_be_made_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path / "file")]) == 2
    assert f"{tmp_path / 'file'}" in capsys.readouterr().err


def test_without_any_compiler_check_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path / "c"), "--check"]) == 2
    assert "install one: apt-get install gcc" in capsys.readouterr().err
    report = (tmp_path / "c" / "figure7.report.md").read_text()
    assert "Not measured: there is no cc here." in report
    assert "Not measured: there is no arm-none-eabi-gcc here." in report


def test_a_report_that_can_not_be_written_is_one_sentence(tmp_path, capsys):
    (tmp_path / "figure7.report.md").mkdir()
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path), "--force"]) == 2
    error = capsys.readouterr().err
    assert "figure7.report.md: Is a directory; choose" in error and error.count("\n") == 1


@pytest.mark.parametrize("other", ["notes.txt", "figure7.c", "figure7.report.md", "sub/deep.txt", "link"])
def test_a_folder_with_other_files_is_left_alone(other, tmp_path, capsys):
    folder = tmp_path / "c"
    (folder / other).parent.mkdir(parents=True)
    if other == "link":
        (folder / other).symlink_to(FIGURE7)
    else:
        (folder / other).write_text("int mine;\n")
    assert main(["transpile", str(FIGURE7), "--out", str(folder)]) == 2
    error = capsys.readouterr().err
    assert f"holds '{other.partition('/')[0]}', not written by servolve" in error
    assert "--force" in error and error.count("\n") == 1
    assert [path.name for path in folder.iterdir()] == [other.partition("/")[0]]
    if other != "link":
        assert (folder / other).read_text() == "int mine;\n"
    assert main(["transpile", str(FIGURE7), "--out", str(folder), "--force"]) == 0
    assert "do not edit" in (folder / "figure7.c").read_text()
    if other in ("notes.txt", "sub/deep.txt"):
        assert (folder / other).read_text() == "int mine;\n"


def test_what_servolve_wrote_is_written_again(tmp_path):
    for name in ("one", "one", "two"):
        assert main(["transpile", str(FIGURE7), "--out", str(tmp_path), "--name", name]) == 0
    assert len(list(tmp_path.iterdir())) == 6


def test_check_tells_what_tools_find(tmp_path, capsys):
    assert main(["transpile", str(FIGURE7), "--out", str(tmp_path), "--check", "--json"]) == 0
    rows = {row["tool"]: row for row in json.loads(capsys.readouterr().out.splitlines()[-1])["static"]}
    assert rows["cppcheck, MISRA C:2012"]["findings"] == rows["clang-tidy"]["findings"] == 0
    # (% a1 t) and its like: where it divides by nearly nothing, a value is infinite
    infinite = rows["Frama-C EVA, infinities and NaNs"]
    assert infinite["findings"] or infinite["version"] == "not installed: apt-get install frama-c-base"


def test_a_folder_whose_name_is_no_utf_8_is_written_to(tmp_path):
    folder = os.fsencode(tmp_path / "caf") + b"\xe9"
    command = [sys.executable, "-m", "servolve", "transpile", str(FIGURE7), "--json", "--out", folder]
    done = subprocess.run(command, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert len(os.listdir(folder)) == 3  # noqa: PTH208  a path of bytes


def test_a_compiler_that_never_ends_is_one_sentence(tmp_path, monkeypatch):
    wrapper = tmp_path / "bin" / "slow-cc"
    wrapper.parent.mkdir()
    wrapper.write_text("#!/bin/sh\nexec sleep 60\n")
    wrapper.chmod(0o755)
    monkeypatch.setattr(compiled, "COMPILE_SECONDS_MAX", 0.2)
    with pytest.raises(RunError, match=r"took more than 0.2 s; simplify"):
        compiled.run_compiler([str(wrapper)], tmp_path)


@pytest.mark.parametrize("arguments", [["show", str(FIGURE7), "--as", "c"], ["show", str(FIGURE7)]])
def test_a_full_disk_is_one_sentence(arguments):
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "servolve", *arguments]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == (
        "servolve: the output can not be written (No space left on device); make room, or write it elsewhere\n"
    )
