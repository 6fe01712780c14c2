"""Faults under the native twin: it ends where the host loop ends, for the same reason, with torque off."""

import re

import pytest
from firmware_runs import STS3215, XC330, firmware_run, host_run
from rig_bench import torque_read_back

from deploy.logs.replay import replay
from deploy.states import State

TASKS = pytest.mark.parametrize("task", [XC330, STS3215], ids=lambda task: task.rig.name)


def rough(words):
    """Return words without digits behind a point: firmware keeps ages and angles in thousandths."""
    return re.sub(r"(\d+)\.\d+", r"\1.#", str(words))


FAULTS = {
    "drop": (["drop=0.6@1.0"], State.FAULT),
    "corrupt": (["corrupt=0.6@1.0"], State.FAULT),
    "late": (["late=0.6:5@1.0"], State.FAULT),
    "dead": (["dead=2@1.2"], State.FAULT),
    "mute": (["mute=3@1.2"], State.FAULT),
    "brownout": (["brownout@1.2-1.5"], State.FAULT),
    "overload": (["overload=1@1.2"], State.FAULT),
    "overheat": (["overheat=2@1.2"], State.FAULT),
    "undervoltage": (["supply=3.6@1.2"], State.FAULT),
    "wrap": (["wrap=1@1.2"], None),
    "stuck": (["stuck=1@1.0"], None),
    "silent sensor": (["sensor-silent@1.2"], State.FAULT),
    "estop line": (["estop@1.2"], State.OFF),
    "absent": (["dead=1"], State.FAULT),
    "all dead": (["dead=1", "dead=2", "dead=3"], State.FAULT),
    "late at once": (["late=1:30"], State.FAULT),
    "no sensors": (["sensor-silent"], State.FAULT),
    "dead while homing": (["dead=3@0.4"], State.FAULT),
    "duplicate id": (["duplicate-id=1"], State.FAULT),
}


@TASKS
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_ends_the_run_where_and_why_it_ends_the_host_loops(tmp_path, task, name):
    faults, state = FAULTS[name]
    host = host_run(tmp_path / "host.mcap", task, faults, seconds=1.5)
    twin = firmware_run(tmp_path / "twin.mcap", task, faults, seconds=1.5)
    assert state is None or host.outcome.state is state
    assert twin.outcome.state is host.outcome.state
    assert rough(twin.outcome.reason) == rough(host.outcome.reason)
    assert [rough(text) for text in twin.told()] == [rough(text) for text in host.told()]
    assert twin.outcome.unsure == host.outcome.unsure
    assert abs(twin.outcome.cycles - host.outcome.cycles) <= 1
    torque = torque_read_back(twin.virtual)
    unsure = {joint.name for joint in twin.outcome.unsure}
    assert {torque[joint.name] for joint in task.rig.joints if joint.name not in unsure} <= {0}
    assert torque == torque_read_back(host.virtual)


WRONG = {
    XC330: {
        0: {"min_position_limit": 2000, "max_position_limit": 2100, "pwm_limit": 500, "hardware_error_status": 0x20},
        1: {"max_position_limit": 2100, "homing_offset": 100, "torque_enable": 1, "secondary_id": 7},
    },
    STS3215: {0: {"phase": 0x10, "max_angle_limit": 2100}, 2: {"min_angle_limit": 2040, "torque_enable": 1}},
}


@TASKS
def test_servos_that_are_set_up_wrong_are_told_as_the_host_loop_tells_them(tmp_path, task):
    host = host_run(tmp_path / "host.mcap", task, held=WRONG[task])
    twin = firmware_run(tmp_path / "twin.mcap", task, held=WRONG[task])
    assert (twin.outcome.state, twin.outcome.reason) == (host.outcome.state, host.outcome.reason)
    assert host.outcome.state is State.FAULT
    assert twin.told() == host.told()
    assert all(any(name in text for _, text in twin.told()) for name in task.rig.joints[0].family.position_limits)


@TASKS
@pytest.mark.parametrize(
    "faults", [("drop=0.03",), ("corrupt=0.03",), ("late=0.02:4",), ("sensor-drop=0.3", "sensor-corrupt=0.1")], ids=str
)
def test_isolated_glitches_ride_through(tmp_path, task, faults):
    host = host_run(tmp_path / "host.mcap", task, faults, seconds=3.0)
    twin = firmware_run(tmp_path / "twin.mcap", task, faults, seconds=3.0)
    assert twin.outcome.done, twin.outcome.reason
    assert (twin.outcome.state, twin.outcome.cycles) == (State.OFF, 150)
    assert twin.outcome.missed_replies == host.outcome.missed_replies
    assert twin.goals == host.goals
    assert replay(tmp_path / "twin.mcap").difference is None


def test_an_unplugged_adapter_is_silence_to_a_board(tmp_path):
    """The host loop sees its port die; a board's UART has no port, so it hears nobody."""
    twin = firmware_run(tmp_path / "twin.mcap", XC330, ["unplug@1.2-1.7"], seconds=2.0)
    assert twin.outcome.state is State.FAULT
    assert twin.outcome.reason.startswith("no servo has answered for 4 periods")
    assert twin.outcome.unsure == []  # it came back within a second
    assert set(torque_read_back(twin.virtual).values()) == {0}
    gone = firmware_run(tmp_path / "gone.mcap", XC330, ["unplug@1.2"], seconds=2.0)
    assert [joint.name for joint in gone.outcome.unsure] == ["a0", "a1", "a2"]
