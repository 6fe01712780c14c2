"""A value is changed in place: every other byte of the file stays, and what can not be edited is refused."""

import tomllib

import pytest

from controller import load_rig
from controller.errors import InputError
from controller.rig_file import rig_names
from deploy.commissioning.toml_edit import set_values

TEXT = """# a rig
[rig]
name = "lamp"   # what we call it
'body' = 'lamp.xml'

[[joint]]
# the first
name = "a0"
zero_tick   =  2048 # at rest
low_rad = -1.0

[other] # zero_tick = 3
zero_tick = 7

[[ joint ]]
name = "a1"
"zero_tick" = 2_048
low_rad = -1e0
"""


def test_numbers_and_texts_change_where_they_stand():
    edited = set_values(TEXT, "f", "joint", 1, {"zero_tick": 1999, "low_rad": -0.25})
    edited = set_values(edited, "f", "rig", 0, {"body": "../lamp.xml"})
    pairs = zip(TEXT.splitlines(), edited.splitlines(), strict=True)
    assert [text for old, new in pairs if old != new for text in (f"- {old}", f"+ {new}")] == [
        "- 'body' = 'lamp.xml'",
        "+ 'body' = \"../lamp.xml\"",
        '- "zero_tick" = 2_048',
        '+ "zero_tick" = 1999',
        "- low_rad = -1e0",
        "+ low_rad = -0.25",
    ]
    assert set_values(TEXT, "f", "joint", 0, {"zero_tick": 5}) == TEXT.replace("2048 #", "5 #")


@pytest.mark.parametrize("name", rig_names())
def test_every_shipped_rig_can_be_edited(name):
    rig = load_rig(name)
    if rig.simulated_only:
        return
    text = rig.text
    for index in range(len(rig.joints)):
        text = set_values(text, name, "joint", index, {"zero_tick": 2000 + index})
    assert [joint["zero_tick"] for joint in tomllib.loads(text)["joint"]] == [2000 + i for i in range(len(rig.joints))]
    assert len(text.splitlines()) == len(rig.text.splitlines())


@pytest.mark.parametrize(
    "text",
    [
        'joint = [{ name = "a0", zero_tick = 3 }]\n',
        "[[joint]]\nname = 1\n",
        '[[joint]]\nnote = """\nzero_tick = 5\n"""\nzero_tick = 3\n',
        "[[joint]]\nzero_tick = [3]\n",
    ],
)
def test_what_can_not_be_edited_in_place_is_refused(text):
    with pytest.raises(
        InputError, match=r"f: zero_tick of \[\[joint\]\] 1 can not be edited in place; write each table"
    ):
        set_values(text, "f", "joint", 0, {"zero_tick": 4})
