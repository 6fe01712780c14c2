"""Scanning finds what is on a line, and says what it is not sure of."""

import json
import time

import pytest
from served_rig import serve

from controller import load_rig
from controller.errors import InputError
from deploy.buses.dynamixel_bus import DynamixelBus
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.pings import broadcast_ping, ping_each
from deploy.buses.port import SerialPort
from deploy.commissioning.scan import found_servos, scan, scan_steps
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.pty_line import PtyLine
from deploy.virtual.rig import VirtualRig
from servolve.cli import main

X330 = load_rig("lamp-xc330")
IDS = [joint.id for joint in X330.joints]
PATIENCE_S = 60.0  # the machine may be busy


READS = (0x01, 0x02)  # ping and read, in all protocols


def scanned(rig, steps, ids=(), refused=()):
    """Scan a virtual rig in lock step, and see that nothing is written; return all steps, those asked again too."""

    def only_reads(way, _, frame):
        if way == "tx":
            assert frame[7 if frame[2:4] == b"\xfd\x00" else 4] in READS, frame

    def open_port(baud):
        if baud in refused:
            raise InputError("no such rate")
        port = LockstepPort(bench, baud)
        port.tap = only_reads
        return port

    with LockstepBench(rig) as bench:
        return [step for step in scan(open_port, steps, ids) if step.found is not None]


def found_on(rig, steps, ids=(), refused=()):
    """Scan a sound virtual rig, on which asking again finds nobody else; return the steps."""
    found = scanned(rig, steps, ids, refused)
    assert not any(step.found for step in found if step.again)
    return [step for step in found if not step.again]


def test_all_bit_rates_and_protocols_are_asked_the_likeliest_first():
    steps = scan_steps()
    assert steps[:2] == [("dynamixel-2.0", 1_000_000), ("protocol-1", 1_000_000)]
    assert {baud for framing, baud in steps if framing == "dynamixel-2.0"} >= {
        9600,
        57600,
        115200,
        2_000_000,
        4_500_000,
    }
    assert {baud for framing, baud in steps if framing == "protocol-1"} >= {9600, 19200, 38400, 76800, 128_000, 500_000}
    assert len(set(steps)) == len(steps)
    assert scan_steps(("dynamixel-1.0",), [1_000_000]) == [("protocol-1", 1_000_000)]


def test_every_servo_is_found_once_with_what_it_is_set_to():
    asked = [("dynamixel-2.0", 57_600), ("protocol-1", 1_000_000), ("dynamixel-2.0", 1_000_000)]
    steps = found_on(VirtualRig(X330), asked)
    assert [(step.framing, step.baud, len(step.found)) for step in steps] == [
        (*step, count) for step, count in zip(asked, (0, 0, 3), strict=True)
    ]
    found = [servo for step in steps for servo in step.found]
    assert [(servo.id, servo.baud, servo.model, servo.products) for servo in found] == [
        (servo, 1_000_000, 1230, ("xc330-m181",)) for servo in IDS
    ]
    assert [servo.values["id"] for servo in found] == IDS
    assert all(servo.values["present_input_voltage"] == 50 and not servo.shared for servo in found)


def test_a_port_that_lacks_a_bit_rate_is_no_reason_to_stop():
    steps = found_on(
        VirtualRig(X330), [("dynamixel-2.0", 4_500_000), ("dynamixel-2.0", 1_000_000)], refused=[4_500_000]
    )
    assert [bool(step.skipped) for step in steps] == [True, False]
    assert [servo.id for servo in steps[1].found] == IDS
    with pytest.raises(InputError, match="no such rate"):
        found_on(VirtualRig(X330), [("dynamixel-2.0", 9600)], refused=[9600])


def test_ids_narrow_what_is_told():
    steps = found_on(VirtualRig(X330), [("dynamixel-2.0", 1_000_000)], ids=[2, 9])
    assert [servo.id for servo in steps[0].found] == [2]


def test_a_dead_servo_and_a_lost_answer():
    rig = VirtualRig(X330, faults=[parse_fault("dead=2")])
    assert [servo.id for servo in found_on(rig, [("dynamixel-2.0", 1_000_000)])[0].found] == [1, 3]


def test_noise_is_no_servo():
    """Every answer on the line is corrupt: who is there can not be told, and nobody else is invented."""
    rig = VirtualRig(X330, seed=3, faults=[parse_fault("corrupt=1")])
    found = found_servos(scanned(rig, [("dynamixel-2.0", 1_000_000)], ids=range(6)))
    assert {servo.id for servo in found} <= set(IDS)
    assert all(servo.shared for servo in found)


@pytest.mark.parametrize(
    ("name", "lost", "first"),
    [
        ("lamp-xc330", 2, [3]),  # of a broadcast ping's answers
        ("lamp-xc330", 3, []),
        ("lamp-sts3215", 1, [2, 3]),
        ("lamp-ax12", 3, []),
    ],
)
def test_those_whose_answers_were_lost_are_asked_again(name, lost, first):
    rig = load_rig(name)
    framing = "dynamixel-2.0" if rig.bus.protocol == "dynamixel-2.0" else "protocol-1"
    steps = scanned(VirtualRig(rig, faults=[parse_fault(f"drop=#{lost}")]), [(framing, rig.bus.baud)])
    assert [[servo.id for servo in step.found] for step in steps if not step.again] == [first]
    assert [servo.id for servo in found_servos(steps)] == IDS
    assert all(servo.values["id"] == servo.id for servo in found_servos(steps))


def test_servos_that_could_not_be_read_are_asked_again():
    """The ping's answers come, then none until the port is opened once more."""
    virtual, steps = VirtualRig(X330), []

    def lose_the_rest(way, *_):
        if way == "rx" and not steps:
            virtual.set_faults([parse_fault("drop=1")])

    def open_port(baud):
        virtual.set_faults([])
        port = LockstepPort(bench, baud)
        port.tap = lose_the_rest
        return port

    with LockstepBench(virtual) as bench:
        for step in scan(open_port, [("dynamixel-2.0", 1_000_000)]):
            steps += [step] if step.found is not None else []
    assert [[servo.id for servo in step.found] for step in steps] == [IDS, IDS]
    assert not any(servo.values for servo in steps[0].found)
    assert [servo.values["id"] for servo in found_servos(steps)] == IDS


def test_asking_again_ends_in_time_where_nobody_is():
    times = []

    def open_port(baud):
        return LockstepPort(bench, baud)

    with LockstepBench(VirtualRig(load_rig("lamp-ax12"), faults=[parse_fault("mute=1")])) as bench:
        for step in scan(open_port, scan_steps(("feetech", "dynamixel-1.0"), [9_600, 57_600])):
            times.append((step.again, bench.rig.now))
    began = next(time for again, time in times if again)
    assert times[-1][0] and times[-1][1] - began < 3.5


class Line(SerialPort):
    """The port over a real pseudo terminal, with a script at the other end and time that only waiting moves."""

    def __init__(self, answer, latency_s=0.002):
        self.line, self.answer, self.time, self.coming, self.asked = PtyLine(), answer, 0.0, [], []
        super().__init__(self.line.path, 1_000_000)
        self.latency_s = latency_s

    def now(self):
        return self.time

    def writePort(self, packet):  # noqa: N802
        frame = self.line.read(super().writePort(packet))
        self.asked.append(frame)
        self.coming = sorted(self.coming + [(self.time + after, data) for after, data in self.answer(frame)])

    def wait(self, deadline):
        while not self.waiting():
            if not self.coming or self.coming[0][0] > deadline:
                self.time = max(self.time, deadline)
                return False
            self.time, data = self.coming.pop(0)
            self.line.write_through(data)
        return True

    def closePort(self):  # noqa: N802
        super().closePort()
        self.line.close()


@pytest.fixture
def line():
    """Return a function that opens a port with a script at its other end."""
    opened = []

    def open_line(answer, **settings):
        opened.append(Line(answer, **settings))
        return opened[-1]

    yield open_line
    for port in opened:
        port.closePort()


PING_1, STATUS_1 = bytes.fromhex("FFFF 01 02 01 FB"), bytes.fromhex("FFFF 01 02 00 FC")
BROADCAST = bytes.fromhex("FFFFFD00 FE 0300 01 3142")
STATUS_2 = bytes.fromhex("FFFFFD00 01 0700 55 00 0604 26 655D")


def test_pings_are_the_manuals_and_so_are_the_answers(line):
    port = line(lambda _: [(0.01, STATUS_2[:5]), (0.012, STATUS_2[5:])])
    assert broadcast_ping(port).models == {1: 0x0406}
    assert port.asked == [BROADCAST]
    port = line(lambda frame: [(1e-3, STATUS_1)] if frame == PING_1 else [])
    answers = ping_each(port, range(4))
    assert (answers.models, answers.garbled) == ({1: 0}, False)
    assert port.asked[1] == PING_1


@pytest.mark.parametrize("others", [range(2, 8), ()])
def test_an_answer_that_an_adapter_held_back_counts_for_its_servo(line, others):
    port = line(lambda frame: [(0.016, STATUS_1)] if frame == PING_1 else [], latency_s=0.02)
    answers = ping_each(port, [0, 1, *others])
    assert (answers.models, answers.garbled) == ({1: 0}, False)


def test_two_servos_with_one_id_garble_the_answer(line):
    other = bytes.fromhex("FFFFFD00 01 0700 55 00 B004 26 1234")
    both = bytes(a & b for a, b in zip(STATUS_2, other, strict=True))
    answers = broadcast_ping(line(lambda _: [(0.01, both)]))
    assert (answers.models, answers.garbled) == ({}, True)
    assert broadcast_ping(line(lambda _: [(0.01, STATUS_2 + STATUS_2)])).garbled


def test_an_echo_is_no_answer(line):
    answers = broadcast_ping(line(lambda frame: [(0.0, frame), (0.01, STATUS_2)]))
    assert (answers.models, answers.garbled) == ({1: 0x0406}, False)


def test_an_echo_is_no_servo_and_hides_none(line):
    port = line(lambda frame: [(0.0, frame), *([(1e-3, STATUS_1)] if frame == PING_1 else [])])
    answers = ping_each(port, range(5))
    assert (answers.models, answers.garbled) == ({1: 0}, False)
    # a servo with the wrong voltage answers with the bytes of the question
    port = line(lambda frame: [(0.0, frame), *([(1e-3, PING_1)] if frame == PING_1 else [])])
    assert ping_each(port, range(5)).models == {1: 0}
    port = line(lambda frame: [(1e-3, PING_1)] if frame == PING_1 else [])
    assert ping_each(port, range(5)).models == {1: 0}


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-sts3215"])
def test_servos_behind_an_adapter_that_echoes_are_found(name):
    rig = load_rig(name)
    asked = [("dynamixel-2.0", rig.bus.baud), ("protocol-1", rig.bus.baud), ("protocol-1", 115_200)]
    steps = found_on(VirtualRig(rig, echo=True), asked)
    assert [servo.id for step in steps for servo in step.found] == IDS


@pytest.mark.parametrize(
    ("name", "protocol", "products"),
    [
        ("lamp-ax12", "dynamixel-1.0", ("ax-12a",)),
        ("lamp-sts3215", "feetech", ("sts3215", "sts3215-7v4")),
        ("lamp-xl430", "dynamixel-2.0", ("xl430-w250",)),
    ],
)
def test_every_family_is_told_by_what_its_servos_say(name, protocol, products):
    rig = load_rig(name)
    step = ("dynamixel-2.0" if protocol == "dynamixel-2.0" else "protocol-1", rig.bus.baud)
    found = found_on(VirtualRig(rig), [step])[0].found
    assert [(servo.id, servo.protocol, servo.products) for servo in found] == [
        (joint.id, protocol, products) for joint in rig.joints
    ]
    for servo, joint in zip(found, rig.joints, strict=True):
        assert servo.model == joint.product.model_number
        assert servo.values["id"] == joint.id
        assert not servo.shared


@pytest.mark.parametrize("name", ["lamp-xc330", "lamp-ax12", "lamp-sts3215"])
def test_two_servos_with_one_id_are_told(name):
    rig = load_rig(name)
    step = ("dynamixel-2.0" if rig.bus.protocol == "dynamixel-2.0" else "protocol-1", rig.bus.baud)
    virtual = VirtualRig(rig, faults=[parse_fault("duplicate-id=2")])
    found = found_on(virtual, [step], ids=range(8))[0].found
    assert [(servo.id, servo.shared) for servo in found] == [(1, False), (2, True)]


def test_a_servo_at_another_bit_rate_is_found_there():
    virtual = VirtualRig(X330)
    with LockstepBench(virtual) as bench:
        bus = DynamixelBus(LockstepPort(bench, 1_000_000))
        assert bus.write(2, 8, bytes([1])).status == "data"
        bus.close()
        steps = [
            step for step in scan(lambda baud: LockstepPort(bench, baud), scan_steps(("dynamixel-2.0",))) if step.found
        ]
    assert [(step.baud, [servo.id for servo in step.found]) for step in steps] == [(1_000_000, [1, 3]), (57_600, [2])]
    assert [(servo.id, servo.baud) for servo in found_servos(steps)] == [(1, 1_000_000), (3, 1_000_000), (2, 57_600)]


def test_a_model_without_a_table_is_told_by_its_number(line):
    found = [step.found for step in scan(lambda _: line(lambda _: [(0.01, STATUS_2)]), [("dynamixel-2.0", 57_600)])][1]
    assert [(servo.id, servo.model, servo.products, servo.values) for servo in found] == [(1, 0x0406, (), {})]


# the command


def test_the_command_finds_a_rig_and_says_which_it_is(tmp_path, capfd):
    process = serve(tmp_path, "lamp-xc330")
    try:
        until = time.monotonic() + PATIENCE_S
        for port in (process.bus, process.tcp):
            told = {"servos": []}
            while len(told["servos"]) < 3 and time.monotonic() < until:
                main(["rig", "scan", str(port), "--protocol", "dynamixel-2.0", "--ids", "1-3", "--json"])
                told = json.loads(capfd.readouterr().out)
            assert [(servo["id"], servo["products"], servo["shared_id"]) for servo in told["servos"]] == [
                (servo, ["xc330-m181"], False) for servo in IDS
            ]
            assert told["rigs"] == ["lamp-xc330"]
            assert f"servolve rig check lamp-xc330 --port {port}" in told["notes"][-1]
    finally:
        process.kill()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["/dev/null", "--ids", "1-300"], "--ids 1-300: '1-300' is no number from 0 to 253; write it as 1-8,20"),
        (["/dev/null", "--ids", "x"], "'x' is no number from 0 to 253"),
        (["/dev/null", "--ids", "3-1"], "'3-1' is no number"),
        (["/dev/null", "--bauds", "1000-2000"], "'1000-2000' is no number from 1"),
        (["/dev/null", "--bauds", ""], "'' is no number"),
        (["socket://localhost:1", "--bauds", "57600"], "a socket has no bit rate"),
        (["/no/such/port"], "cannot be opened"),
        (["/dev/null", "--protocol", "dynamixel"], "Invalid value"),
    ],
)
def test_wrong_arguments_are_one_sentence(arguments, expected, capfd):
    assert main(["rig", "scan", *arguments]) == 2
    error = capfd.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
