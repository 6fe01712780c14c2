"""The control socket: faults, time and state while a rig runs, for programs in any language of this machine alone."""

import json
import socket
import stat
import time
from contextlib import suppress

import pytest
import serial
from served_rig import WAIT_S, servolve

from controller.errors import InputError
from controller.rig_file import load_rig
from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.control_channel import ControlChannel, answer_request
from deploy.virtual.rig import VirtualRig
from servolve.cli import main

RIG = load_rig("lamp-xc330")
JOINTS = len(RIG.joints)


def ask(rig, **request):
    return json.loads(answer_request(rig, json.dumps(request).encode()))


def test_faults_time_and_state():
    rig = VirtualRig(RIG)
    assert ask(rig, time=None) == {"time": 0.0, "faults": []}
    rig.advance(0.25)
    told = ask(rig, faults=["dead=2", "drop=#3@1"])
    assert told == {"time": 0.25, "faults": ["dead=2", "drop=#3@1"]}
    rig.transmit(dxl.encode(2, dxl.PING), rig.now)
    rig.advance(0.3)
    assert rig.replies_until(0.3) == []
    assert ask(rig, faults=[])["faults"] == []
    state = ask(rig, state=None)["state"]
    truth = rig.truth()
    assert state["joint_rad"] == truth.joint_rad.tolist()
    assert state["base_pos"] == truth.base_pos.tolist()
    assert [servo["id"] for servo in state["servos"]] == [joint.id for joint in RIG.joints]
    assert [servo["supply_v"] for servo in state["servos"]] == [RIG.supply_v] * JOINTS


def test_what_has_fallen_is_set_upright_again():
    rig = VirtualRig(RIG, start="limp")
    rig.advance(3.0)
    limp = rig.truth()
    assert max(abs(limp.joint_rad)) > 0.5, "nobody holds its arms"
    ask(rig, upright=None)
    rig.advance(4.0)
    stands = VirtualRig(RIG)
    stands.advance(1.0)
    assert rig.truth().base_pos == pytest.approx(stands.truth().base_pos, abs=2e-3)
    assert rig.truth().base_rpy == pytest.approx(stands.truth().base_rpy, abs=0.02)
    assert rig.truth().joint_rad == pytest.approx(stands.truth().joint_rad, abs=0.02)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"", "is no JSON"),
        (b"nonsense", "is no JSON"),
        (b"\xff\x00", "is no JSON"),
        (b"[" * 100000, "is no JSON"),
        (b"[]", "has other keys than faults, state, time, upright"),
        (b"{}", "has other keys than faults, state, time, upright"),
        (b'{"fault": []}', "has other keys than faults, state, time, upright"),
        (b'{"faults": "dead=2"}', "faults is not a list of texts"),
        (b'{"faults": [2]}', "faults is not a list of texts"),
        (b'{"faults": ["ded=2"]}', "did you mean 'dead'?"),
        (b'{"faults": ["stuck=1", "dead=9"]}', "has no such servo"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_changes_nothing(line, expected):
    rig = VirtualRig(RIG)
    ask(rig, faults=["mute=1"])
    told = json.loads(answer_request(rig, line))
    assert list(told) == ["error"]
    assert expected in told["error"]
    assert "\n" not in told["error"]
    assert ask(rig, time=None)["faults"] == ["mute=1"]


def lines_of(channel, rig, client, data):
    """Send bytes, let the channel serve, and return its answers."""
    client.sendall(data)
    channel.serve(rig)
    channel.serve(rig)
    client.settimeout(WAIT_S)
    return [json.loads(line) for line in client.recv(65536).splitlines()]


def test_lines_may_come_in_pieces_several_at_once_and_from_several_clients(tmp_path):
    rig, path = VirtualRig(RIG), tmp_path / "control"
    with ControlChannel(path) as channel:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        with socket.socket(socket.AF_UNIX) as one, socket.socket(socket.AF_UNIX) as other:
            for client in (one, other):
                client.connect(str(path))
            one.sendall(b'{"faults": ["mu')
            channel.serve(rig)
            channel.serve(rig)
            assert rig.faults == ()
            assert lines_of(channel, rig, one, b'te=1"]}\n{"time": null}\n') == 2 * [
                {"time": 0.0, "faults": ["mute=1"]}
            ]
            assert lines_of(channel, rig, other, b'{"faults": []}\n') == [{"time": 0.0, "faults": []}]
        channel.serve(rig)
        assert len(channel.sockets()) == 1, "who is gone is forgotten"
        with socket.socket(socket.AF_UNIX) as chatterbox:
            chatterbox.connect(str(path))
            chatterbox.setblocking(False)
            for _ in range(8):
                with suppress(OSError):
                    chatterbox.send(b"x" * 20000)
                channel.serve(rig)
            assert len(channel.sockets()) == 1, "who sends no line end is cut off"
    assert not path.exists()


def test_a_socket_that_was_left_is_replaced_and_anything_else_is_not(tmp_path):
    path = tmp_path / "control"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    with ControlChannel(path), pytest.raises(InputError, match="the control socket can not be there"):
        ControlChannel(path)
    path.write_text("dear diary")
    with pytest.raises(InputError, match="the control socket can not be there"):
        ControlChannel(path)
    assert path.read_text() == "dear diary"
    with pytest.raises(InputError, match="name a short path"):
        ControlChannel(tmp_path / ("x" * 200))


def test_a_served_rig_is_unplugged_and_plugged_in_again(tmp_path):
    link, path, faults = tmp_path / "bus", tmp_path / "control", tmp_path / "faults.toml"
    faults.write_text('format = 1\nfaults = ["mute=3"]\n')
    arguments = ("--link", link, "--control", path, "--tcp", 0, "--host", "127.0.0.1", "--fault", faults)
    served = servolve("rig", "serve", "lamp-xc330", *arguments)
    try:
        port = int(served.wait_for(r"socket://127\.0\.0\.1:(\d+)").group(1))
        served.wait_for(f"control +{path}")
        with socket.socket(socket.AF_UNIX) as control, serial.Serial(str(link), RIG.bus.baud, timeout=WAIT_S) as bus:
            control.settimeout(WAIT_S)
            control.connect(str(path))
            answers = control.makefile()

            def tell(request):
                control.sendall(request + b"\n")
                return json.loads(answers.readline())

            assert tell(b'{"time": null}')["faults"] == ["mute=3"]
            bus.write(dxl.encode(1, dxl.PING))
            assert len(bus.read(14)) == 14
            with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as wire:
                tell(b'{"faults": ["unplug"]}')
                assert wire.recv(1) == b"", "a TCP client is cut off"
            gone = time.monotonic() + WAIT_S
            while link.is_symlink():
                assert time.monotonic() < gone
            with pytest.raises((OSError, serial.SerialException)):
                while True:
                    bus.write(dxl.encode(1, dxl.PING))
                    bus.read(1)
            tell(b'{"faults": []}')
            while not link.is_symlink():
                assert time.monotonic() < gone
            with serial.Serial(str(link), RIG.bus.baud, timeout=WAIT_S) as again:
                again.write(dxl.encode(3, dxl.PING))
                assert len(again.read(14)) == 14
    finally:
        served.kill()


def test_an_address_needs_a_port_and_must_be_of_this_machine(capsys):
    assert main(["rig", "serve", "lamp-xc330", "--host", "127.0.0.1"]) == 2
    assert "give --tcp too" in capsys.readouterr().err
    assert main(["rig", "serve", "lamp-xc330", "--tcp", "0", "--host", "192.0.2.1"]) == 2
    assert "host '192.0.2.1': is no address of this machine" in capsys.readouterr().err
