"""Strangers' clients, each a process with packages of its own, driving `servolve rig serve`."""

import pytest
from manual import scs_text
from strangers import run_client

from controller.rig_file import load_rig

ACCESS_ERROR = 7


def ids(rig):
    return [joint.id for joint in rig.joints]


def only_at(baud, scan, present):
    return scan[str(baud)] == present and all(not found for rate, found in scan.items() if rate != str(baud))


@pytest.mark.parametrize("package", [None, "dynamixel-sdk-3"], ids=["sdk 4.1", "sdk 3.7.31"])
def test_dynamixel_sdk_on_x_servos(serve_rig, package):
    rig = load_rig("lamp-xc330")
    bus = serve_rig(rig.name).bus
    seen = run_client(package, "dynamixel.py", bus, rig.bus.baud, 2.0, *ids(rig))
    assert only_at(rig.bus.baud, seen["scan"], ids(rig)), seen["scan"]
    assert seen["id"] == [0, True, False, 0, True, False], "the old id answers the change, the new one from then on"
    assert seen["baud"] == [0, True, False, 0, True]
    assert seen["eeprom"] == [ACCESS_ERROR, True, 0, 20]
    assert seen["move"] == [True, True]
    assert seen["act"] == [1, 0, 1]
    result, positions = seen["sync_read"]
    assert result == 0 and all(0 < position < 4096 for position in positions)
    result, position, warmth = seen["bulk_read"]
    assert result == 0 and abs(position - positions[0]) < 20 and 20 <= warmth <= 60
    assert seen["bulk_write"] == [1, 0x234]
    if package is None:
        result, fast = seen["fast_sync_read"]
        assert result == 0 and fast == pytest.approx(positions, abs=20)
    written, middle = seen["calibrate"]
    assert written == [0] * 7 and abs(middle - 2047) <= 3
    assert seen["reboot"] == [True, 0]
    assert all(45 <= volts <= 55 and 20 <= warmth <= 60 for _, volts, warmth in seen["health"])
    assert seen["torque"] == [0] * len(ids(rig))


def test_rustypot_on_x_servos(serve_rig):
    rig = load_rig("lamp-xc330")
    bus = serve_rig(rig.name).bus
    seen = run_client(None, "rusty.py", bus, rig.bus.baud, "Xl330PyController", *ids(rig))
    assert seen["scan"] == [ids(rig), [1230]]
    assert seen["id"] == seen["baud"] == [True] * 3
    assert seen["eeprom"][0] and str(ACCESS_ERROR) in seen["eeprom"][1], seen["eeprom"]
    assert seen["move"] and seen["broadcast"] == ids(rig) and seen["fast"] == [3, True]
    assert seen["torque"] == [0] * 3


@pytest.mark.parametrize("package", [None, "dynamixel-sdk-3"], ids=["sdk 4.1", "sdk 3.7.31"])
def test_dynamixel_sdk_on_ax_servos(serve_rig, package):
    rig = load_rig("lamp-ax12")
    bus = serve_rig(rig.name).bus
    seen = run_client(package, "dynamixel.py", bus, rig.bus.baud, 1.0, *ids(rig))
    assert only_at(rig.bus.baud, seen["scan"], ids(rig)), seen["scan"]
    assert seen["id"] == [0, True, False, 0, True, False]
    assert seen["baud"] == [0, True, False, 0, True]
    refused, kept, accepted, changed = seen["eeprom"]
    assert refused and (kept, accepted, changed) == (True, 0, 20)
    assert seen["move"] == [True, True]
    assert seen["act"] == [1, 0, 1]
    assert all(90 <= volts <= 125 and 20 <= warmth <= 60 for _, volts, warmth in seen["health"])
    assert seen["torque"] == [0] * 3


def test_rustypot_on_ax_servos(serve_rig):
    rig = load_rig("lamp-ax12")
    seen = run_client(None, "rusty.py", serve_rig(rig.name).bus, rig.bus.baud, "AxPyController", *ids(rig))
    assert seen["scan"] == [ids(rig), [12]]
    assert seen["id"] == seen["baud"] == [True] * 3
    assert seen["eeprom"][0] and seen["move"]
    assert seen["torque"] == [0] * 3


@pytest.mark.parametrize("package", ["feetech-1", "feetech-2"])
def test_scservo_sdk_on_sts_servos(serve_rig, package):
    rig = load_rig("lamp-sts3215")
    seen = run_client(package, "feetech.py", serve_rig(rig.name).bus, rig.bus.baud, "sts", *ids(rig))
    assert only_at(rig.bus.baud, seen["scan"], ids(rig)), seen["scan"]
    assert seen["model"] == 777
    assert seen["id"] == [0, 0, True, False, 0, 0, True, False, 0]
    assert seen["baud"] == [0, True, False, 0, True, 0]
    assert seen["move"] == [1, True, True], "a goal switches torque on"
    assert seen["act"] == [False, True]
    result, positions = seen["sync_read"]
    assert result == 0 and all(0 < position < 4096 for position in positions)
    before, middle, offset = seen["rehome"]
    assert abs(middle - 2048) < 20 and offset != before
    written, middle, gain = seen["calibrate"]
    assert written == [0] * len(written) and abs(middle - 2047) <= 20 and gain == 16
    assert all(load <= 1000 and 100 <= volts <= 130 and 20 <= warmth <= 60 for load, volts, warmth in seen["health"])
    assert seen["torque"] == [0] * 3


def test_rustypot_on_sts_servos(serve_rig):
    rig = load_rig("lamp-sts3215")
    seen = run_client(None, "rusty.py", serve_rig(rig.name).bus, rig.bus.baud, "Sts3215PyController", *ids(rig))
    assert seen["scan"] == [ids(rig), [777]]
    assert seen["id"] == seen["baud"] == [True] * 3
    assert seen["move"]
    assert seen["torque"] == [0] * 3


@pytest.fixture
def scs_rig(tmp_path):
    """Return the path of a lamp on SCS0009 servos, of which no rig is shipped."""
    folder = tmp_path / "scs"
    folder.mkdir()
    body = load_rig("lamp-xl330").body
    (folder / body.name).write_bytes(body.read_bytes())
    (folder / "lamp-scs.rig.toml").write_text(scs_text())
    return folder / "lamp-scs.rig.toml"


@pytest.mark.parametrize("package", ["feetech-1", "feetech-2"])
def test_scservo_sdk_on_scs_servos(serve_rig, scs_rig, package):
    rig = load_rig(scs_rig)
    seen = run_client(package, "feetech.py", serve_rig(scs_rig).bus, rig.bus.baud, "scs", *ids(rig))
    assert only_at(rig.bus.baud, seen["scan"], ids(rig)), seen["scan"]
    assert seen["model"] == 1284
    assert seen["id"] == [0, 0, True, False, 0, 0, True, False, 0]
    assert seen["baud"] == [0, True, False, 0, True, 0]
    assert seen["move"] == [1, True, True]
    assert seen["torque"] == [0] * 3


def test_rustypot_on_scs_servos(serve_rig, scs_rig):
    rig = load_rig(scs_rig)
    seen = run_client(None, "rusty.py", serve_rig(scs_rig).bus, rig.bus.baud, "Scs0009PyController", *ids(rig))
    assert seen["scan"] == [ids(rig), [1284]]
    assert seen["id"] == seen["baud"] == [True] * 3
    assert seen["move"]
    assert seen["torque"] == [0] * 3
