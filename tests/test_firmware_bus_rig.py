"""The firmware's bus master on the virtual rig, with every fault of a bus: as the host's, question for question."""

from dataclasses import replace

import pytest
import runtime_shim
from runtime_shim import Bus
from two_masters import HostBus

from controller import load_rig, registers
from controller.families import FAMILIES
from deploy.buses.servo_bus import BusError
from deploy.connection import connect_virtual
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig

runtime = runtime_shim.runtime


class RigLine:
    """The firmware's end of a virtual rig's bus; the rig owns time."""

    def __init__(self, virtual):
        self.virtual = virtual
        self.asked = []
        self._t = virtual.now
        self._waiting = b""

    @property
    def now_us(self):
        return round(1e9 * self._t) // 1000

    def send(self, frame):
        self.asked.append((round(1e9 * self._t), frame))
        self.virtual.transmit(frame, self._t)
        self._pump(self._t)
        return len(frame)

    def wait(self, until_us):
        until = max(1e-6 * until_us, self._t)
        event = self.virtual.next_event()
        if not self._waiting:
            self._pump(until if event is None else min(event, until))

    def take(self, size):
        taken, self._waiting = self._waiting[:size], self._waiting[size:]
        return taken

    def sleep_until(self, t):
        self._pump(max(t, self._t))

    def _pump(self, t):
        self.virtual.advance(t)
        self._waiting += b"".join(reply for _, reply in self.virtual.replies_until(t))
        self._t = max(t, self._t)


class Ways:
    """What servos of a family are asked: its registers, and a write that changes nothing."""

    def __init__(self, rig):
        self.ids = tuple(joint.id for joint in rig.joints)
        family, table = rig.joints[0].family, registers(rig.joints[0].product)
        self.state = (family.load, family.velocity, family.position)
        places = [table[name] for name in self.state]
        self.first = min(place.address for place in places)
        self.size = max(place.address + place.size for place in places) - self.first
        self.health = table[family.temperature]
        self.led = table["led" if "led" in table else "torque_limit"]

    def cycle(self, bus, k):
        servo = self.ids[k % len(self.ids)]
        yield bus.sync_read(self.first, self.size)
        bus.sync_write(self.led.address, bytes((1, 0)[: self.led.size]) * len(self.ids))
        yield bus.read(servo, self.health.address, self.health.size)
        if k % 7 == 3:
            yield bus.ping(servo)
            yield bus.write(servo, self.led.address, bytes((1, 0)[: self.led.size]))


FAULTS = [
    (),
    ("drop=0.1",),
    ("corrupt=0.1", "truncate=0.05"),
    ("late=0.1:3",),
    ("late=0.05", "duplicate=0.05", "unsolicited=0.05"),
    ("dead=1@0.2-0.5",),
    ("mute=3@0.1", "drop=0.02"),
    ("deaf=0.1", "overload=2@0.3"),
    ("brownout@0.2-0.4",),
    ("latency-timer=4",),
]


def _drive(rig, bus, sleep_until, ncycle, period_s):
    ways = Ways(rig)
    told = []
    for k in range(ncycle):
        sleep_until(period_s * k)
        told += ways.cycle(bus, k)
    return told


def _host_run(rig, faults, ncycle, period_s=0.02):
    asked = []
    virtual = VirtualRig(rig, faults=[parse_fault(fault) for fault in faults])
    with connect_virtual(virtual, lambda: None) as link:
        link.bus.port.tap = lambda kind, t, frame: kind == "tx" and asked.append((round(1e9 * t), frame))
        bus = HostBus(link.bus, tuple(joint.id for joint in rig.joints))
        return _drive(rig, bus, link.clock.sleep_until, ncycle, period_s), asked


def _firmware_run(runtime, rig, faults, ncycle, period_s=0.02, **settings):
    line = RigLine(VirtualRig(rig, faults=[parse_fault(fault) for fault in faults]))
    bus = Bus(
        runtime,
        line,
        rig.bus.protocol,
        [joint.id for joint in rig.joints],
        baud=rig.bus.baud,
        return_delay_us=rig.bus.return_delay_us,
        patience_us=1000,
        **settings,
    )
    return _drive(rig, bus, line.sleep_until, ncycle, period_s), line.asked


@pytest.mark.parametrize("faults", FAULTS, ids=" ".join)
@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-sts3215"])
def test_every_question_leaves_when_the_hosts_does(runtime, name, faults):
    rig = load_rig(name)
    host, host_asked = _host_run(rig, faults, 40)
    told, asked = _firmware_run(runtime, rig, faults, 40)
    assert asked == host_asked  # to the nanosecond: a byte takes whole microseconds
    assert told == host


def test_the_time_of_bytes_on_the_line_is_exact_at_every_rate():
    rates = {rate for family in FAMILIES.values() for rate in family.bauds.values()}
    assert {57_600, 1_000_000, 4_500_000} <= rates
    assert all(rate % 100 == 0 for rate in rates)


@pytest.mark.parametrize("baud", [57_600, 115_200])
def test_where_a_byte_takes_no_whole_microseconds_a_question_is_off_by_no_more_than_two(runtime, baud):
    rig = load_rig("lamp-xc330")
    rig = replace(rig, bus=replace(rig.bus, baud=baud))
    faults = ("drop=0.1", "dead=2@0.2-0.4")
    _, host_asked = _host_run(rig, faults, 30, 0.1)
    _, asked = _firmware_run(runtime, rig, faults, 30, 0.1)
    assert [frame for _, frame in asked] == [frame for _, frame in host_asked]
    assert max(abs(here - there) for (here, _), (there, _) in zip(asked, host_asked, strict=True)) <= 2000


def test_a_fast_sync_read_falls_back_while_a_servo_is_dead(runtime):
    rig = load_rig("lamp-xc330")
    fast, asked = _firmware_run(runtime, rig, (), 30, fast=True)
    syncs = [frame[7] for _, frame in asked if frame[7] in (dxl.SYNC_READ, dxl.FAST_SYNC_READ)]
    assert syncs == [dxl.SYNC_READ] + [dxl.FAST_SYNC_READ] * 29
    assert {reply.status for replies in fast if isinstance(replies, dict) for reply in replies.values()} == {"data"}
    told, asked = _firmware_run(runtime, rig, ("dead=1@0.1-0.3",), 60, fast=True)
    states = [reply for reply in told if isinstance(reply, dict)]
    here = [[reply.status for reply in state.values()] for state in states]
    assert here[7:14] == [["missing", "data", "data"]] * 7
    assert here[-1] == ["data"] * 3
    assert [frame[7] for _, frame in asked if frame[7] in (dxl.SYNC_READ, dxl.FAST_SYNC_READ)][-1] == dxl.FAST_SYNC_READ


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-sts3215"])
def test_registers_are_written_and_read_back_as_the_host_does(runtime, name):
    rig = load_rig(name)
    table = registers(rig.joints[0].product)
    ids = [joint.id for joint in rig.joints]
    faults = [parse_fault("drop=0.2"), parse_fault("corrupt=0.2")]
    goal = table[rig.joints[0].family.goal("position")]
    line = RigLine(VirtualRig(rig, faults=faults))
    bus = Bus(runtime, line, rig.bus.protocol, ids, return_delay_us=rig.bus.return_delay_us, patience_us=1000)
    with connect_virtual(VirtualRig(rig, faults=faults), lambda: None) as link:
        for n in range(24):
            servo, count = ids[n % 3], 1900 + 7 * n
            try:
                link.bus.write_register(servo, goal, count)
                want = ("data", count)
            except BusError as error:
                want = str(error)
            status, held = bus.write_register(servo, goal, count)
            assert (status, held) == want or (status in ("missing", "corrupt") and "it " in want)
            assert line.now_us == round(1e6 * link.clock.now())


def test_what_a_servo_refuses_is_refused(runtime):
    rig = load_rig("lamp-xc330")
    table = registers(rig.joints[0].product)
    bus = Bus(runtime, RigLine(VirtualRig(rig)), rig.bus.protocol, [joint.id for joint in rig.joints])
    assert bus.write_register(2, table["model_number"], 1)[0] == "refused"
    assert bus.write_register(2, table["goal_pwm"], -885) == ("data", -885)
