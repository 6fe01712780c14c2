"""Twin files: what ships loads, and every mistake is one sentence."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

import deploy.virtual.twin
from controller.errors import InputError
from controller.rig_file import load_rig
from deploy.virtual.rig import VirtualRig
from deploy.virtual.twin import JOINT_KEYS, JointTwin, Twin, load_twin, twin_names

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


def test_a_joint_has_its_own_on_top_of_every_joints(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        "format = 1\n[twin]\nname = 'x'\ntorque_scale = 0.8\nencoder_bias_rad = 0.1\nbacklash_scale = 1.0\n"
        "[[joint]]\nname = 'a1'\ntorque_scale = 0.5\nencoder_bias_rad = -0.02\n"
    )
    twin = load_twin(path)
    assert twin.joint("a0") == JointTwin(torque_scale=0.8, encoder_bias_rad=0.1, backlash_scale=1.0)
    assert twin.joint("a1").torque_scale == pytest.approx(0.4)
    assert twin.joint("a1").encoder_bias_rad == pytest.approx(0.08)
    assert twin.joint("a1").backlash_scale == 1.0
    for text, expected in {
        "[[joint]]\nname = 'a1'\nmass_scale = 2.0": "'mass_scale' is not known",
        "[[joint]]\nname = 'a1'\n[[joint]]\nname = 'a1'": "name 'a1' has a table already",
        "[[joint]]\ntorque_scale = 2.0": "name is missing",
    }.items():
        path.write_text(f"format = 1\n[twin]\nname = 'x'\n{text}\n")
        with pytest.raises(InputError, match=expected):
            load_twin(path)
    path.write_text("format = 1\n[twin]\nname = 'x'\n[[joint]]\nname = 'a9'\n")
    with pytest.raises(InputError, match="rig lamp-xc330 has no joint 'a9'; name one of its joints: a0, a1, a2"):
        VirtualRig(RIG, twin=load_twin(path))


def test_the_page_lists_every_key():
    page = (Path(__file__).parent.parent / "docs" / "twins.md").read_text()
    own, _, alone = page.partition("Keys of `[twin]` alone:")
    assert re.findall(r"^\| `([a-z_]+_[a-z]+)` \|", own, re.M) == list(JOINT_KEYS)
    listed = re.findall(r"`([a-z_]+)`", "".join(re.findall(r"^\| (`[^|]+) \|", alone, re.M)))
    assert listed == [field.name for field in fields(Twin) if field.name not in (*JOINT_KEYS, "name", "text", "joints")]
    assert set(re.findall(r"^\| `([a-z-]+)` \|", page, re.M)) >= set(twin_names())


def test_a_twin_that_is_not_there_is_told_with_those_that_are():
    with pytest.raises(InputError, match=f"twin 'nosuch' is not known; choose one of {', '.join(twin_names())}, or "):
        load_twin("nosuch")
