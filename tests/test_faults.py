"""Faults as the command line writes them: read as meant, or one sentence."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.errors import InputError
from controller.rig_file import load_rig
from deploy.virtual.faults import KINDS, Fault, parse_fault, read_faults
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
        ("drop=#0", "'#0' is not a count"),
        ("drop=#x", "'#x' is not a count"),
        ("dead=#2", "'#2' is not a servo id"),
        ("drop=0.1:5", "drop takes no second value"),
        ("late=0.1:x", "'x' is no time to be late by"),
        ("wrap=1:0.5", "'0.5' is not a number of counts"),
        ("latency-timer=0", "'0' is not a latency"),
        ("unplug=1", "unplug takes no value; write as unplug@3.0-4.0"),
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
    page = (Path(__file__).parent.parent / "docs" / "faults.md").read_text()
    assert re.findall(r"^\| `([a-z-]+)[=@]", page, re.M) == list(KINDS)


def test_counts_and_second_values():
    assert parse_fault("drop=#3@2") == Fault("drop", 0.0, start_s=2.0, count=3)
    assert parse_fault("late=0.5") == Fault("late", 0.5, more=20.0)
    assert parse_fault("late=#1:7.5") == Fault("late", 0.0, count=1, more=7.5)
    assert parse_fault("wrap=2@1") == Fault("wrap", 2.0, start_s=1.0)
    assert parse_fault("wrap=2:-300") == Fault("wrap", 2.0, more=-300.0)
    assert parse_fault("latency-timer=16") == Fault("latency-timer", 16.0)


@pytest.mark.parametrize(
    "spec",
    ["drop=0.01", "drop=#3@2", "late=0.5:25@1-2.5", "wrap=2:-300", "sensor-dead=F@0.1", "unplug@1-2", "supply=4.5@3"],
)
def test_a_fault_tells_how_it_is_written(spec):
    assert parse_fault(spec).spec == spec


def test_a_file_is_a_list_of_faults(tmp_path):
    path = tmp_path / "bad-day.toml"
    path.write_text('format = 1\nfaults = ["drop=0.01", "dead=2@3.0"]\n')
    listed = (Fault("drop", 0.01), Fault("dead", 2.0, start_s=3.0))
    assert read_faults([str(path)]) == listed
    assert read_faults(["stuck=1", str(path)]) == (Fault("stuck", 1.0), *listed)
    for text, expected in {
        "format = 1": "faults is not a list of texts",
        "format = 1\nfaults = [1]": "faults is not a list of texts",
        'format = 1\nfaults = ["drop=0.1", "ded=2"]': "line 2: top level: fault 'ded=2': kind 'ded' is not known",
        'format = 1\nfault = ["drop=0.1"]': "did you mean 'faults'?",
        'faults = ["drop=0.1"]': "format is missing",
    }.items():
        path.write_text(text + "\n")
        with pytest.raises(InputError) as caught:
            read_faults([str(path)])
        assert expected in str(caught.value)
        assert str(caught.value).startswith(str(path))
    with pytest.raises(InputError, match="there is no such file"):
        read_faults([str(tmp_path / "none.toml")])


KIND = st.sampled_from(sorted(KINDS))
MILLI = st.integers(0, 1000).map(lambda count: count / 1000)


@given(
    kind=KIND,
    share=MILLI,
    count=st.integers(1, 999),
    by_count=st.booleans(),
    more=st.integers(1, 5000),
    times=st.tuples(MILLI, MILLI),
)
def test_what_a_fault_tells_is_read_as_the_same_fault(kind, share, count, by_count, more, times):
    meaning = KINDS[kind][0]
    chance = f"#{count}" if by_count else str(share)
    value = {
        "chance": f"={chance}",
        "late": f"={chance}:{more}",
        "id": f"={count % 253}",
        "slip": f"={count % 253}:{more}",
        "letter": "=F",
        "volts": f"={share * 20}",
        "time": f"={share * 200 + 1}",
        "nothing": "",
    }[meaning]
    fault = parse_fault(f"{kind}{value}@{times[0]}-{times[0] + times[1] + 0.001}")
    assert parse_fault(fault.spec) == fault


@given(st.text())
def test_any_text_is_a_fault_or_one_sentence(text):
    try:
        parse_fault(text)
    except InputError as error:
        assert str(error).startswith(("fault '", 'fault "'))
        assert len(str(error).splitlines()) == 1
