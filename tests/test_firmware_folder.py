"""The folder of a firmware project: nobody's files are overwritten, and what broke off is written again."""

import json
import shutil
from pathlib import Path

import pytest

from controller import load_controller, load_rig
from controller.errors import InputError
from firmware_gen.projects.board import load_board
from firmware_gen.projects.project import make_project, write_project
from servolve.cli import main

LAMP = Path(__file__).parent / "golden" / "lamp-hop.controller.toml"


def project_of(rig="lamp-xc330"):
    return make_project(load_controller(LAMP), load_rig(rig), load_board("host"))


def tree(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def firmware(*arguments):
    return main(["firmware", str(LAMP), *map(str, arguments)])


def test_a_folder_with_other_files_is_refused_unless_forced(tmp_path, capsys):
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "thesis.tex").write_text("years of work")
    arguments = ("--rig", "lamp-xc330", "--board", "host", "--out", tmp_path)
    assert firmware(*arguments) == 2
    assert "holds other files (src?thesis.tex)" in capsys.readouterr().err
    assert tree(tmp_path) == {"src/thesis.tex": b"years of work"}
    assert firmware(*arguments, "--force") == 0
    assert tree(tmp_path)["src/thesis.tex"] == b"years of work"


def test_what_was_written_before_is_replaced_but_not_what_somebody_has_changed(tmp_path, capsys):
    arguments = ("--rig", "lamp-xc330", "--board", "host", "--out", tmp_path)
    assert firmware(*arguments) == 0 and firmware(*arguments) == 0
    (tmp_path / "board" / "hal.c").write_text("// mine\n")
    assert firmware(*arguments) == 2
    assert "hal.c: was changed since it was written" in capsys.readouterr().err
    assert (tmp_path / "board" / "hal.c").read_text() == "// mine\n"
    assert firmware(*arguments, "--force") == 0
    assert "// mine" not in (tmp_path / "board" / "hal.c").read_text()


@pytest.mark.parametrize("before", [None, "lamp-xl330"])
@pytest.mark.parametrize("place", ["runtime/sv_bus.c", "src/rig.c"])
def test_writing_that_broke_off_is_done_again_without_force(before, place, tmp_path):
    if before:
        write_project(project_of(rig=before), tmp_path)
        (tmp_path / place).unlink()
    (tmp_path / place).mkdir(parents=True)  # where no file can be written
    with pytest.raises(InputError, match="a folder that can be written"):
        write_project(project_of(), tmp_path)
    (tmp_path / place).rmdir()
    (tmp_path / f"{place}.servolve-part").write_text("half of")
    write_project(project_of(), tmp_path)
    assert tree(tmp_path) == {path: text.encode() for path, text in project_of().files.items()}


def test_writing_that_broke_off_is_no_leave_to_overwrite_what_somebody_has_changed(tmp_path):
    write_project(project_of(rig="lamp-xl330"), tmp_path)
    (tmp_path / "src" / "rig.c").unlink()
    (tmp_path / "src" / "rig.c").mkdir()
    with pytest.raises(InputError, match="a folder that can be written"):
        write_project(project_of(), tmp_path)
    (tmp_path / "src" / "rig.c").rmdir()
    (tmp_path / "src" / "rig.h").write_text("// mine\n")
    with pytest.raises(InputError, match=r"rig\.h: was changed"):
        write_project(project_of(), tmp_path)


def test_a_manifest_can_not_make_it_remove_files_elsewhere(tmp_path):
    outside = tmp_path / "keep"
    outside.write_text("")
    digest = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"  # of nothing
    folder = tmp_path / "out"
    write_project(project_of(), folder)
    manifest = json.loads((folder / "servolve.json").read_text())
    manifest["files"] |= {"../keep": digest, str(outside): digest, "src/../../keep": digest}
    (folder / "servolve.json").write_text(json.dumps(manifest))
    write_project(project_of(), folder)
    assert outside.is_file()


def test_a_link_to_elsewhere_is_no_file_of_the_project(tmp_path):
    write_project(project_of(), tmp_path / "out")
    hal = tmp_path / "out" / "board" / "hal.c"
    shutil.copy(hal, tmp_path / "hal.c")
    hal.unlink()
    hal.symlink_to(tmp_path / "hal.c")
    (tmp_path / "hal.c").write_text("// mine\n")
    with pytest.raises(InputError, match="was changed"):
        write_project(project_of(), tmp_path / "out")
    write_project(project_of(), tmp_path / "out", force=True)
    assert not hal.is_symlink() and (tmp_path / "hal.c").read_text() == "// mine\n"
