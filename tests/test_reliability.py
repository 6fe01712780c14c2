"""Faults in every state on servos of every family: a part of the page's runs, all of it with `--long`."""

import itertools

import pytest
from reliability import FAULTS, RIGS, STATES, check_freshness, check_goals, controller_of, read_page, run_cell
from rig_bench import Bench

CELLS = list(itertools.product(RIGS, FAULTS, STATES))
SHORT = 19  # every so manieth cell: all rigs, all states, one fault in three or four

RIDES_THROUGH = ("duplicate=1", "unsolicited=1", "sensor-babble")
NO_ANSWER = "no servo has answered for 4 periods; check the bus cable and the power supply"
TOO_LATE = "; set the adapter's latency timer to 1 ms, or look for what else holds bytes back"
SENTENCES = {
    "dead=2": ("joint a1 (servo 2) gave no reply for 4 periods; check its cable and its power",),
    "mute=2": ("joint a1 (servo 2) gave no reply for 4 periods; check its cable and its power",),
    "dead=2 for 0.3 s": ("joint a1 (servo 2) gave no reply for 4 periods",),
    "brownout": (NO_ANSWER,),
    "brownout for 0.3 s": (NO_ANSWER,),
    "drop=1": (NO_ANSWER,),
    "corrupt=1": (NO_ANSWER,),
    "truncate=1": (NO_ANSWER,),
    "deaf=1": (NO_ANSWER,),
    "late=1:40": (TOO_LATE,),
    "latency-timer=16": (TOO_LATE,),
    "duplicate-id=2": ("joint a2 (servo 3) gave", "joint a1 (servo 2) gave"),
    "unplug": ("the port is gone",),
    "unplug for 0.3 s": ("the port is gone",),
    "supply=low": ("V are needed; charge the battery", "(input voltage)"),
    "overload=2": ("joint a1 (servo 2) reports a hardware error (overload)", "joint a1 (servo 2) has no torque"),
    "overheat=2": ("joint a1 (servo 2) reports a hardware error (overheating)", "joint a1 (servo 2) has no torque"),
    "wrap=2:1000": ("joint a1 (servo 2) has jumped by", "joint a1 (servo 2) is at"),
    "stuck=2": ("rad from its goal", "did not come to rest", "turns at 0.00 rad/s"),
    "sensor-silent": ("has given nothing new",),
    "estop": ("stopped: the sensor node sent an emergency stop",),
}


@pytest.fixture(scope="module")
def told():
    return read_page()


def pytest_generate_tests(metafunc):
    if "cell" in metafunc.fixturenames:
        metafunc.parametrize("cell", CELLS if metafunc.config.getoption("--long") else CELLS[::SHORT], ids=" ".join)


def test_the_page_says_what_happens(tmp_path, told, cell):
    came = run_cell(tmp_path, *cell)
    assert told[cell] == (came.status, came.text())


def test_the_page_has_every_fault_in_every_state_of_every_rig(told):
    assert list(told) == CELLS, "python tests/reliability.py runs them"


def test_what_rides_through_ends_well_and_what_lasts_is_told_in_its_own_words(told):
    assert set(SENTENCES) | set(RIDES_THROUGH) == set(FAULTS)
    for (_, fault, state), (status, text) in told.items():
        if state == "stopping":
            assert status == 1 and (
                text.startswith("stopped: a key was pressed") or text.startswith("torque could not be switched off")
            )
        elif fault in RIDES_THROUGH:
            assert (status, text) == (0, "the time is over")
        else:
            assert status == 1 and any(sentence in text for sentence in SENTENCES[fault]), (fault, text)


@pytest.mark.parametrize("name", RIGS)
def test_isolated_glitches_end_in_a_finished_run(request, tmp_path, name):
    seconds = 60.0 if request.config.getoption("--long") else 6.0
    on = Bench(tmp_path, "drop=0.01", "corrupt=0.01", "late=0.01", rig=RIGS[name], seed=3)
    outcome = on.run(seconds, controller=controller_of(RIGS[name], gently=True))
    assert outcome.done and not outcome.faulty, outcome.reason
    assert outcome.missed_replies > 0.02 * outcome.cycles  # a line that is really that bad
    on.fault = "glitches"
    check_goals(on)
    check_freshness(on)
    assert set(on.torque_read_back().values()) == {0}
