"""One suite for any rig: `pytest hil_tests` tests a virtual one, `--port PATH --rig-file NAME --arm` a real one.

Nothing is written to a rig that the start-up checks object to, and however the session ends, torque is off.
"""

from __future__ import annotations

import math
import signal
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

import pytest

from controller import Rig, load_rig, registers
from controller.errors import InputError
from controller.registers import Register
from deploy.checks import check_servos
from deploy.clock import Clock
from deploy.connection import connect_ports, connect_virtual
from deploy.dynamixel_bus import DynamixelBus, encode
from deploy.joint_counts import joint_angle, joint_count
from deploy.torque import release, seed_goals, torque_on, write_settings

DEFAULT_RIG = "lamp-xc330"
REST_S = 0.5
REPORT = pytest.StashKey[list[str]]()
INTERRUPTS = pytest.StashKey["Interrupts"]()
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Let the first signal end the session as Ctrl-C does, fixtures and all; no other one disturbs the way out."""

    def __init__(self):
        self.number = None
        self.deferred = 0

    def note(self, number, _):
        if self.number is None:
            self.number = number
            if not self.deferred:
                raise KeyboardInterrupt(f"{signal.Signals(number).name} was received")

    @contextmanager
    def deferring(self):
        """Finish what must not be cut in two, as switching torque off; then heed a signal that came meanwhile."""
        before = self.number
        self.deferred += 1
        try:
            yield
        finally:
            self.deferred -= 1
        if self.number != before and not self.deferred:
            raise KeyboardInterrupt(f"{signal.Signals(self.number).name} was received")


def pytest_addoption(parser):
    group = parser.getgroup("rig")
    group.addoption(
        "--rig",
        "--rig-file",
        dest="rig",
        default="virtual",
        help="'virtual', or the name or file of the rig under test",
    )
    group.addoption("--port", help="servo bus of a real rig, as /dev/ttyUSB0; left out: a virtual rig in lock step")
    group.addoption("--sensor-port", help="sensor node of a real rig")
    group.addoption("--arm", action="store_true", help="allow torque on a real rig: its joints will move")


def pytest_configure(config):
    config.stash[REPORT] = []
    config.stash[INTERRUPTS] = Interrupts()
    if config.getoption("--port") and config.getoption("--rig") == "virtual":
        raise pytest.UsageError("--port: which rig is it? name it with --rig-file, as `servolve rig list` prints it")
    if config.getoption("--port") and not config.getoption("--arm"):
        raise pytest.UsageError("--port: the joints of the rig will move; say --arm when nobody is in their way")


def pytest_terminal_summary(terminalreporter, config):
    if config.stash[REPORT]:
        terminalreporter.section("rig")
        for line in config.stash[REPORT]:
            terminalreporter.write_line(line)


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


@dataclass(frozen=True)
class Bench:
    """Hold a rig under test: its bus and its time."""

    rig: Rig
    bus: DynamixelBus
    clock: Clock
    virtual: bool

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(joint.id for joint in self.rig.joints)

    def table(self, index: int = 0) -> dict[str, Register]:
        return dict(registers(self.rig.joints[index].product))

    def values(self, name: str) -> list[int]:
        return [self.bus.read_register(joint.id, registers(joint.product)[name]) for joint in self.rig.joints]


@pytest.fixture(scope="session")
def report(request):
    """Return a function that adds a line to the end of pytest's output."""
    return request.config.stash[REPORT].append


@pytest.fixture(scope="session")
def bench(request, interrupts):
    """Connect to the rig and check it; at the end every servo's torque is off, as read back."""
    option = request.config.getoption
    with ExitStack() as stack:
        try:
            rig = load_rig(DEFAULT_RIG if option("--rig") == "virtual" else option("--rig"))
            if option("--port"):
                # the tests are of the servos; a sensor node may be there or not
                wired = rig if option("--sensor-port") else replace(rig, sensors=())
                link = stack.enter_context(
                    connect_ports(wired, option("--port"), option("--sensor-port"), lambda: None)
                )
            else:
                from deploy.virtual.rig import VirtualRig

                link = stack.enter_context(connect_virtual(VirtualRig(rig), lambda: None))
        except InputError as error:
            pytest.exit(str(error), returncode=pytest.ExitCode.USAGE_ERROR)
        wrong = [finding.text for finding in check_servos(link.bus, rig)[1] if finding.level == "error"]
        if wrong:
            pytest.exit("nothing was written: " + "; ".join(wrong), returncode=pytest.ExitCode.TESTS_FAILED)
        try:
            yield Bench(rig, link.bus, link.clock, not option("--port"))
        finally:
            with interrupts.deferring():
                left = release(link.bus, rig, link.clock)
            assert not left, f"torque is not known to be off: {[joint.name for joint in left]}"


@pytest.fixture
def armed(bench, interrupts):
    """Hold every joint in neutral, with the rig's gains and no bus watchdog; give the goals; torque off afterwards."""
    try:
        write_settings(bench.bus, bench.rig, 1.0)
        goals = seed_goals(bench.bus, bench.rig)
        torque_on(bench.bus, bench.rig)
        for joint in bench.rig.joints:
            bench.bus.write_register(joint.id, registers(joint.product)["bus_watchdog"], 0)
        yield go_to_neutral(bench, goals)
    finally:
        with interrupts.deferring():
            left = release(bench.bus, bench.rig, bench.clock)
        assert left == []


def go_to_neutral(bench, start):
    """Move every joint slowly to neutral; return the goals there, once they are at rest."""
    rig, goal = bench.rig, bench.table()["goal_position"]
    neutral = [joint_count(joint, joint.neutral_rad) for joint in rig.joints]
    travel = max(abs(joint_angle(j, a) - joint_angle(j, b)) for j, a, b in zip(rig.joints, start, neutral, strict=True))
    nstep = math.ceil(travel / (rig.safety.homing_rad_s * rig.period_s)) + 1
    begin = bench.clock.now()
    for step in range(1, nstep + 1):
        goals = [round(a + (b - a) * step / nstep) for a, b in zip(start, neutral, strict=True)]
        bench.bus.sync_write(goal.address, {j.id: encode(goal, g) for j, g in zip(rig.joints, goals, strict=True)})
        bench.clock.sleep_until(begin + step * rig.period_s)
    bench.clock.sleep_until(bench.clock.now() + REST_S)
    return neutral
