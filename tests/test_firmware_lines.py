"""The firmware's sensor lines: every byte is understood as the host understands it, and no sample looks younger."""

import ctypes
from dataclasses import replace

import pytest
import runtime_shim
from hypothesis import given, settings
from hypothesis import strategies as st
from runtime_shim import Runtime

from controller import load_rig
from deploy.buses.sensor_reader import SensorReader, checksum
from deploy.virtual.faults import parse_fault
from deploy.virtual.rig import VirtualRig

runtime = runtime_shim.runtime

RIG = load_rig("lamp-xc330")
NSENSOR = len(RIG.sensors)
FORCE = next(number for number, sensor in enumerate(RIG.sensors) if sensor.name == "force")
LATENCY_US = round(1e6 * RIG.sensors[FORCE].latency_s)
EIGHTH_US = 2**17


class Lines:
    """Hold the firmware's reader and the host's, fed alike.

    Args:
        library: the shared library
        sensors: the channels
    """

    def __init__(self, library, sensors=RIG.sensors):
        self.sensors = sensors
        self.host = SensorReader(sensors)
        self._firmware = Runtime(library)
        letters = sorted({sensor.message for sensor in sensors})
        for letter in letters:
            of_letter = [sensor for sensor in sensors if sensor.message == letter]
            width = 1 + max(sensor.field for sensor in of_letter)
            self._firmware.message(ctypes.c_char(letter.encode()), width, round(1e6 * of_letter[-1].latency_s))
        for sensor in sensors:
            self._firmware.sensor(letters.index(sensor.message), sensor.field)

    def feed(self, data, now_us):
        self.host.feed(data, 1e-6 * now_us)
        self._firmware.feed(data, len(data), ctypes.c_uint32(now_us))

    def raw(self, sensor):
        return self._firmware.raw(sensor) if self.age_us(sensor, 0) != -1 else None

    def age_us(self, sensor, now_us):
        return self._firmware.age_us(sensor, ctypes.c_uint32(now_us))

    def host_age_us(self, sensor, now_us):
        return 1e6 * self.host.age(sensor, 1e-6 * now_us)

    def assert_same_content(self):
        for sensor in range(len(self.sensors)):
            assert self.raw(sensor) == self.host.raw(sensor)
        assert bool(self._firmware.stopped()) == self.host.emergency_stop

    def assert_no_younger(self, now_us):
        for sensor in range(len(self.sensors)):
            age_us = self.age_us(sensor, now_us)
            if self.raw(sensor) is None:
                assert age_us == -1
            else:
                assert age_us >= self.host_age_us(sensor, now_us) - 1.5


def line(body):
    return b"$%s*%02X\r\n" % (body, checksum(body))


def force(seq, t_us, raw):
    return line(b"F,%d,%d,%d" % (seq, t_us, raw))


# what a line says

TEXT = st.lists(st.sampled_from(list(b"FFPPEZ,,,,,--0123456789 .a~*")), max_size=40).map(bytes)
NUMBERS = st.one_of(
    st.integers(0, 99),
    st.sampled_from([2**31 - 1, 2**31, -(2**31), -(2**31) - 1, 9_999_999_999, 10_000_000_000, 10**16 - 1, 10**16]),
)
BODIES = st.one_of(
    TEXT,
    st.builds(
        lambda letter, numbers: b",".join([letter, *(b"%d" % number for number in numbers)]),
        st.sampled_from([b"F", b"P", b"E", b"Q", b"f", b"FF"]),
        st.lists(NUMBERS, max_size=9),
    ),
)
PIECES = st.one_of(
    st.binary(max_size=30),
    st.lists(st.sampled_from(list(b"$FPE,*-0123456789AF\r\n")), max_size=40).map(bytes),
    BODIES.map(line),
    BODIES.map(lambda body: line(body).lower()),
    st.integers(190, 202).map(lambda size: line(b"F,1,2,3".ljust(size, b",") + b"1")),
    st.integers(180, 220).map(lambda size: line(b"E,".ljust(size, b"x"))),
    st.builds(force, st.integers(0, 20), st.integers(0, 10**6), st.integers(-(2**31), 2**31 - 1)),
)


@given(pieces=st.lists(PIECES, max_size=12), cut=st.integers(1, 50))
@settings(max_examples=400)
def test_any_bytes_say_what_they_say_to_the_host(runtime, pieces, cut):
    lines = Lines(runtime)
    data = b"".join(pieces)
    for number, start in enumerate(range(0, len(data), cut)):
        lines.feed(data[start : start + cut], 1000 * number)
        lines.assert_same_content()


@given(bodies=st.lists(BODIES, min_size=1, max_size=6))
@settings(max_examples=400)
def test_bodies_under_a_right_check_say_what_they_say_to_the_host(runtime, bodies):
    lines = Lines(runtime)
    for number, body in enumerate(bodies):
        lines.feed(line(body), 10_000 * number)
        lines.assert_same_content()


def test_the_rigs_own_frames_are_read(runtime):
    lines = Lines(runtime)
    lines.feed(b"$F,7,1000,-42*%02X\n" % checksum(b"F,7,1000,-42"), 6000)
    assert (lines.raw(FORCE), lines.age_us(FORCE, 6000)) == (-42, LATENCY_US)
    assert lines.age_us(FORCE, 9000) == LATENCY_US + 3000
    others = [number for number in range(NSENSOR) if RIG.sensors[number].message != "F"]
    assert [lines.raw(number) for number in others] == [None] * len(others)


def test_every_letter_has_its_own_lines(runtime):
    letters = "ABCDFGHIJKLMNOPQ"
    lines = Lines(runtime, [replace(RIG.sensors[FORCE], message=letter) for letter in letters])
    for letter in letters.encode():
        lines.feed(line(b"%c,1,%d,%d" % (letter, 2, letter)), 10 * letter)
        lines.assert_same_content()
    assert [lines.raw(number) for number in range(16)] == list(letters.encode())
    assert [lines.age_us(number, 10_000) for number in range(16)] == [
        10_000 - 10 * letter + LATENCY_US for letter in letters.encode()
    ]


# when its sample was taken

STEPS = st.lists(
    st.tuples(
        st.integers(0, 400_000),  # until the next line is read
        st.integers(-3000, 410_000),  # the node's clock meanwhile; < 0: it restarts
        st.integers(0, 3),
    ),
    min_size=1,
    max_size=40,
)


@given(steps=STEPS, start=st.sampled_from([0, 2**32 - 700_000, 10**10]))
@settings(max_examples=300)
def test_no_sample_looks_younger_than_to_the_host(runtime, steps, start):
    lines, now_us, node_us, seq = Lines(runtime), start, 10**6, 0
    for delay, ticked, skipped in steps:
        now_us, node_us, seq = now_us + delay, max(0, node_us + ticked), seq + 1 + skipped
        lines.feed(force(seq, node_us, seq) + line(b"P,%d,%d,1,2,3,4,5,6" % (seq, node_us // 2)), now_us)
        lines.assert_same_content()
        lines.assert_no_younger(now_us + 500)


@given(
    steps=st.lists(
        st.tuples(st.integers(EIGHTH_US + 1, 600_000), st.integers(-3000, 600_000)), min_size=1, max_size=40
    ),
    start=st.sampled_from([0, 2**32 - 700_000, 10**10]),
)
@settings(max_examples=300)
def test_lines_an_eighth_of_a_second_apart_are_dated_as_the_host_dates_them(runtime, steps, start):
    lines, now_us, node_us = Lines(runtime), start, 10**6
    for number, (delay, ticked) in enumerate(steps):
        now_us, node_us = now_us + delay, max(0, node_us + ticked)
        lines.feed(force(number, node_us, number), now_us)
        # a microsecond for each line: the growth that a drifting clock is allowed is rounded down
        assert lines.age_us(FORCE, now_us) == pytest.approx(lines.host_age_us(FORCE, now_us), abs=1.0 + number)


@pytest.mark.parametrize("drift", [-1e-2, -1e-4, 0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("late_us", [0, 9000])
def test_an_age_is_wrong_by_what_the_clocks_drift_apart_in_a_second_and_an_eighth(runtime, drift, late_us):
    lines, worst = Lines(runtime), 0.0
    for k in range(60 * 50):  # a line every 20 ms, one in ten of them read without delay
        late = 0 if k % 10 == 0 else late_us
        now_us = 20_000 * k + LATENCY_US + late
        lines.feed(force(k, round(7e8 + 20_000 * k * (1.0 + drift)), k), now_us)
        error = lines.age_us(FORCE, now_us) - (LATENCY_US + late)
        worst = max(worst, abs(error))
    assert worst <= 1.02e6 * abs(drift) + 1.32e5 * abs(drift) + 100.0


def test_a_line_after_an_hour_of_silence_is_fresh(runtime):
    lines = Lines(runtime)
    hour_us = 3_600_000_000
    lines.feed(force(1, 0, 1), LATENCY_US)
    lines.feed(force(2, hour_us - hour_us // 200, 2), hour_us + LATENCY_US)  # the node's clock is 0.5 % slow
    assert lines.age_us(FORCE, hour_us + LATENCY_US) == LATENCY_US


@pytest.mark.parametrize("node_us", [10**6, 2**31, 2**31 + 10**6, 2**32 - 10**6, 5 * 10**9, 10**10, 10**16 - 1])
@pytest.mark.parametrize("start_us", [0, 2**32 - 30_000])
def test_a_node_that_starts_anew_is_dated_anew(runtime, node_us, start_us):
    lines = Lines(runtime)
    lines.feed(force(1, node_us, 1), start_us)
    for number, boot_us in enumerate((0, 10_000, 20_000)):
        now_us = start_us + 50_000 + boot_us + LATENCY_US
        lines.feed(force(number, boot_us, number), now_us)
        assert (lines.raw(FORCE), lines.age_us(FORCE, now_us)) == (number, LATENCY_US)
        assert lines.host_age_us(FORCE, now_us) == pytest.approx(LATENCY_US, abs=1.0)


def test_a_silent_node_ages_for_half_an_hour_and_is_too_old_from_then_on(runtime):
    lines = Lines(runtime)
    lines.feed(force(1, 0, 5), LATENCY_US)
    assert [lines.age_us(FORCE, age_us) for age_us in (10**6, 2**31 - 1)] == [10**6, 2**31 - 1]
    assert all(lines.age_us(FORCE, age_us) < 0 for age_us in (2**31, 2**31 + 1, 2**32 - 1))
    assert lines.raw(FORCE) == 5


@pytest.mark.parametrize("faults", [(), ("sensor-drop=0.2",), ("sensor-corrupt=0.3",), ("sensor-babble@0.1",)])
def test_the_virtual_rigs_lines_are_dated_as_the_host_dates_them(runtime, faults):
    virtual = VirtualRig(RIG, faults=[parse_fault(fault) for fault in faults])
    lines = Lines(runtime)
    for k in range(150):
        now_us = 20_000 * k + (3700 if k % 11 == 5 else 0)  # sometimes a lost reply has taken time first
        virtual.advance(1e-6 * now_us)
        lines.feed(virtual.sensor_until(1e-6 * now_us), now_us)
        lines.assert_same_content()
        for sensor in range(NSENSOR):
            if lines.raw(sensor) is not None:
                assert lines.age_us(sensor, now_us) == pytest.approx(lines.host_age_us(sensor, now_us), abs=1.5)
