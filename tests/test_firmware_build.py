"""Builds of firmware projects: of this very folder, whatever happened to it before, or refused in one sentence."""

import shutil
from pathlib import Path

import pytest

from controller import load_controller, load_rig
from controller.errors import InputError, RunError
from firmware_gen.projects.board import load_board
from firmware_gen.projects.build import build_project, require_path
from firmware_gen.projects.project import make_project, write_project
from servolve.cli import main

LAMP = Path(__file__).parent / "golden" / "lamp-hop.controller.toml"


def write(folder, rig="lamp-xc330"):
    write_project(make_project(load_controller(LAMP), load_rig(rig), load_board("host")), folder)


def build(folder):
    return build_project(folder, load_board("host"))


def test_a_copied_project_builds_its_own_sources(tmp_path):
    write(tmp_path / "first")
    before = build(tmp_path / "first").read_bytes()
    shutil.copytree(tmp_path / "first", tmp_path / "copy", symlinks=True)
    write(tmp_path / "copy", "lamp-sts3215")
    assert build(tmp_path / "copy").read_bytes() != before, "it is the image of another rig"
    assert build(tmp_path / "first").read_bytes() == before


def test_a_moved_project_builds(tmp_path):
    write(tmp_path / "first")
    build(tmp_path / "first")
    (tmp_path / "first").rename(tmp_path / "moved")
    assert build(tmp_path / "moved").is_file()


def test_a_set_up_that_failed_is_made_again(tmp_path):
    write(tmp_path)
    toolchain = tmp_path / "board" / "toolchain.cmake"
    text = toolchain.read_text()
    toolchain.write_text('set(CMAKE_C_COMPILER "/nonexistent/cc")\n')
    with pytest.raises(RunError, match=r"CMake Error .*/nonexistent/cc is not a full path to an existing compiler"):
        build(tmp_path)
    assert (tmp_path / "build" / "CMakeCache.txt").is_file()
    toolchain.write_text(text)
    assert build(tmp_path).is_file()


def test_a_program_that_has_gone_is_not_asked_for_again(tmp_path):
    write(tmp_path)
    build(tmp_path)
    cache = tmp_path / "build" / "CMakeCache.txt"
    lines = cache.read_text().splitlines(keepends=True)
    gone = ["CMAKE_MAKE_PROGRAM:FILEPATH=/gone/ninja\n" if "CMAKE_MAKE_PROGRAM:F" in line else line for line in lines]
    assert gone != lines
    cache.write_text("".join(gone))
    assert build(tmp_path).is_file()
    assert "/gone/ninja" not in cache.read_text()


@pytest.mark.parametrize("name", ["a;b", "a$b", 'a"b', "a\\b", "a#b", "a|b", "a<b", "a[b", "a\nb"])
def test_a_path_that_cmake_does_not_take_is_refused_before_anything_is_written(name, tmp_path, capsys):
    arguments = ("--rig", "lamp-xc330", "--board", "host", "--out", str(tmp_path / name), "--build")
    assert main(["firmware", str(LAMP), *arguments]) == 2
    told = capsys.readouterr().err
    assert "CMake builds nothing under a path with" in told and told.count("\n") == 1
    assert not (tmp_path / name).exists()


def test_the_folder_around_counts_too(tmp_path, monkeypatch):
    (tmp_path / "a;b").mkdir()
    monkeypatch.chdir(tmp_path / "a;b")
    with pytest.raises(InputError, match="a path with ';'"):
        require_path(Path("out"))


def test_a_path_with_blanks_and_letters_of_all_kinds_builds(tmp_path):
    write(tmp_path / "größe 1 (it's)")
    assert build(tmp_path / "größe 1 (it's)").is_file()
