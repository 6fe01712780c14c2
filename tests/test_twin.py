"""Twin files: what ships loads, and every mistake is one sentence."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

import deploy.virtual.twin
from controller.errors import InputError
from controller.rig_file import load_rig
from deploy.virtual.rig import VirtualRig
from deploy.virtual.twin import Twin, load_twin, twin_names

RIG = load_rig("lamp-xc330")
TWINS = Path(deploy.virtual.twin.__file__).parent / "twins"


def test_shipped_twins_load_and_wrong_ones_are_one_sentence(tmp_path):
    assert [path.stem for path in sorted(TWINS.iterdir())] == list(twin_names())
    for name in twin_names():
        twin = load_twin(name)
        assert twin == load_twin(TWINS / f"{name}.toml")
        assert twin.name == name
        assert twin != Twin(name=name, text=twin.text)
    assert load_twin("weak-torque").torque_scale == 0.8
    path = tmp_path / "mine.toml"
    for keys, expected in {
        "torque = 0.8": "line 4: [twin]: 'torque' is not known; did you mean 'torque_scale'?",
        "torque_scale = 0": "line 4: [twin]: torque_scale 0 is out of range; write a number from 0.05 to 5",
        "supply_v = '5'": "supply_v is the text '5'; write a number",
        "mass_scale = inf": "mass_scale is not finite",
    }.items():
        path.write_text(f"format = 1\n[twin]\nname = 'x'\n{keys}\n")
        with pytest.raises(InputError) as caught:
            load_twin(path)
        assert expected in str(caught.value)
        assert str(caught.value).startswith(str(path))
    for text, expected in {
        "format = 1\n[twin]\n": "name is missing",
        "format = 1\n": "table [twin] is missing",
        "[twin]\nname = 'x'": "format is missing",
    }.items():
        path.write_text(text)
        with pytest.raises(InputError) as caught:
            load_twin(path)
        assert expected in str(caught.value)
        assert str(caught.value).startswith(str(path))
    path.write_text("format = 1\n[twin]\nname = 'x'\ntimestep_s = 0.0003\n")
    with pytest.raises(InputError, match="does not divide the period"):
        VirtualRig(RIG, twin=load_twin(path))


def test_the_page_lists_every_key():
    page = (Path(__file__).parent.parent / "docs" / "rigs.md").read_text()
    listed = re.findall(r"`([a-z_]+)`", page.partition("a table `[twin]` with")[2].partition("Scales")[0])
    assert listed == [field.name for field in fields(Twin) if field.name != "text"]
