"""A dry run reads a rig of any family, shows how its servos are, and writes nothing."""

import io
import re
import time
from contextlib import closing

import pytest
from lamp_controllers import NOD
from rich.console import Console
from served_rig import serve

from controller import load_rig
from controller.rig_file import rig_names
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.open_bus import open_bus
from deploy.checks import check_servos
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig
from servolve.cli import main
from servolve.reading_table import reading_table

RIGS = [name for name in rig_names() if not load_rig(name).simulated_only]
PATIENCE_S = 60.0  # the machine may be busy


def rows(text):
    """Return the cells of each line of a printed table."""
    return [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if line.startswith("│")]


def check(rig, *faults):
    """Check a virtual rig in lock step; return it, and the table that is shown."""
    virtual = VirtualRig(rig, faults=[parse_fault(fault) for fault in faults])
    with LockstepBench(virtual) as bench, closing(open_bus(LockstepPort(bench, rig.bus.baud), rig)) as bus:
        readings, _ = check_servos(bus, rig)
    screen = io.StringIO()
    Console(file=screen, width=120).print(reading_table(readings))
    return virtual, rows(screen.getvalue())


@pytest.mark.parametrize("name", RIGS)
def test_every_shipped_rigs_servos_are_shown_as_they_are(name):
    rig = load_rig(name)
    virtual, found = check(rig)
    for joint, servo, row in zip(rig.joints, virtual.servos, found, strict=True):
        assert row[:3] == [joint.name, str(joint.id), joint.product.name]
        assert int(row[3]) == servo.table[joint.family.position]
        assert row[5:] == [f"{rig.supply_v:.1f}", "25", "off", "none"]


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-ax12", "lamp-sts3215"])
def test_what_a_servo_says_is_wrong_is_named(name):
    _, found = check(load_rig(name), "overheat=2", "dead=3")
    assert [row[-1] for row in found] == ["none", "overheating", "-"]
    assert found[2][3:] == ["-"] * 6


@pytest.mark.parametrize("name", ["lamp-ax12", "lamp-sts3215"])
def test_without_arm_a_served_rig_is_only_read(name, tmp_path, capfd):
    controller = tmp_path / "nod.controller.toml"
    controller.write_text(NOD)
    process = serve(tmp_path, name)
    ports = ("--port", str(process.bus), "--sensor-port", str(process.sensors))
    until = time.monotonic() + PATIENCE_S
    try:
        status, error = 1, ""
        while status and time.monotonic() < until:
            status = main(["deploy", str(controller), "--rig", name, *ports])
            error = capfd.readouterr().err
    finally:
        process.kill()
    assert status == 0, error
    assert [(row[0], row[-2:]) for row in rows(error)] == [(joint, ["off", "none"]) for joint in ("a0", "a1", "a2")]
    assert re.search(r"every check passed; nothing was written: give\s+--arm", error)
