"""LeRobot's calibration files: one of a real arm is read, what is written reads the same, and mistakes are told."""

import json

import pytest

from controller.errors import InputError
from deploy.commissioning.lerobot import MotorCalibration, calibration_text, read_calibration

# two motors of an SO-101 follower, as published with a LeRobot data set
ARM = {
    "shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": -1365, "range_min": 746, "range_max": 3477},
    "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": -1200, "range_min": 822, "range_max": 3211},
}


def test_a_file_of_an_arm_is_read_and_written_alike(tmp_path):
    file = tmp_path / "arm.json"
    file.write_text(json.dumps(ARM, indent=4))
    motors = read_calibration(file)
    assert motors["shoulder_pan"] == MotorCalibration(1, 0, -1365, 746, 3477)
    assert json.loads(calibration_text(motors)) == ARM
    assert calibration_text(motors).splitlines()[:3] == ["{", '    "shoulder_pan": {', '        "id": 1,']


def edit(motor="shoulder_pan", **changes):
    return json.dumps(ARM | {motor: {k: v for k, v in (ARM.get(motor, {}) | changes).items() if v != "gone"}})


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", ", line 1: is not JSON"),
        ("[" * 100_000, "is nested too deeply|is not JSON"),
        ("\udcff", "is not JSON"),
        ("[]", "holds no motors"),
        ("{}", "holds no motors"),
        ('{"a": 1}', "motor 'a' is no object; write id, drive_mode"),
        ('{"a": {}, "a": {}}', "'a' stands there twice"),
        (edit(id="gone"), "motor 'shoulder_pan': id is missing or no whole number"),
        (edit(homing_offset=1.5), "homing_offset is missing or no whole number"),
        (edit(drive_mode=True), "drive_mode is missing or no whole number"),
        (edit(range_max=10**30), "range_max is missing or no whole number"),
        (edit(color=1), "'color' is not known"),
        (edit(id=2), "id 2 is used twice"),
        (edit(range_min=3477), "range_min 3477 is not below range_max 3477"),
    ],
)
def test_mistakes_are_one_sentence(tmp_path, text, expected):
    file = tmp_path / "arm.json"
    file.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match=expected) as caught:
        read_calibration(file)
    assert str(caught.value).startswith(str(file))
    assert ";" in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_calibration(tmp_path / "arm.json")
