"""`servolve rig setup`: a servo of any family gets its id and bit rate, and none that another servo has."""

import json
import os
import pty
import time
from contextlib import closing

import pytest
from manual import scs_text
from served_rig import servolve

from controller import load_rig
from controller.errors import InputError, RunError
from controller.families import family_of
from controller.products import PRODUCTS
from controller.registers import registers
from controller.rig_file import parse_rig
from deploy.buses.lockstep_port import LockstepPort
from deploy.buses.open_bus import open_bus
from deploy.commissioning.servo_setup import Place, changes, find_servo, move_servo, require_free
from deploy.virtual.faults import parse_fault
from deploy.virtual.lockstep import LockstepBench
from deploy.virtual.rig import VirtualRig
from servolve.cli import main

PATIENCE_S = 90.0  # the machine may be busy
RIGS = {"lamp-xc330": 57_600, "lamp-xl430": 4_500_000, "lamp-ax12": 500_000, "lamp-sts3215": 115_200, "scs": 500_000}
"""Rig => another bit rate than its own; of SCS servos none is shipped."""


class Line:
    """A virtual rig in lock step, whose servos are set up over its bus."""

    def __init__(self, bench, rig):
        self.bench, self.rig, self.product = bench, rig, rig.joints[0].product
        self.family, self.table = family_of(self.product), registers(self.product)
        self.rates = list(self.family.bauds.values())
        self.frames = []

    def open_port(self, baud):
        port = LockstepPort(self.bench, baud)
        port.tap = lambda way, _, frame: self.frames.append(frame) if way == "tx" else None
        return port

    def set_up(self, servo, new_id, new_baud, told=lambda _: None):
        """Do what the command does, but for asking."""
        found = find_servo(self.open_port, self.product, servo, self.rates)
        old, new = Place(found.id, found.baud), Place(new_id, new_baud)
        if changes(self.product, found, old, new):
            require_free(self.open_port, self.product, old, new)
            move_servo(self.open_port(old.baud), self.product, old, new, told)
        return old, new

    def held(self, place):
        with closing(open_bus(self.open_port(place.baud), self.rig)) as bus:
            return {
                name: bus.read_register(place.id, self.table[name])
                for name in ("id", "baud_rate", "torque_enable", *([self.family.lock] if self.family.lock else []))
            }

    def answers(self, place):
        with closing(open_bus(self.open_port(place.baud), self.rig)) as bus:
            return bus.ping(place.id)[0].status == "data"


@pytest.fixture
def line(request):
    """Return a line of the rig that the test names."""
    rig = parse_rig(scs_text(), load_rig("lamp-xl330").path) if request.param == "scs" else load_rig(request.param)
    with LockstepBench(VirtualRig(rig)) as bench:
        line = Line(bench, rig)
        line.other_baud = RIGS[request.param]
        yield line


each = pytest.mark.parametrize("line", RIGS, indirect=True)


@each
def test_a_servo_gets_id_and_bit_rate_for_good_and_goes_back(line):
    baud, made = line.other_baud, []
    with closing(open_bus(line.open_port(line.rig.bus.baud), line.rig)) as bus:
        bus.write_register(2, line.table["torque_enable"], 1)
    old, new = line.set_up(2, 17, baud, made.append)
    assert (old, new) == (Place(2, line.rig.bus.baud), Place(17, baud))
    assert made == ["id", "baud_rate"]
    assert not line.answers(old) and not line.answers(Place(2, baud)) and not line.answers(Place(17, old.baud))
    line.bench.rig.set_faults([parse_fault(f"dead={servo}") for servo in (1, 2, 3)])  # power off
    line.bench.rig.set_faults([])
    port = line.open_port(baud)
    port.wait(port.now() + 1.0)  # they boot
    port.closePort()
    held = line.held(new)
    assert (held["id"], line.family.bauds[held["baud_rate"]], held["torque_enable"]) == (17, baud, 0)
    assert line.family.protocol != "feetech" or held["lock"] == 1
    assert all(line.answers(Place(servo, old.baud)) for servo in (1, 3)), "the others are as they were"
    line.set_up(17, old.id, old.baud)
    assert line.answers(old)


@each
def test_an_id_that_another_servo_has_is_refused_wherever_the_servo_would_be(line):
    baud = line.other_baud
    with pytest.raises(InputError, match=r"a servo answers to id 3 at .* already; choose another id"):
        line.set_up(2, 3, line.rig.bus.baud)
    line.set_up(3, 3, baud)
    with pytest.raises(InputError, match=f"a servo answers to id 3 at {baud} bit/s already"):
        line.set_up(2, 3, baud)
    line.set_up(2, 9, baud)  # and an id that is free
    assert line.answers(Place(9, baud)) and line.answers(Place(3, baud))


@each
def test_before_anything_is_written_it_is_known_which_servo_is_meant(line):
    with pytest.raises(InputError, match=r"several servos answer: 1 at .*; connect only one, or name it with --id"):
        line.set_up(None, 9, line.rig.bus.baud)
    line.bench.rig.set_faults([parse_fault("mute=1"), parse_fault("mute=3")])
    assert find_servo(line.open_port, line.product, None, [line.rig.bus.baud]).id == 2
    line.bench.rig.set_faults([parse_fault("duplicate-id=2")])
    with pytest.raises(InputError, match="several servos answer to id 2; connect only the one"):
        line.set_up(2, 9, line.rig.bus.baud)
    with pytest.raises(InputError, match="servo 8 does not answer at"):
        line.set_up(8, 9, line.rig.bus.baud)
    reads = {0x01, 0x02}
    assert {frame[7 if frame[2:4] == b"\xfd\x00" else 4] for frame in line.frames} <= reads, "nothing was written"


@each
def test_what_a_servo_can_not_be_is_refused(line):
    found = find_servo(line.open_port, line.product, 2, [line.rig.bus.baud])
    old = Place(found.id, found.baud)
    assert changes(line.product, found, old, old) == []
    with pytest.raises(InputError, match=r"id 254: a .* takes 0 to 25[23]; choose one of them"):
        changes(line.product, found, old, Place(254, old.baud))
    with pytest.raises(InputError, match=r"1234 bit/s: a .* takes .*; choose one of them"):
        changes(line.product, found, old, Place(2, 1234))
    other = PRODUCTS["xl330-m288" if line.product.name == "xc330-m181" else "xc330-m181"]
    if family_of(other).protocol == line.family.protocol:
        with pytest.raises(InputError, match=f"servo 2 is no {other.name} but {line.product.name}; name that"):
            find_servo(line.open_port, other, 2, [line.rig.bus.baud])


@pytest.mark.parametrize("line", ["lamp-ax12"], indirect=True)
def test_a_locked_ax_servo_is_left_alone(line):
    with closing(open_bus(line.open_port(line.rig.bus.baud), line.rig)) as bus:
        bus.write_register(2, line.table["lock"], 1)
    with pytest.raises(InputError, match="servo 2 has its EEPROM locked until it is switched off"):
        line.set_up(2, 9, line.rig.bus.baud)


@each
def test_a_servo_that_falls_silent_half_way_is_told_with_where_it_is(line):
    def cut(register):
        assert register == "id"
        line.bench.rig.set_faults([parse_fault("drop=#40")])

    with pytest.raises(RunError, match=r"did not answer|reads"):
        line.set_up(2, 9, line.other_baud, cut)

    def interrupt(_):
        raise KeyboardInterrupt

    line.bench.rig.set_faults([])
    with pytest.raises(KeyboardInterrupt):
        line.set_up(1, 11, line.other_baud, interrupt)
    held = line.held(Place(11, line.rig.bus.baud))
    assert held["id"] == 11
    assert line.family.protocol != "feetech" or held["lock"] == 1, "closed on every way out"


def test_where_a_servo_answers_after_a_lost_write_is_said():
    """The write of the bit rate never reaches the servo: it is found at its new id and old rate."""
    rig = load_rig("lamp-xc330")
    with LockstepBench(VirtualRig(rig)) as bench:
        line = Line(bench, rig)

        def deafen(_):
            bench.rig.set_faults([parse_fault("deaf=#1")])

        with pytest.raises(RunError, match="it answers to id 9 at 1000000 bit/s now; try again from there"):
            line.set_up(2, 9, 57_600, deafen)
        line.set_up(9, 2, 57_600)
        assert line.answers(Place(2, 57_600))


# the command


@pytest.fixture
def served(serve_rig):
    return serve_rig("lamp-sts3215", "--no-wire-time")


def run(capfd, *arguments):
    """Set a servo up, again if a busy machine kept it from being found; return status, what was told, and the error."""
    until = time.monotonic() + PATIENCE_S
    while True:
        status = main(["rig", "setup", *arguments])
        told = capfd.readouterr()
        if status == 0 or "answer" not in told.err or time.monotonic() > until:
            return status, told.out, told.err


def test_the_command_takes_id_and_bit_rate_from_a_rig_file_and_keeps_a_backup(served, capfd, tmp_path):
    bus, backup = str(served.bus), tmp_path / "held.json"
    product = ("--product", "sts3215", "--baud", "1000000", "--yes", "--json")
    status, out, error = run(capfd, bus, *product, "--id", "2", "--new-id", "42", "--backup", str(backup))
    assert status == 0, error
    told = json.loads(out)
    assert (told["before"], told["after"]) == ({"id": 2, "baud": 1_000_000}, {"id": 42, "baud": 1_000_000})
    assert told["changed"] and told["backup"] == str(backup)
    assert f"back: servolve rig setup {bus} --product sts3215 --id 42 --baud 1000000 --new-baud" not in error
    assert f"servolve rig setup {bus} --product sts3215 --id 42 --new-id 2" in error
    kept = json.loads(backup.read_text())["servos"][0]
    assert (kept["id"], kept["product"], kept["baud"], kept["registers"]["id"]) == (2, "sts3215", 1_000_000, 2)
    rig = ("--rig", "lamp-sts3215", "--joint", "a1", "--id", "42", "--yes", "--json", "--baud", "1000000")
    status, out, error = run(capfd, bus, *rig, "--backup", str(tmp_path / "second.json"))
    assert (status, json.loads(out)["after"]) == (0, {"id": 2, "baud": 1_000_000}), error
    status, out, error = run(capfd, bus, *rig[:4], "--id", "2", *rig[6:])
    assert (status, json.loads(out)["changed"], json.loads(out)["backup"]) == (0, False, None), error
    assert "is there already" in error


@pytest.mark.parametrize(("answer", "new"), [(b"n\n", 2), (b"y\n", 20)])
def test_it_asks_before_it_writes(served, tmp_path, answer, new):
    master, slave = pty.openpty()
    arguments = ("--product", "sts3215", "--id", "2", "--baud", "1000000", "--new-id", "20")
    process = servolve("rig", "setup", served.bus, *arguments, "--backup", tmp_path / "backup.json", stdin=slave)
    os.close(slave)
    process.wait_for("to be changed")
    os.write(master, answer)
    status, _ = process.end()
    os.close(master)
    assert status == (1 if new == 2 else 0)
    assert (tmp_path / "backup.json").exists() == (new == 20)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["/dev/null", "--new-id", "3", "--yes"], "--product: which servo is it? name one of xc330-m181"),
        (["/dev/null", "--product", "x", "--new-id", "3", "--yes"], "--product: x is not known; name one of"),
        (["/dev/null", "--product", "ax-12a", "--yes"], "what shall the servo have? give one or both"),
        (["/dev/null", "--product", "ax-12a", "--new-id", "3"], "there is nobody to ask; add --yes to agree"),
        (["/dev/null", "--rig", "lamp-ax12", "--yes"], "--rig and --joint: name both, or neither"),
        (["/dev/null", "--rig", "lamp-ax12", "--joint", "a9", "--yes"], "has no such joint; name one of a0, a1, a2"),
        (["/dev/null", "--rig", "paper-lamp", "--joint", "a0", "--yes"], "setup needs a bus"),
        (["/dev/null", "--rig", "lamp-ax12", "--joint", "a0", "--new-id", "3", "--yes"], "leave --product and --new-"),
        (["socket://h:1", "--product", "ax-12a", "--new-baud", "9600", "--yes"], "a socket has no bit rate of its own"),
        (["/no/such", "--product", "ax-12a", "--new-id", "3", "--yes"], "cannot be opened"),
    ],
)
def test_wrong_arguments_are_one_sentence(arguments, expected, capfd, monkeypatch):
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: SIM115, PTH123
    assert main(["rig", "setup", *arguments]) == 2
    error = capfd.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
