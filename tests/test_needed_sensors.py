"""Which sensors a run can not do without, written down terminal by terminal."""

from dataclasses import replace

import pytest

from controller import Controller, Input, Output, load_rig, lower
from controller.needed_sensors import needed_sensors
from controller.rig_joints import DERIVED_TERMINALS
from controller.source import Name, Source

RIG = load_rig("lamp-xc330")
BASE = {"x", "y", "heading"}
NEEDS = {
    "t": set(),
    "goal_dist": set(),
    "px": BASE,
    "py": BASE,
    "goal_met": BASE,
    "heading_error": BASE,
    "pz": {"z"},
    "s0": {"force"},
    "a0": set(),
    "a0_vel": set(),
}


def needed(rig, *terminals):
    source = Source(tuple(Name(terminal) for terminal in terminals))
    outputs = tuple(Output(f"o{i}", "position", "rad", -1.0, 1.0, 0.0) for i in range(len(terminals)))
    inputs = tuple(Input(terminal, "1", -1.0, 1.0) for terminal in terminals)
    controller = Controller("it", 0.02, inputs, outputs, source, lower(source, terminals))
    return {rig.sensors[number].name for number in needed_sensors(rig, controller)}


@pytest.mark.parametrize("terminal", NEEDS)
def test_a_terminal_needs_the_sensors_it_is_made_of(terminal):
    rig = replace(RIG, safety=replace(RIG.safety, tilt_rad_max=0.0))
    assert needed(rig, terminal) == NEEDS[terminal]
    assert needed(RIG, terminal) == NEEDS[terminal] | {"roll", "pitch"}, "the tilt guard reads two of them"


def test_several_terminals_need_what_each_needs():
    rig = replace(RIG, safety=replace(RIG.safety, tilt_rad_max=0.0))
    assert needed(rig, "pz", "s0", "px") == {*BASE, "z", "force"}


def test_every_derived_terminal_is_written_down_here():
    assert NEEDS.keys() >= set(DERIVED_TERMINALS)
