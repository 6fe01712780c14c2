"""Firmware on the rigs that no evolved lamp runs on here: other servos, and joints that are driven by their speed."""

import re

import pytest
from firmware_runs import Task, firmware_run, host_run
from rig_bench import torque_read_back

from controller import load_rig, parse_controller
from controller.rig_file import parse_rig
from deploy.logs.replay import replay
from deploy.states import State
from firmware_gen.projects.joint_config import servo_kinds


def swaying(rig):
    """Return a controller that moves every joint of a rig, each by its mode."""
    outputs, goals = "", []
    for number, joint in enumerate(rig.joints):
        unit, size, most = ("deg", 12, 40) if joint.mode == "position" else ("rad/s", 4, 6)
        goals.append(f"(* {size} (osc-wave 0.3 0.{number}))")
        outputs += f'[[output]]\nname = "{joint.name}"\nkind = "{joint.mode}"\nunit = "{unit}"\n'
        outputs += f"low = -{most}\nhigh = {most}\nneutral = 0\n"
    head = f'program = "(list {" ".join(goals)})"\n[controller]\nname = "sway"\nperiod_s = {rig.period_s}\n'
    return parse_controller(
        f'{head}slew_rad_s = 8.0\n[[input]]\nname = "t"\nunit = "s"\nlow = 0\nhigh = 60\n{outputs}', "sway"
    )


def mixed():
    """Return a lamp of two products, and of two torque ceilings with one of them."""
    lamp = load_rig("lamp-xl330")
    _, second, third = lamp.text.split("[[joint]]")[1:]
    text = lamp.text.replace('name = "lamp-xl330"', 'name = "lamp-mixed"')
    text = text.replace(second, second.replace("xl330-m288", "xc330-m181"))
    return parse_rig(text.replace(third, third.replace("pwm_limit = 885", "pwm_limit = 800")), lamp.path)


RIGS = (*map(load_rig, ("lamp-xl330", "lamp-xl430", "jumper-xc330")), mixed())
TASKS = {rig.name: Task(rig, swaying(rig), 0.3) for rig in RIGS}


@pytest.mark.parametrize("name", TASKS)
def test_a_run_is_the_host_loops_byte_for_byte(tmp_path, name):
    host, twin = (
        make(tmp_path / f"{make.__name__}.mcap", TASKS[name], seconds=2.0) for make in (host_run, firmware_run)
    )
    assert (host.outcome.state, host.outcome.cycles) == (State.OFF, 100)
    assert len(set(host.goals)) > 80
    assert twin.goals == host.goals
    assert twin.outcome.bus_sha256 == host.outcome.bus_sha256
    assert twin.log.messages["/truth"] == host.log.messages["/truth"]
    assert twin.told() == host.told()
    assert set(torque_read_back(twin.virtual).values()) == {0}
    assert replay(tmp_path / "firmware_run.mcap").difference is None


@pytest.mark.parametrize(
    "fault", ["stuck=1@1.0", "wrap=1@1.2", "dead=2@1.2", "overload=1@1.2", "drop=0.5@1.2", "wrap=1"]
)
def test_a_fault_of_a_rig_that_is_driven_by_speed_ends_where_the_host_loops_ends(tmp_path, fault):
    jumper = TASKS["jumper-xc330"]
    host, twin = (
        make(tmp_path / f"{make.__name__}.mcap", jumper, [fault], seconds=2.0) for make in (host_run, firmware_run)
    )
    assert twin.outcome.state is host.outcome.state
    rough = [re.sub(r"\.\d+", "", run.outcome.reason) for run in (twin, host)]
    assert rough[0] == rough[1]
    assert torque_read_back(twin.virtual) == torque_read_back(host.virtual)
    assert host.outcome.faulty or fault.startswith("wrap")


def test_servos_of_one_product_and_setting_are_one_to_the_firmware():
    kinds = {name: servo_kinds(task.rig) for name, task in TASKS.items()}
    assert kinds["lamp-xl330"] == (0, 0, 0)
    assert kinds["lamp-mixed"] == (0, 1, 2)
