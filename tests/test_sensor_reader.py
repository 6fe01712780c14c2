"""The sensor node's lines: whatever arrives nothing raises, a good line after it is read, and values have their age."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller import load_rig
from deploy.buses.sensor_reader import LINE_BYTES_MAX, LineSplitter, SensorReader, checksum, parse_line

RIG = load_rig("lamp-xc330")
FORCE = next(number for number, sensor in enumerate(RIG.sensors) if sensor.name == "force")
X = next(number for number, sensor in enumerate(RIG.sensors) if sensor.name == "x")
LATENCY_S = RIG.sensors[FORCE].latency_s

# bytes that lines are made of, so that garbage comes close to being one
GARBAGE = st.one_of(
    st.binary(max_size=60),
    st.lists(st.sampled_from(list(b"$FPE,*-0123456789AF\r\n")), max_size=60).map(bytes),
)


def line(body):
    return b"$%s*%02X\r\n" % (body, checksum(body))


def force(seq, t_us, raw):
    return line(b"F,%d,%d,%d" % (seq, t_us, raw))


@given(before=GARBAGE, cut=st.integers(0, 40), raw=st.integers(-(2**31), 2**31 - 1))
def test_a_good_line_is_read_after_any_garbage(before, cut, raw):
    reader = SensorReader(RIG.sensors)
    whole = before + force(1, 1000, 5)[:cut] + force(2, 2000, raw)
    reader.feed(whole, 0.1)
    assert reader.raw(FORCE) == raw


@given(chunks=st.lists(GARBAGE, max_size=20))
def test_garbage_never_raises_and_never_piles_up(chunks):
    reader = SensorReader(RIG.sensors)
    splitter = LineSplitter()
    for number, chunk in enumerate(chunks):
        reader.feed(chunk, 0.01 * number)
        splitter.feed(chunk)
        assert len(splitter._open or b"") <= LINE_BYTES_MAX


@given(raw=st.integers(-(2**31), 2**31 - 1), at=st.integers(0, 200), bit=st.integers(0, 7))
def test_a_line_with_one_wrong_bit_is_never_another_value(raw, at, bit):
    reader = SensorReader(RIG.sensors)
    wrong = bytearray(force(7, 123456, raw))
    wrong[at % len(wrong)] ^= 1 << bit
    reader.feed(bytes(wrong), 0.1)
    assert reader.raw(FORCE) in (None, raw)


@given(cuts=st.lists(st.integers(1, 9), min_size=1, max_size=40))
def test_lines_may_arrive_in_any_pieces(cuts):
    data = b"".join(force(seq, 10_000 * seq, 3 * seq) for seq in range(1, 6))
    reader = SensorReader(RIG.sensors)
    at = 0
    for cut in [*cuts, len(data)]:
        reader.feed(data[at : at + cut], 1.0)
        at += cut
    assert reader.raw(FORCE) == 15


@pytest.mark.parametrize(
    "body",
    [
        b"F,1,2,3",
        b"F,1,2,-2147483648,2147483647",
        b"P,4294967295,9999999999999999,1,2,3,4,5,6",
        b"F,1,2",
    ],
)
def test_lines_in_the_documented_form_parse(body):
    parsed = parse_line(line(body)[1:-2])
    assert parsed is not None
    assert ",".join(map(str, (parsed.message, parsed.seq, parsed.t_us, *parsed.raw))).encode() == body


@pytest.mark.parametrize(
    "body",
    [b"", b"F", b"F,1", b"F,1,2,x", b"F,1,2,2147483648", b"F,1,2,1.5", b"F,-1,2,3", b"f,1,2,3", b"F,1,2,3,", b"F,,2,3"],
)
def test_other_lines_do_not(body):
    assert parse_line(line(body)[1:-2]) is None


def test_the_check_is_needed():
    assert parse_line(b"F,1,2,3*00") is None
    assert parse_line(b"F,1,2,3") is None
    assert parse_line(line(b"F,1,2,3")[1:-2].lower()) is None


def test_a_line_with_too_few_values_is_none_of_ours():
    reader = SensorReader(RIG.sensors)
    reader.feed(line(b"P,1,1000,1,2,3"), 0.1)
    assert reader.raw(X) is None
    assert math.isinf(reader.age(X, 0.1))


def test_a_value_is_as_old_as_its_sample():
    reader = SensorReader(RIG.sensors)
    for seq in range(100):
        sampled = 0.01 * seq
        arrives = sampled + LATENCY_S
        # read on time now and then, mostly late
        reader.feed(force(seq, round(1e6 * sampled), seq), arrives + (0.0 if seq % 10 == 0 else 0.008))
    assert reader.age(FORCE, 0.99 + LATENCY_S + 0.008) == pytest.approx(LATENCY_S + 0.008, abs=1e-4)


def test_the_nodes_clock_may_drift_and_start_anywhere():
    reader = SensorReader(RIG.sensors)
    for seq in range(20_000):
        sampled = 0.01 * seq
        reader.feed(force(seq, round(1e6 * (5000.0 + sampled * 0.9999)), seq), sampled + LATENCY_S)
    assert reader.age(FORCE, 199.99 + LATENCY_S) == pytest.approx(LATENCY_S, abs=2e-3)


@pytest.mark.parametrize("drift", [-1e-2, -5e-3, -1e-4, 0.0, 1e-4, 5e-3, 1e-2])
def test_ages_stay_true_whatever_the_nodes_clock(drift):
    reader = SensorReader(RIG.sensors)
    worst = 0.0
    for k in range(120 * 50):  # two minutes, a line every 10 ms, a look every 20 ms, one in ten of them without delay
        sampled = 0.02 * k
        late = 0.0 if k % 10 == 0 else 0.009
        reader.feed(force(k, round(1e6 * (700.0 + sampled * (1.0 + drift))), k), sampled + LATENCY_S + late)
        age = reader.age(FORCE, sampled + LATENCY_S + late)
        worst = max(worst, abs(age - (LATENCY_S + late)))
    assert worst <= abs(drift) * 1.02 + 2e-6


def test_an_age_does_not_creep_while_lines_are_read_late():
    reader = SensorReader(RIG.sensors)
    for seq in range(3000):  # once a second a line is read without delay
        late = 0.0 if seq % 100 == 0 else 0.008
        reader.feed(force(seq, 10_000 * seq, seq), 0.01 * seq + LATENCY_S + late)
        assert reader.age(FORCE, 0.01 * seq + LATENCY_S + late) == pytest.approx(LATENCY_S + late, abs=2e-4)


def test_lines_that_come_late_from_now_on_look_old_not_young():
    reader = SensorReader(RIG.sensors)
    for seq in range(1000):
        late = 0.0 if seq < 200 else 0.1
        reader.feed(force(seq, 10_000 * seq, seq), 0.01 * seq + LATENCY_S + late)
        since = max(0.0, 0.01 * (seq - 200) + late)
        assert reader.age(FORCE, 0.01 * seq + LATENCY_S + late) >= LATENCY_S + late - 0.0101 * since - 1e-6


def test_a_silent_node_ages():
    reader = SensorReader(RIG.sensors)
    reader.feed(force(1, 0, 5), LATENCY_S)
    assert reader.age(FORCE, 3.0) == pytest.approx(3.0)
    assert reader.raw(FORCE) == 5


def test_the_same_sample_again_is_not_fresh():
    reader = SensorReader(RIG.sensors)
    for number in range(100):
        reader.feed(force(number, 1000, 5), 0.01 * number)
    assert reader.age(FORCE, 1.0) > 0.9


def test_a_node_that_restarts_is_dated_anew():
    reader = SensorReader(RIG.sensors)
    reader.feed(force(900, 9_000_000, 1), 10.0)
    reader.feed(force(0, 1000, 2), 20.0)
    assert reader.raw(FORCE) == 2
    assert reader.age(FORCE, 20.0) == pytest.approx(LATENCY_S)


def test_lost_lines_are_counted():
    reader = SensorReader(RIG.sensors)
    for seq in (1, 2, 5, 6, 9):
        reader.feed(force(seq, 1000 * seq, 0), 0.01 * seq)
    assert reader.lost_lines == 4


@pytest.mark.parametrize("body", [b"E", b"E,1", b"E,1,2000", b"E,17,123456,button pressed"])
def test_an_emergency_stop_is_heard(body):
    reader = SensorReader(RIG.sensors)
    reader.feed(b"$E,1*00\r\n", 0.1)
    assert not reader.emergency_stop
    reader.feed(b"noise$F,1" + line(body), 0.2)
    assert reader.emergency_stop
