"""The log: the same run gives the same bytes, any end leaves it readable, and replay finds every changed bit."""

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lamp_controllers import OUTPUTS
from mcap.reader import make_reader

from controller.errors import InputError
from deploy.logs.log import RunLog, read_log
from deploy.logs.log_topics import TOPICS
from deploy.logs.replay import replay
from servolve.cli import main

CONTROLLER = """
program = '''(list (+ (* 9 (osc-wave 0.7 0)) (* 0.3 (smooth s0 0.2)))
                 (* 30 (sin (* 3 t)))
                 (* -8 (differentiate (+ a0 px))))'''
[controller]
name = "sway"
period_s = 0.02
filter = 0.5
slew_rad_s = 2.0
""" + "".join(
    f'[[input]]\nname = "{name}"\nunit = "{unit}"\nlow = -10\nhigh = 20\n'
    for name, unit in (("t", "s"), ("a0", "rad"), ("px", "m"), ("s0", "N"))
)
CONTROLLER += OUTPUTS


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a function that deploys on the virtual rig and gives the log."""
    folder = tmp_path_factory.mktemp("logs")
    (folder / "sway.controller.toml").write_text(CONTROLLER)

    def deploy(name, *arguments):
        path = folder / f"{name}.mcap"
        argv = ["deploy", str(folder / "sway.controller.toml"), "--rig", "lamp-xc330", "--seconds", "1.6", "--json"]
        assert main([*argv, "--goal", "0.3", "--log", str(path), *arguments]) == 0
        return path

    return deploy


@pytest.fixture(scope="module")
def log(recorded):
    return recorded("plain", "--fault", "drop=0.02", "--fault", "corrupt=0.02", "--seed", "3")


def rewrite(log, path, change):
    """Write a log's messages again, with what `change` makes of them."""
    with RunLog(path) as copy:
        for topic, messages in read_log(log).messages.items():
            for number, message in enumerate(messages):
                changed = change(topic, number, json.loads(json.dumps(message)))
                if changed is not None:
                    copy.write(topic, changed.pop("t"), changed)
    return path


# the same run, the same bytes


@pytest.mark.parametrize("faults", [(), ("--fault", "drop=0.02", "--fault", "corrupt=0.02", "--seed", "3")])
def test_the_same_run_gives_the_same_bytes(recorded, faults):
    first, second = recorded("first", *faults), recorded("second", *faults)
    a, b = read_log(first), read_log(second)
    for topic in a.messages:
        assert a.messages[topic] == b.messages[topic], topic
    assert first.read_bytes() == second.read_bytes()


def test_another_seed_gives_another_run(recorded, log):
    other = recorded("other", "--fault", "drop=0.02", "--fault", "corrupt=0.02", "--seed", "4")
    assert read_log(other).messages["/bus"] != read_log(log).messages["/bus"]


# what is in it


def test_every_message_keeps_its_schema(log):
    names = {"number": (int, float), "integer": int, "string": str, "object": dict, "array": list, "null": type(None)}
    messages = read_log(log).messages
    assert messages.keys() == {"/meta", "/cycle", "/event", "/health", "/bus", "/truth"}
    for topic, all_of in messages.items():
        schema = json.loads(TOPICS[topic].json_schema())
        for message in all_of:
            assert set(schema["required"]) <= message.keys()
            assert message.keys() - {"t"} <= schema["properties"].keys()
            for name, value in message.items():
                kinds = schema["properties"].get(name, {"type": "number"})["type"]
                kinds = [kinds] if isinstance(kinds, str) else kinds
                assert any(isinstance(value, names[kind]) for kind in kinds), (topic, name, value)


def test_other_programs_can_read_it(log):
    with log.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == set(TOPICS)
        assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
        counted = sum(1 for _ in reader.iter_messages())
        assert (
            counted
            == summary.statistics.message_count
            == sum(len(all_of) for all_of in read_log(log).messages.values())
        )


def test_bits_and_numbers_agree(log):
    for cycle in read_log(log).cycles:
        for numbers, bits in (("terminals", "terminal_bits"), ("outputs", "output_bits")):
            words = cycle[bits].split(" ")
            assert len(words) == len(cycle[numbers])
            for word, value in zip(words, cycle[numbers].values(), strict=True):
                assert word == f"{int.from_bytes(float_bytes(value)):08x}"


def float_bytes(value):
    import struct

    return struct.pack(">f", value)


def test_px_and_force_came_over_the_wire(log):
    # from the sensor lines alone: what the cycle was given is what the node's counts say
    for cycle in read_log(log).cycles:
        assert cycle["terminals"]["s0"] == pytest.approx(cycle["raw"]["force"] * 1e-3, abs=1e-6)
        assert cycle["terminals"]["px"] == pytest.approx(0.3 - cycle["raw"]["x"] * 1e-4, abs=2e-3)
        assert 0.0 < cycle["age_s"]["force"] < 0.03


# any end leaves it readable


@given(part=st.floats(0, 1))
@settings(max_examples=60)
def test_a_log_cut_anywhere_is_read_as_far_as_it_goes(log, part):
    whole, data, cut = read_log(log), log.read_bytes(), log.with_name("cut.mcap")
    cut.write_bytes(data[: int(part * len(data))])
    try:
        found = read_log(cut)
    except InputError as error:
        assert str(cut) in str(error) and "\n" not in str(error)
        return
    for topic, messages in found.messages.items():
        assert messages == whole.messages[topic][: len(messages)]


@given(at=st.floats(0, 0.999), bit=st.integers(0, 7))
@settings(max_examples=60)
def test_a_damaged_log_is_never_another_log(log, at, bit):
    data, damaged = bytearray(log.read_bytes()), log.with_name("damaged.mcap")
    data[int(at * len(data))] ^= 1 << bit
    damaged.write_bytes(data)
    try:
        found = read_log(damaged)
    except InputError as error:
        assert str(damaged) in str(error) and "\n" not in str(error)
        return
    for topic, messages in found.messages.items():
        assert messages == read_log(log).messages[topic][: len(messages)]


def test_a_killed_process_loses_a_second_at_most(tmp_path):
    log = RunLog(tmp_path / "killed.mcap")
    log.write("/meta", 0.0, {"format": 1})
    for number in range(1000):
        log.write("/event", 0.01 * number, {"kind": "warning", "text": str(number)})
    found = read_log(log.path)  # never closed
    assert not found.complete
    assert len(found.events) >= 900
    log.close()
    assert read_log(log.path).complete


@pytest.mark.parametrize("content", [b"", b"no log", b"\x89MCAP0\r\n", bytes(4096)])
def test_what_is_no_log_is_one_sentence(tmp_path, content):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_log(path)
    assert str(path) in str(error.value)
    assert main(["replay", str(path)]) == 2


@pytest.mark.parametrize("path", ["/nowhere/x.mcap", "/"])
def test_a_log_that_can_not_be_read_or_written_is_one_sentence(path):
    with pytest.raises(InputError, match="cannot be read"):
        read_log(path)
    with pytest.raises(InputError, match="cannot be written"):
        RunLog(path)


def test_only_a_log_is_overwritten(tmp_path):
    recording = tmp_path / "console.bin"
    recording.write_bytes(b"\0\x03of a run\0")
    with pytest.raises(InputError, match="is no log, so it is not overwritten"):
        RunLog(recording)
    assert recording.read_bytes() == b"\0\x03of a run\0"
    for _ in range(2):
        RunLog(tmp_path / "x.mcap").close()
    (tmp_path / "empty").touch()
    RunLog(tmp_path / "empty").close()
    assert (tmp_path / "empty").read_bytes() == (tmp_path / "x.mcap").read_bytes()


# replay


def test_replay_is_bitwise(log, capsys):
    found = replay(log)
    assert (found.difference, found.cycles) == (None, 80)
    assert main(["replay", str(log)]) == 0
    assert "80 periods of sway are the same, bit for bit" in capsys.readouterr().out


def test_replay_needs_nothing_but_the_log(log, tmp_path):
    alone = tmp_path / "elsewhere" / "moved.mcap"
    alone.parent.mkdir()
    alone.write_bytes(log.read_bytes())
    assert replay(alone).difference is None


def nudge(field, name):
    def change(topic, number, message):
        if topic == "/cycle" and number == 40:
            if name is None:
                digit = f"{int(message[field][-1], 16) ^ 1:x}"
                message[field] = message[field][:-1] + digit
            elif field in ("raw", "goal_counts"):
                message[field][name] += 1
            else:
                message[field][name] = math.nextafter(message[field][name], 100.0)
        return message

    return change


@pytest.mark.parametrize(
    ("field", "name", "place"),
    [
        ("raw", "a0", "/cycle 40: terminals of a0"),
        ("raw", "force", "/cycle 40: terminals of s0"),
        ("goal_counts", "a1", "/cycle 40: goal_counts of a1"),
        ("terminals", "px", "/cycle 40: terminals of px"),
        ("outputs", "a2", "/cycle 40: outputs of a2"),
        ("terminal_bits", None, "/cycle 40: terminal_bits"),
        ("output_bits", None, "/cycle 40: output_bits"),
    ],
)
def test_replay_finds_one_changed_bit(log, tmp_path, capsys, field, name, place):
    changed = rewrite(log, tmp_path / "changed.mcap", nudge(field, name))
    assert replay(changed).difference.startswith(place)
    assert main(["replay", str(changed)]) == 1
    assert place in capsys.readouterr().err


def test_replay_finds_a_missing_period(log, tmp_path):
    changed = rewrite(log, tmp_path / "x.mcap", lambda topic, n, m: None if (topic, n) == ("/cycle", 40) else m)
    assert replay(changed).difference == "/cycle 40: k is 41, a period is missing before it"


def test_replay_finds_another_controller(log, tmp_path):
    def change(topic, number, message):
        if topic == "/meta":
            message["controller_text"] = message["controller_text"].replace("0.2)", "0.21)")
        return message

    assert "/cycle 0: outputs of a0" in replay(rewrite(log, tmp_path / "x.mcap", change)).difference


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda topic, n, m: None if topic == "/cycle" else m, "holds no control period"),
        (lambda topic, n, m: {**m, "rig_text": "x = 1"} if topic == "/meta" else m, "rig.toml"),
        (lambda topic, n, m: {**m, "controller_text": ""} if topic == "/meta" else m, "has no controller_text"),
        (lambda topic, n, m: {**m, "format": 2} if topic == "/meta" else m, "no /meta of format 1"),
        (lambda topic, n, m: {**m, "raw": {}} if topic == "/cycle" else m, "lacks what docs/log.md promises"),
    ],
)
def test_a_log_that_can_not_be_replayed_is_one_sentence(log, tmp_path, capsys, change, sentence):
    changed = rewrite(log, tmp_path / "x.mcap", change)
    assert main(["replay", str(changed)]) in (1, 2)
    told = capsys.readouterr().err
    assert sentence in told and told.count("\n") == 1


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("goal_dist", "x"),
        ("goal_dist", None),
        ("rig", "../../../etc/passwd"),
        ("rig", ""),
        ("rig", None),
        ("rig_text", "x="),
        ("controller_text", "x="),
    ],
)
def test_a_description_that_was_changed_is_one_sentence(log, capsys, field, value):
    changed = rewrite(
        log,
        log.with_name("meta.mcap"),
        lambda topic, _, message: message | ({field: value} if topic == "/meta" else {}),
    )
    for command in ("replay", "compare") if field != "controller_text" else ("replay",):
        assert main([command, str(changed)]) == 2
        told = capsys.readouterr()
        assert told.err.count("\n") == 1 and "Traceback" not in told.err and "meta.mcap" in told.err
