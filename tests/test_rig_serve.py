"""`servolve rig serve` in a process of its own, driven by the vendor's SDK and by rustypot."""

import math
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import rustypot
import serial
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from controller.rig_file import load_rig, rig_names
from deploy.virtual import dynamixel2 as dxl
from servolve.cli import main

RIG = load_rig("lamp-xc330")
IDS = [joint.id for joint in RIG.joints]
PATIENCE_S = 60.0  # the machine may be busy with other tests
BAUD = RIG.bus.baud
P_GAIN, TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION = 84, 64, 116, 132


def until(ask, good):
    """Ask again until the answer is good; return it. A starved machine answers after a client's patience has ended."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            answer = ask()
            if good(answer):
                return answer
        except (OSError, RuntimeError) as error:
            answer = error
        assert time.monotonic() < deadline, answer
        time.sleep(0.01)


@contextmanager
def served(*arguments, folder):
    """Serve a rig from another process; give its process and what it printed."""
    process = subprocess.Popen(
        [Path(sys.executable).with_name("servolve"), "rig", "serve", "lamp-xc330", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )
    try:
        lines = [process.stdout.readline() for _ in range(4 if "--tcp" in arguments else 3)]
        assert all(lines), process.stderr.read()
        yield process, "".join(lines)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


@pytest.fixture
def link(tmp_path):
    path = tmp_path / "bus"
    with served("--link", str(path), folder=tmp_path):
        yield str(path)


def test_the_vendors_sdk_scans_reads_writes_and_moves_a_joint(link):
    port = PortHandler(link)
    assert port.setBaudRate(BAUD)
    sdk = PacketHandler(2.0)
    model = RIG.joints[0].product.model_number
    found, _ = until(lambda: sdk.broadcastPing(port), lambda answer: len(answer[0]) == len(IDS))
    assert {servo: numbers[0] for servo, numbers in found.items()} == dict.fromkeys(IDS, model)
    for servo in IDS:
        until(lambda: sdk.write2ByteTxRx(port, servo, P_GAIN, 1450), lambda answer: answer == (COMM_SUCCESS, 0))  # noqa: B023
        gain = until(lambda: sdk.read2ByteTxRx(port, servo, P_GAIN), lambda answer: answer[1] == COMM_SUCCESS)  # noqa: B023
        assert gain == (1450, COMM_SUCCESS, 0)
        until(lambda: sdk.write1ByteTxRx(port, servo, TORQUE_ENABLE, 1), lambda answer: answer == (COMM_SUCCESS, 0))  # noqa: B023
    positions = GroupSyncRead(port, sdk, PRESENT_POSITION, 4)
    goals = GroupSyncWrite(port, sdk, GOAL_POSITION, 4)
    for servo in IDS:
        assert positions.addParam(servo)

    def read():
        answer = positions.txRxPacket()
        return [positions.getData(servo, PRESENT_POSITION, 4) for servo in IDS] if answer == COMM_SUCCESS else []

    before = until(read, bool)
    wanted = [before[0] + 60, before[1] - 60, before[2] + 120]
    for servo, goal in zip(IDS, wanted, strict=True):
        assert goals.addParam(servo, list(goal.to_bytes(4, "little")))

    def move():
        assert goals.txPacket() == COMM_SUCCESS
        return read()

    until(move, lambda now: now == pytest.approx(wanted, abs=20))
    port.closePort()


def test_rustypot_scans_reads_writes_and_moves_a_joint(link):
    # rustypot has one table for the X330 family
    bus = rustypot.Xl330PyController(link, BAUD, 5.0)
    found = until(lambda: bus.scan([*IDS, 9]), lambda found: len(found) == len(IDS))
    assert found == dict.fromkeys(IDS, RIG.joints[0].product.model_number)
    assert until(lambda: [bus.ping(servo) for servo in IDS], all)
    before = until(lambda: bus.sync_read_present_position(IDS), lambda now: len(now) == len(IDS))
    assert max(abs(angle) for angle in before) < 0.05, "it stands at its neutral pose"

    def write(name, values):
        getattr(bus, f"sync_write_{name}")(IDS, values)
        return getattr(bus, f"sync_read_{name}")(IDS)

    until(lambda: write("position_p_gain", [1450] * 3), lambda gains: gains == [1450] * 3)
    tick = 2.0 * math.pi / 4096  # to which rustypot truncates
    until(lambda: write("goal_position", before), lambda now: now == pytest.approx(before, abs=tick))
    until(lambda: write("torque_enable", [True] * 3), all)
    goal = [before[0] + 0.1, before[1] - 0.1, before[2] + 0.2]
    until(lambda: write("goal_position", goal), lambda now: now == pytest.approx(goal, abs=tick))
    until(lambda: bus.sync_read_present_position(IDS), lambda now: now == pytest.approx(goal, abs=0.03))


def read_lines(node, count):
    data = b""
    deadline = time.monotonic() + PATIENCE_S
    while data.count(b"\r\n") < count:
        assert time.monotonic() < deadline, data
        data += node.read(4096)
    return data.split(b"\r\n")[1:-1]


def test_sensor_lines_and_the_bus_over_tcp_and_a_twin(tmp_path):
    sensors = tmp_path / "sensors"
    twin = tmp_path / "twin.toml"
    twin.write_text('format = 1\n[twin]\nname = "heavy"\nmass_scale = 1.5\n')
    arguments = ("--sensor-link", str(sensors), "--tcp", "0", "--twin", str(twin), "--fault", "mute=2")
    with served(*arguments, folder=tmp_path) as (_, told):
        assert "twin heavy" in told
        with serial.Serial(str(sensors), timeout=0.1) as node:
            lines = read_lines(node, 60)
        force = [int(line.split(b",")[3].partition(b"*")[0]) * 1e-3 for line in lines if line.startswith(b"$F")]
        assert force[-1] == pytest.approx(1.5 * 0.229 * 9.81, abs=0.05)
        stamps = [int(line.split(b",")[2]) for line in lines if line.startswith(b"$P")]
        assert stamps == sorted(stamps)
        assert len(set(stamps)) == len(stamps) > 10
        port = int(told.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as client:
            client.sendall(dxl.encode(dxl.BROADCAST, dxl.PING))
            parser, ids = dxl.PacketParser(), []
            while len(ids) < 2:
                ids += [packet.id for packet in parser.feed(client.recv(4096))]
            assert ids == [1, 3], "servo 2 is mute"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order(tmp_path, number):
    links = [tmp_path / "bus", tmp_path / "sensors"]
    with served("--link", str(links[0]), "--sensor-link", str(links[1]), folder=tmp_path) as (process, told):
        assert all(path.is_symlink() and path.exists() for path in links)
        assert str(links[0].readlink()) in told
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == 0
        assert not any(path.is_symlink() for path in links)
        errors = process.stderr.read()
        assert "Traceback" not in errors


def test_a_link_that_was_left_is_replaced_and_a_file_is_not(tmp_path, capsys):
    left, mine = tmp_path / "left", tmp_path / "mine"
    left.symlink_to("/dev/pts/no-such")
    mine.write_text("dear diary")
    with served("--link", str(left), folder=tmp_path):
        assert left.exists()
        assert os.path.realpath(left) != "/dev/pts/no-such"
    assert main(["rig", "serve", "lamp-xc330", "--link", str(mine)]) == 2
    assert "is there already and is no link" in capsys.readouterr().err
    assert mine.read_text() == "dear diary"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["lamp-xc33"], "there is no rig 'lamp-xc33'; did you mean 'lamp-xc330'?"),
        (["lamp-xc330", "--fault", "dead=9"], "has no such servo"),
        (["lamp-xc330", "--fault", "ded=1"], "did you mean 'dead'?"),
        (["lamp-xc330", "--twin", "no-such.toml"], "is not known; choose one of lopsided"),
        (["lamp-xc330", "--link", "/no/such/folder/bus"], "the link can not be made"),
        (["lamp-xc330", "--link", "x", "--sensor-link", "x"], "give them two paths"),
        (["lamp-xc330", "--tcp", "70000"], "TCP port 70000 can not be used"),
        (["lamp-xc330", "--prot", "1"], "Unknown option"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_arguments_are_one_sentence_and_status_2(arguments, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["rig", "serve", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert expected in error
    assert not list(Path(tmp_path).iterdir())


def test_rig_list_names_every_rig(capsys):
    assert main(["rig", "list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(rig_names())
