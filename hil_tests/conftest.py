"""One suite for any rig: `pytest hil_tests` tests a virtual one, `--port PATH --rig-file NAME --arm` a real one.

Nothing is written to a rig that the start-up checks object to, and however the session ends, torque is off.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest
import runs
from interrupts import SIGNALS, Interrupts
from lab_report import LabReport, Measurement
from unplugging import unplug_virtual, unplugger

from controller import Rig, load_rig, registers
from controller.errors import InputError
from controller.register import Register, encode_register
from controller.rig import Joint
from deploy.buses.servo_bus import ServoBus
from deploy.checks import check_servos
from deploy.clock import Clock
from deploy.connection import connect_ports, connect_virtual
from deploy.joint_counts import joint_angle, joint_count
from deploy.period import Connection
from deploy.torque import release, seed_goals, torque_on, write_settings
from firmware_gen.projects.rig_config import require_speakable

DEFAULT_RIG = "lamp-xc330"
VIRTUAL, FIRMWARE = "virtual", "firmware"
REST_S = 0.5
REPORT = pytest.StashKey[LabReport]()
INTERRUPTS = pytest.StashKey[Interrupts]()
PROJECT = pytest.StashKey[Path]()
ORDER = ("identity", "registers", "bus", "motion", "run", "watchdog", "disconnects", "torque")
"""What is tested first keeps what comes later from harm."""


def pytest_addoption(parser):
    group = parser.getgroup("rig")
    group.addoption(
        "--rig",
        "--rig-file",
        dest="rig",
        action="append",
        help="'virtual', 'firmware' or 'firmware:NAME' (a virtual rig too, but its runs are made by firmware), or the "
        "name or file of the rig under test; left out: virtual",
    )
    group.addoption("--port", help="servo bus of a real rig, as /dev/ttyUSB0; left out: a virtual rig in lock step")
    group.addoption("--sensor-port", help="sensor node of a real rig")
    group.addoption("--arm", action="store_true", help="allow torque on a real rig: its joints will move")
    group.addoption("--hands", action="store_true", help="somebody is at the rig, to pull its plug when asked")
    group.addoption("--control", type=Path, help="control socket of a rig that `servolve rig serve` serves")
    group.addoption("--report", type=Path, help="file for what was measured: HTML if it ends so, else JSON")


def pytest_configure(config):
    config.option.rig = one_rig(config.option.rig)
    config.stash[REPORT] = LabReport()
    config.stash[INTERRUPTS] = Interrupts()
    if config.getoption("--port") and config.getoption("--rig").split(":")[0] in (VIRTUAL, FIRMWARE):
        raise pytest.UsageError("--port: which rig is it? name it with --rig-file, as `servolve rig list` prints it")
    if config.getoption("--port") and not config.getoption("--arm"):
        raise pytest.UsageError("--port: the joints of the rig will move; say --arm when nobody is in their way")
    report = config.getoption("--report")
    if report and not report.absolute().parent.is_dir():
        raise pytest.UsageError(f"--report: there is no folder {report.parent}; make it first")


def pytest_collection_modifyitems(items):
    here = Path(__file__).parent

    def place(item):
        name = item.path.stem.removeprefix("test_")
        return ORDER.index(name) if item.path.parent == here and name in ORDER else -1

    items.sort(key=place)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    if item.path.parent == Path(__file__).parent and (call.when == "call" or outcome.outcome != "passed"):
        item.config.stash[REPORT].tests[item.name] = outcome.outcome
    return outcome


def pytest_terminal_summary(terminalreporter, config):
    report = config.stash[REPORT]
    if report.rig:
        terminalreporter.section("rig")
        for line in report.lines():
            terminalreporter.write_line(line)
    path = config.getoption("--report")
    if path:
        report.save(path)
        terminalreporter.write_line(f"report: {path}")


@pytest.fixture(scope="session")
def interrupts(request):
    """Heed signals as long as the rig is in use."""
    interrupts = request.config.stash[INTERRUPTS]
    before = {number: signal.signal(number, interrupts.note) for number in SIGNALS}
    try:
        yield interrupts
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def one_rig(given: str | list[str] | None) -> str:
    """Return what --rig and --rig-file mean together: `firmware` and a rig's name are that rig run by firmware."""
    if not isinstance(given, list):
        return given or VIRTUAL  # another process of the same run has made it one
    kinds = [option for option in given if option in (VIRTUAL, FIRMWARE)]
    names = [option for option in given if option not in kinds]
    if len(kinds) == 1 and len(names) == 1 and names[0].partition(":")[0] not in (VIRTUAL, FIRMWARE):
        return f"{kinds[0]}:{names[0]}"
    if len(given) > 1:
        raise pytest.UsageError(f"--rig: {' and '.join(given)} are two rigs; name one")
    return given[0]


def rig_name(option: str) -> str:
    """Return the name or file of the rig that an option means."""
    kind, _, name = option.partition(":")
    if kind in (VIRTUAL, FIRMWARE):
        return name or DEFAULT_RIG
    return option


@dataclass(frozen=True)
class Bench:
    """Hold a rig under test: its bus and its time."""

    rig: Rig
    bus: ServoBus
    clock: Clock
    virtual: bool
    unplug: Callable[[], float] | None = None
    """Pulls the adapter's plug and puts it in again; returns in what time that is done [s]. None: nobody can."""
    link: Connection | None = None
    """What the bus and the clock belong to."""
    body: object | None = None
    """The virtual rig, None on a real one."""

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(joint.id for joint in self.rig.joints)

    @property
    def family(self):
        """Return the first joint's family; all of a line share a protocol and a state block."""
        return self.rig.joints[0].family

    def register(self, joint: Joint, name: str) -> Register:
        return registers(joint.product)[name]

    def read(self, joint: Joint, name: str) -> int:
        return self.bus.read_register(joint.id, self.register(joint, name))

    def write(self, joint: Joint, name: str, value: int):
        """Write a register once; return the reply."""
        register = self.register(joint, name)
        return self.bus.write(joint.id, register.address, encode_register(register, value))

    def values(self, name: str) -> list[int]:
        """Read a register of every servo, named as its family calls that part."""
        return [self.read(joint, getattr(joint.family, name)) for joint in self.rig.joints]

    def state(self) -> tuple[int, int]:
        """Return address and length of the block that is read in every period."""
        first, last = (self.register(self.rig.joints[0], name) for name in self.family.state)
        return first.address, last.address + last.size - first.address


@pytest.fixture(scope="session")
def report(request):
    """Return what is reported at the end of the session."""
    return request.config.stash[REPORT]


@pytest.fixture
def measured(request, report):
    """Return a function that puts a measurement into the report: what, unit, limit, and named values."""

    def note(what, unit, limit="", **values):
        numbers = {name: float(value) for name, value in values.items()}
        report.measured.append(Measurement(request.node.name, what, unit, numbers, limit))

    return note


@pytest.fixture(scope="session")
def bench(request, interrupts, report):
    """Connect to the rig and check it; at the end every servo's torque is off, as read back."""
    option = request.config.getoption
    with ExitStack() as stack:
        unplug, body = unplugger(request.config), None
        try:
            rig = load_rig(rig_name(option("--rig")))
            if option("--port"):
                # the tests are of the servos; a sensor node may be there or not
                wired = rig if option("--sensor-port") else replace(rig, sensors=())
                link = stack.enter_context(
                    connect_ports(wired, option("--port"), option("--sensor-port"), lambda: None)
                )
            else:
                from deploy.virtual.rig import VirtualRig

                body = VirtualRig(rig)
                if option("--rig").split(":")[0] == FIRMWARE:
                    require_speakable(rig)
                link = stack.enter_context(connect_virtual(body, lambda: None))
                unplug = partial(unplug_virtual, body)
        except InputError as error:
            pytest.exit(str(error), returncode=pytest.ExitCode.USAGE_ERROR)
        findings = check_servos(link.bus, rig)[1]
        wrong = [finding.text for finding in findings if finding.level == "error"]
        if wrong:
            pytest.exit("nothing was written: " + "; ".join(wrong), returncode=pytest.ExitCode.TESTS_FAILED)
        report.rig |= {"rig": rig.name, "port": option("--port") or "virtual", "protocol": rig.bus.protocol}
        report.rig |= {"baud": rig.bus.baud, "period_s": rig.period_s}
        report.findings += [f"{finding.level}: {finding.text}" for finding in findings]
        try:
            yield Bench(rig, link.bus, link.clock, not option("--port"), unplug, link, body)
        finally:
            with interrupts.deferring():
                left = release(link.bus, rig, link.clock)
            report.torque_off = not left
            assert not left, f"torque is not known to be off: {[joint.name for joint in left]}"


@pytest.fixture
def run(request, bench, interrupts, tmp_path_factory):
    """Return a function that makes a whole run on the rig, by the host loop or by firmware: seconds => Made."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    if request.config.getoption("--rig").split(":")[0] != FIRMWARE:
        return partial(runs.by_host, bench.link, bench.rig, path)
    project = request.config.stash.setdefault(PROJECT, tmp_path_factory.mktemp("firmware"))
    return partial(runs.by_firmware, bench.body, bench.link, bench.rig, project, path)


@pytest.fixture
def armed(bench, interrupts):
    """Hold every joint in neutral, with the rig's gains and no bus watchdog; give the goals; torque off afterwards."""
    try:
        write_settings(bench.bus, bench.rig, 1.0)
        goals = seed_goals(bench.bus, bench.rig)
        torque_on(bench.bus, bench.rig)
        for joint in bench.rig.joints:
            if joint.family.watchdog is not None:
                bench.bus.write_register(joint.id, bench.register(joint, joint.family.watchdog), 0)
        yield go_to_neutral(bench, goals)
    finally:
        with interrupts.deferring():
            left = release(bench.bus, bench.rig, bench.clock)
        assert left == []


def go_to_neutral(bench, start):
    """Move every joint slowly to neutral; return the goals there, once they are at rest."""
    rig = bench.rig
    if rig.joints[0].mode != "position":
        pytest.skip("its joints are driven by speed, not to a position")
    neutral = [joint_count(joint, joint.neutral_rad) for joint in rig.joints]
    travel = max(abs(joint_angle(j, a) - joint_angle(j, b)) for j, a, b in zip(rig.joints, start, neutral, strict=True))
    nstep = math.ceil(travel / (rig.safety.homing_rad_s * rig.period_s)) + 1
    begin = bench.clock.now()
    for step in range(1, nstep + 1):
        goals = {}
        for joint, a, b in zip(rig.joints, start, neutral, strict=True):
            register = bench.register(joint, joint.family.goal_position)
            goals[joint.id] = encode_register(register, round(a + (b - a) * step / nstep))
        bench.bus.sync_write(register.address, goals)
        bench.clock.sleep_until(begin + step * rig.period_s)
    bench.clock.sleep_until(bench.clock.now() + REST_S)
    return neutral
