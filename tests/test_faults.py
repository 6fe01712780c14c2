"""Faults as the command line writes them: read as meant, or one sentence."""

import re
from pathlib import Path

import pytest

from controller.errors import InputError
from controller.rig_file import load_rig
from deploy.virtual.faults import KINDS, Fault, parse_fault
from deploy.virtual.rig import VirtualRig

RIG = load_rig("lamp-xc330")


def test_a_fault_is_read_as_written():
    assert parse_fault("drop=0.01") == Fault("drop", 0.01)
    assert parse_fault("dead=2@3.0") == Fault("dead", 2.0, start_s=3.0)
    assert parse_fault("supply=4.5@1-2.5") == Fault("supply", 4.5, start_s=1.0, end_s=2.5)
    assert parse_fault("estop@2") == Fault("estop", 0.0, start_s=2.0)
    assert parse_fault("sensor-dead=F@0.1") == Fault("sensor-dead", 0.0, "F", 0.1)


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("drop", "drop needs a value; write as drop=0.01"),
        ("estop=1@2", "estop takes no value; write as estop@3.0"),
        ("=0.1", "is not KIND=VALUE"),
        ("", "is not KIND=VALUE"),
        ("drp=0.1", "kind 'drp' is not known; did you mean 'drop'?"),
        ("drop=2", "'2' is not a probability"),
        ("drop=nan", "'nan' is not a probability"),
        ("drop=x", "'x' is not a probability"),
        ("dead=1.5", "'1.5' is not a servo id"),
        ("dead=300", "'300' is not a servo id"),
        ("dead=1@soon", "is not KIND=VALUE"),
        ("dead=1@2-1", "it ends before it begins"),
        ("dead=1@..", "'..' is not a time"),
        ("sensor-dead=force", "'force' is not a message letter"),
        ("supply=-1", "'-1' is not a supply voltage"),
    ],
)
def test_a_wrong_fault_is_one_sentence(spec, expected):
    with pytest.raises(InputError) as caught:
        parse_fault(spec)
    assert expected in str(caught.value)
    assert spec in str(caught.value)


def test_a_fault_of_what_is_not_there_is_refused():
    with pytest.raises(InputError, match="has no such servo; its ids are 1, 2, 3"):
        VirtualRig(RIG, faults=[parse_fault("dead=7")])
    with pytest.raises(InputError, match="has no such message; it has F, P"):
        VirtualRig(RIG, faults=[parse_fault("sensor-dead=Q")])


def test_the_page_lists_every_kind():
    page = (Path(__file__).parent.parent / "docs" / "rigs.md").read_text()
    table = page.partition("### Faults")[2].partition("### Twins")[0]
    listed = re.findall(r"`([a-z-]+)[=@][A-Z]+`", table.replace("| what happens |", ""))
    assert [kind for kind in listed if kind != "KIND"] == list(KINDS)
