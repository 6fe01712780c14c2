"""Rig files: what ships loads, and every mistake is one sentence with file, place and remedy."""

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.errors import InputError
from controller.rig import Bus, Safety, Sensor
from controller.rig_file import load_rig, parse_rig, rig_names
from controller.rig_joints import JOINT_KEYS

LAMP = load_rig("lamp-xc330")


@pytest.fixture
def broken(tmp_path):
    """Return a function that writes the lamp's rig file with a change, and gives the sentence of its error."""
    (tmp_path / LAMP.body.name).write_text("<mujoco/>")

    def sentence(old, new, count=1):
        assert old in LAMP.text
        return error_of(tmp_path, LAMP.text.replace(old, new, count))

    return sentence


def error_of(folder, text):
    path = folder / "mine.rig.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        load_rig(path)
    message = str(caught.value)
    assert message.startswith(str(path)), message
    assert "\n" not in message
    return message.removeprefix(str(path))


@pytest.mark.parametrize("name", rig_names())
def test_a_shipped_rig_loads_and_holds_what_its_file_says(name):
    rig = load_rig(name)
    file = tomllib.loads(rig.text)
    assert rig.name == name
    assert rig.path.name == f"{name}.rig.toml"
    assert load_rig(rig.path) == rig
    assert load_rig(str(rig.path)) == rig
    assert parse_rig(rig.text, rig.path) == rig
    for joint, table in zip(rig.joints, file["joint"], strict=True):
        gains = {} if joint.ideal else joint.family.gains[joint.mode]
        for key, value in table.items():
            if key in gains:
                assert {joint.gains[name] for name in gains[key]} == {value}
            elif key != "product":
                assert getattr(joint, "ceiling" if key in ("pwm_limit", "torque_limit") else key) == value
        assert joint.product.name == table["product"]
    for sensor, table in zip(rig.sensors, file["sensor"], strict=True):
        assert {key: getattr(sensor, key) for key in table} == table
    for key, value in file.get("safety", {}).items():
        assert getattr(rig.safety, key) == value
    assert rig.nraw == 3 * len(rig.joints) + len(rig.sensors)


def test_the_lamps_are_shipped():
    assert {"lamp-xc330", "lamp-xl330"} <= set(rig_names())


MISTAKES = [
    ("id = 2", "id = 1", "joint 2 (a1): id 1 is used twice; give each servo its own id"),
    ("low_rad = -1.147\n", "", "joint 2 (a1): low_rad is missing; add"),
    ("high_rad = 1.06\n", "", "joint 1 (a0): high_rad is missing; add"),
    ("low_rad = -1.06", "low_rad = 2.0", "joint 1 (a0): low_rad 2 is not below high_rad 1.06"),
    ("neutral_rad = 0.0", "neutral_rad = 3.0", "joint 1 (a0): neutral_rad 3 is outside -1.06 to 1.06"),
    ('xc330-m181"', 'xc330-m811"', "product 'xc330-m811' is not known; did you mean 'xc330-m181'?"),
    ("sign = -1", "sign = 0", "joint 3 (a2): sign 0 is neither 1 nor -1"),
    ("zero_tick = 2048", "zero_tick = 4096", "zero_tick 4096 is out of range; write a whole number from 0 to 4095"),
    ("zero_tick = 2048", "zero_tick = 100", "low_rad -1.06 is encoder tick -591, across the wrap"),
    (
        "baud = 1000000",
        "baud = 500000",
        "[bus]: baud 500000 is not offered by dynamixel-2.0 servos; choose one of 9600",
    ),
    ("period_s = 0.02", "period_s = 0", "[rig]: period_s 0 is not allowed; write a number above 0"),
    ("period_s = 0.02", "period_s = nan", "[rig]: period_s is not finite"),
    ("period_s = 0.02", f"period_s = 1{'0' * 400}", "[rig]: period_s is not finite"),
    ("period_s = 0.02", "period_s = true", "period_s is true or false; write a number"),
    ("pwm_limit = 885", "pwm_limt = 885", "joint 1 (a0): 'pwm_limt' is not known; did you mean 'pwm_limit'?"),
    ("pwm_limit = 885", "pwm_limit = 886", "pwm_limit 886 is out of range; write a whole number from 1 to 885"),
    ("p_gain = 1450", "p_gain = 1450.5", "p_gain is the number 1450.5; write a whole number"),
    ("[[joint]]", "[[joints]]", "top level: 'joints' is not known; did you mean 'joint'?"),
    ("format = 1", "format = 2", "format 2 is not known; this version reads `format = 1`"),
    ("format = 1", "", "format is missing; add `format = 1`"),
    ("id = 1\n", 'id = "1"\n', "id is the text '1'; write a whole number from 0 to 252"),
    ("id = 1\n", "id = 253\n", "id 253 is out of range"),
    ("[safety]", "[safe]", "'safe' is not known; did you mean 'safety'?"),
    ("[bus]", "[[bus]]", "'bus' is a list; write a table [bus]"),
    ('name = "a1"', 'name = "a0"', "joint 2 (a0): name a0 is used twice"),
    ('name = "a1"', 'name = "px"', "joint 2 (px): name 'px' is the name of another terminal"),
    ('name = "a1"', 'name = "sin"', "joint 2 (sin): name 'sin' is an operation of programs"),
    ("baud = 1000000", "baud = 9600", "[rig]: period_s 0.02 is too short for its traffic of 113.5 ms at 9600 bit/s"),
    ('name = "a1"', 'name = "a 1"', "name 'a 1' can not be a name"),
    ('mjcf_joint = "a1"', 'mjcf_joint = "a0"', "mjcf_joint a0 is used twice"),
    ('body = "lamp.xml"', 'body = "lmp.xml"', "body 'lmp.xml' is not a file beside the rig file"),
    ("supply_v = 5.0", "supply_v = 12.0", "supply_v 12 is outside 3.5 to 7 V of xc330-m181"),
    ("return_delay_us = 0", "return_delay_us = 3", "return_delay_us 3 is odd"),
    ("watchdog_s = 0.1", "watchdog_s = 0.11", "watchdog_s 0.11 is no multiple of 0.02 s"),
    ("watchdog_s = 0.1", "watchdog_s = 0.02", "watchdog_s 0.02 is not above the period"),
    ("voltage_low_v = 4.2", "voltage_low_v = 5.5", "voltage_low_v 5.5 is not below supply_v 5"),
    ("temperature_c_max = 65.0", "temperature_c_max = 90", "temperature_c_max 90 is above the servos' own shutdown"),
    ('stop = "off"', 'stop = "of"', "stop 'of' is not known; did you mean 'off'?"),
    ("field = 1", "field = 0", "sensor 2 (y): message and field P 0 is used twice"),
    ("scale = 0.0001", "scale = 0.0", "sensor 1 (x): scale 0 is 0 or infinite as a float32"),
    ("scale = 0.0001", "scale = -1e-46", "sensor 1 (x): scale -1e-46 is 0 or infinite as a float32"),
    ("scale = 0.0001", "scale = 1e39", "sensor 1 (x): scale 1e+39 is 0 or infinite as a float32"),
    ("zero = 0", "zero = -1073741824", "zero -1073741824 is out of range; write a whole number from -1073741823"),
    ("rate_hz = 100.0", "rate_hz = 50.0", "sensor 2 (y): rate_hz 100 differs within message P"),
    ("age_s_max = 0.06", "age_s_max = 0.001", "age_s_max 0.001 is shorter than one line's interval"),
    ('unit = "m"', 'unit = "N"', "unit 'N' does not fit a sensor named x"),
    ('terminal = "s0"', 'terminal = "a0"', "terminal 'a0' is the name of another terminal"),
    ('message = "F"', 'message = "force"', "message 'force' is not one capital letter"),
]


@pytest.mark.parametrize(("old", "new", "expected"), MISTAKES, ids=[new or f"no {old}" for old, new, _ in MISTAKES])
def test_a_mistake_is_one_sentence(broken, old, new, expected):
    assert expected in broken(old, new, LAMP.text.count(old) if old.startswith("[[") else 1)


FAMILY_MISTAKES = [
    (
        "ax12",
        "punch = 32",
        "p_gain = 32",
        "p_gain is no setting of servos of dynamixel-ax; write compliance_margin, comp",
    ),
    ("ax12", "punch = 32", "punch = 1024", "punch 1024 is out of range; write a whole number from 0 to 1023"),
    ("ax12", "sign = 1", 'sign = 1\nmode = "velocity"', "mode 'velocity' is not for servos of dynamixel-ax; remove it"),
    (
        "ax12",
        "zero_tick = 512",
        "zero_tick = 1024",
        "zero_tick 1024 is out of range; write a whole number from 0 to 1023",
    ),
    ("ax12", "zero_tick = 512", "zero_tick = 200", "low_rad -1.06 is encoder tick -7, across the wrap at 0 and 1024"),
    (
        "ax12",
        "baud = 1000000",
        "baud = 4500000",
        "baud 4500000 is not offered by dynamixel-1.0 servos; choose one of 9600",
    ),
    (
        "ax12",
        "watchdog_s = 0.0",
        "watchdog_s = 0.1",
        "watchdog_s 0.1 asks for what ax-12a servos do not have; write 0.0",
    ),
    ("ax12", "baud = 1000000", "baud = 19200", "period_s 0.02 is too short for its traffic of 40.1 ms at 19200 bit/s"),
    ("sts3215", '"sts3215"', '"scs0009"', "product 'scs0009' does not speak feetech-sts; choose another product"),
    ("sts3215", "torque_limit = 1000", "torque_limit = 1001", "torque_limit 1001 is out of range"),
    ("sts3215", "torque_limit = 1000", "pwm_limit = 885", "pwm_limit is no setting of servos of feetech-sts"),
    ("sts3215", "p_gain = 50", "p_gain = 255", "p_gain 255 is out of range; write a whole number from 1 to 254"),
    ("sts3215", "supply_v = 12.0", "supply_v = 14.5", "supply_v 14.5 is outside 4 to 14 V of sts3215"),
    (
        "sts3215",
        "temperature_c_max = 65.0",
        "temperature_c_max = 71",
        "is above the servos' own shutdown; write at most 70",
    ),
    ("sts3215", "period_s = 0.02", "period_s = 0.0006", "period_s 0.0006 is too short for its traffic of 0.6 ms"),
    ("xl430", '"xl430-w250"', '"xc330-m181"', "supply_v 11.1 is outside 3.5 to 7 V of xc330-m181"),
    (
        "xl430",
        "pwm_limit = 885",
        "punch = 885",
        "punch is no setting of servos of dynamixel-x430; write p_gain, i_gain",
    ),
]


@pytest.mark.parametrize(("lamp", "old", "new", "expected"), FAMILY_MISTAKES, ids=[row[3] for row in FAMILY_MISTAKES])
def test_a_mistake_about_a_family_is_one_sentence(tmp_path, lamp, old, new, expected):
    rig = load_rig(f"lamp-{lamp}")
    (tmp_path / rig.body.name).write_text("<mujoco/>")
    assert old in rig.text
    assert expected in error_of(tmp_path, rig.text.replace(old, new, 1))


def test_x_servos_mix_and_others_do_not():
    low = LAMP.text.replace("supply_v = 5.0", "supply_v = 6.0")
    mixed = low.replace('"xc330-m181"', '"xl430-w250"', 1)
    assert [joint.product.name for joint in parse_rig(mixed, LAMP.path).joints][:2] == ["xl430-w250", "xc330-m181"]
    fast = mixed.replace("baud = 1000000", "baud = 4500000")
    with pytest.raises(InputError, match="baud 4500000 is not offered by xc330-m181; choose one of 9600"):
        parse_rig(fast, LAMP.path)
    with pytest.raises(InputError, match=r"product 'ax-12a' does not speak dynamixel-2\.0"):
        parse_rig(low.replace('"xc330-m181"', '"ax-12a"', 1), LAMP.path)


def test_the_joints_of_a_bus_are_in_one_mode():
    speed = 'mode = "velocity"\nspeed_rad_s_max = 9.0\nvelocity_p_gain = 900\nvelocity_i_gain = 0\n'
    gains = "p_gain = 1450\ni_gain = 0\nd_gain = 0\n"
    all_of_them = parse_rig(LAMP.text.replace(gains, speed), LAMP.path)
    assert [dict(joint.gains) for joint in all_of_them.joints] == [{"velocity_p_gain": 900, "velocity_i_gain": 0}] * 3
    with pytest.raises(InputError, match=r"joint 2 \(a1\): mode 'position' is not joint a0's; give all joints"):
        parse_rig(LAMP.text.replace(gains, speed, 1), LAMP.path)


def test_an_sts_may_be_driven_by_velocity_and_an_ax_writes_both_sides():
    sts = load_rig("lamp-sts3215")
    speed = 'mode = "velocity"\nspeed_rad_s_max = 4.0\nvelocity_p_gain = 10\nvelocity_i_gain = 0\n'
    joint = parse_rig(sts.text.replace("p_gain = 50\ni_gain = 0\nd_gain = 0\n", speed), sts.path).joints[0]
    assert (dict(joint.gains), joint.ceiling) == ({"velocity_p": 10, "velocity_i": 0}, 1000)
    assert dict(load_rig("lamp-ax12").joints[1].gains) == {
        **{
            f"{side}_compliance_{what}": count
            for side in ("cw", "ccw")
            for what, count in (("margin", 0), ("slope", 16))
        },
        "punch": 32,
    }


def test_a_mistake_names_its_line(broken):
    line = 1 + LAMP.text[: LAMP.text.index("sign = -1")].count("\n")
    assert broken("sign = -1", "sign = 7").startswith(f", line {line}: joint 3 (a2): ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "format is missing"),
        ("format = 1\n[rig", ", line 2: the file ends in the middle of an entry"),
        ('format = 1\n[rig]\nname = "', ", line 3: the file ends in the middle of an entry"),
        ('format = 1\n[rig]\nname = """never', "the file ends in the middle of an entry"),
        ("format = 1\nformat = 1\n", "is not valid TOML"),
        ("format = 1\n", "table [rig] is missing; add it (is the file truncated?)"),
        (b"format = 1\n# l\xffmp\n", ", line 2: is not UTF-8 text"),
        ("x = " + "[" * 5000, "is nested too deeply"),
        ("#" * ((1 << 20) + 1), "is larger than"),
    ],
    ids=["empty", "header", "string", "text", "twice", "truncated", "latin-1", "deep", "large"],
)
def test_a_file_that_is_no_rig_is_one_sentence(tmp_path, text, expected):
    assert expected in error_of(tmp_path, text)


def test_what_is_no_file_is_one_sentence(tmp_path):
    for name, expected in {
        tmp_path: "is a folder; name the rig file itself",
        tmp_path / "none.rig.toml": "there is no such file",
        str(tmp_path / "no" / "such.toml"): "there is no such file",
        "lamp-xc30": "there is no rig 'lamp-xc30'; did you mean 'lamp-xc330'?",
        "": "there is no rig ''; known: ",
        "\0.toml": "can not be read",
    }.items():
        with pytest.raises(InputError) as caught:
            load_rig(name)
        assert expected in str(caught.value)


@settings(max_examples=150, derandomize=True, deadline=None)
@given(
    cut=st.integers(0, len(LAMP.text)),
    length=st.integers(0, 40),
    insert=st.text(max_size=12) | st.sampled_from(["[[joint]]\n", "nan", "-", "1e999", '"', "[", "= 1\n"]),
)
def test_a_damaged_file_loads_or_is_one_sentence(cut, length, insert):
    text = LAMP.text[:cut] + insert + LAMP.text[cut + length :]
    try:
        rig = parse_rig(text, LAMP.path)
    except InputError as error:
        assert str(error).startswith(str(LAMP.path))
    else:
        assert len({joint.id for joint in rig.joints}) == len(rig.joints)
        assert all(joint.low_rad <= joint.neutral_rad <= joint.high_rad for joint in rig.joints)


def test_a_log_can_rebuild_its_rig(tmp_path):
    body = Path(LAMP.body)
    (tmp_path / body.name).write_bytes(body.read_bytes())
    rig = parse_rig(LAMP.text, tmp_path / "gone.rig.toml")
    assert rig.joints == LAMP.joints
    assert rig.body == tmp_path / body.name


def test_the_page_lists_every_key():
    page = (Path(__file__).parent.parent / "docs" / "rigs.md").read_text()
    table = page.partition("## `rig.toml`")[2].partition("Everything is checked")[0]
    keys = {
        key for row in table.splitlines() if row.count("|") > 3 for key in re.findall(r"`(\w+)`", row.split("|")[2])
    }
    expected = {field.name for kind in (Bus, Safety, Sensor) for field in fields(kind)}
    assert keys == expected | set(JOINT_KEYS) | {"format", "name", "body", "period_s", "supply_v", "facing"}
