"""The firmware's command line, on a robot whose runs never come: only words go in, only wishes and words come out."""

import ctypes
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rig_bench import RIG, sway
from robot_library import build_robot, compile_runtime


class Wish(ctypes.Structure):
    """Mirror `sv_wish` of sv_robot.h."""

    _fields_ = (
        ("goal_dist", ctypes.c_float),
        ("goal_bearing", ctypes.c_float),
        ("periods", ctypes.c_int32),
        ("derate", ctypes.c_float),
        ("arm", ctypes.c_uint8),
        ("start", ctypes.c_uint8),
        ("stop", ctypes.c_uint8),
    )


class Console:
    """A robot that has booted, at whose console a test types."""

    def __init__(self, library):
        self.library = library
        library.type.restype = ctypes.POINTER(Wish)
        library.answer.restype = ctypes.c_char_p
        self.boot()

    def boot(self):
        self.library.press(0)
        self.library.boot(0, 0, 0)

    def type(self, words):
        wish = self.library.type(words, len(words)).contents
        self.answer = self.library.answer()
        return wish

    def number(self, text):
        value = ctypes.c_float()
        return value.value if self.library.decimal(text.encode(), ctypes.byref(value)) else None


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    runtime = compile_runtime(tmp_path_factory.mktemp("runtime"))
    return Console(build_robot(tmp_path_factory.mktemp("console"), runtime, RIG, sway()))


@pytest.fixture
def console(built):
    built.boot()
    return built


def test_commands_set_what_a_run_is_asked_to_do(console):
    wish = console.type(b"goal 0.35 -1.5\nseconds 7.5\r\nderate 0.25\narm\n")
    assert console.answer == b"ok\r\n" * 4
    assert (wish.goal_dist, wish.goal_bearing, wish.periods) == (np.float32(0.35), -1.5, 375)
    assert (wish.derate, wish.arm, wish.start) == (0.25, 1, 0)
    wish = console.type(b"goal -2\ndisarm\nstart\n")
    assert (wish.goal_dist, wish.goal_bearing, wish.arm, wish.start) == (-2.0, 0.0, 0, 1)


def test_while_a_run_goes_on_only_stop_and_status_are_heard(console):
    console.type(b"start\n")
    wish = console.type(b"goal 3\narm\nstart\nseconds 1\n")
    assert console.answer == b"busy: stop, or wait\r\n" * 4
    assert (wish.goal_dist, wish.arm, wish.stop) == (0.0, 0, 0)
    assert console.type(b"status\nstop\n").stop == 16
    assert console.answer.startswith(b"off disarmed, ended by 0")


@pytest.mark.parametrize(
    "words",
    [
        *(
            b"goal",
            b"goal x",
            b"goal 1 2 3",
            b"goal 1e3",
            b"goal 1001",
            b"goal nan",
            b"goal 1.",
            b"goal .",
            b"goal --1",
        ),
        *(b"goal 0.1234567890", b"goal 1234567891", b"seconds -1", b"seconds 4000", b"seconds 0.0000001", b"derate 0"),
        *(b"derate 1.1", b"derate -0.5", b"armed", b"go", b"x" * 39, b"start" * 20, b"arm" + b" " * 40, b"\xff\0arm"),
        *(b"arm\0", b"arm now", b"start 5", b"arm\t", b"\xc3\xa4rm"),
    ],
)
def test_what_is_no_command_changes_nothing(console, words):
    before = bytes(console.type(b""))
    assert bytes(console.type(words + b"\n")) == before
    assert console.answer == b"what? try help\r\n"


STOP, START = 1, 2


def hold(console, *phases):
    """Let the inputs be as each phase says (active, for so many milliseconds); return the wish."""
    for active, ms in phases:
        console.library.press(active)
        for _ in range(ms):
            wish = console.type(b"")
            console.library["pass"](1000)
    return wish


@pytest.mark.parametrize(
    ("phases", "starts"),
    [
        (((START, 200),), 0),  # held from the boot on
        (((START, 100), (0, 25), (START, 200)), 0),  # never open for long
        (((0, 100), (START, 25), (0, 100)), 0),  # too short
        (((0, 100), (START, 32)), 1),
        (((START, 100), (0, 32), (START, 32)), 1),
        (((0, 100), *((START, 3), (0, 3)) * 20), 0),  # noise
        (((0, 100), *((START, 3), (0, 3)) * 5, (START, 32)), 1),  # a bouncing press
        (((START, 100), *((0, 3), (START, 3)) * 20, (0, 100)), 0),  # a bouncing release
    ],
)
def test_the_start_input_arms_and_starts_when_it_was_open_and_is_closed_without_bouncing(console, phases, starts):
    console.library.press(phases[0][0])
    console.library.boot(0, 0, 0)
    wish = hold(console, *phases)
    assert (wish.arm, wish.start, wish.stop) == (starts, starts, 0)


def test_a_button_that_is_held_through_a_run_and_bounces_when_let_go_starts_no_other(console):
    assert hold(console, (0, 100), (START, 40)).start == 1
    console.library.run()  # nobody answers
    wish = hold(console, (START, 100), *((0, 3), (START, 3)) * 10, (0, 100))
    assert (wish.arm, wish.start) == (0, 0)
    assert hold(console, (START, 40)).start == 1


def test_the_stop_input_is_taken_at_once(console):
    assert hold(console, (STOP, 1)).stop == 17


@given(digits=st.text("0123456789", min_size=1, max_size=9), point=st.integers(0, 9), minus=st.booleans())
@example("16777217", 8, False)
@example("8388609", 1, True)
def test_decimals_are_rounded_once(built, digits, point, minus):
    point = min(point, len(digits) - 1)
    text = "-" * minus + digits[: len(digits) - point] + "." * (point > 0) + digits[len(digits) - point :]
    value = built.number(text)
    exact = Fraction(Decimal(text))
    near = np.float32(float(exact))
    candidates = [near, np.nextafter(near, np.float32(np.inf)), np.nextafter(near, np.float32(-np.inf))]
    distance = abs(Fraction(value) - exact)
    assert distance == min(abs(Fraction(float(other)) - exact) for other in candidates)
    ties = [other for other in candidates if abs(Fraction(float(other)) - exact) == distance]
    assert len(ties) == 1 or np.float32(value).view(np.uint32) % 2 == 0


@given(seconds=st.integers(0, 3_999_999_999))
def test_lengths_are_whole_periods_rounded_as_the_host_rounds(built, seconds):
    built.boot()
    text = f"{seconds // 10**6}.{seconds % 10**6:06d}".rstrip("0").rstrip(".")
    wish = built.type(f"seconds {text}\n".encode())
    expected = round(Fraction(seconds, 20_000))
    assert wish.periods == (expected if len(text.replace(".", "").lstrip("0")) <= 9 else 500)


@given(words=st.one_of(st.binary(max_size=300), st.text("goalsecndrtimup .0123456789-\r\n").map(str.encode)))
def test_no_bytes_do_harm(built, words):
    built.boot()
    wish = built.type(words)
    assert 0.0 < wish.derate <= 1.0
    assert 0 <= wish.periods <= 200_000
    assert abs(wish.goal_dist) <= 1000.0
    assert abs(wish.goal_bearing) <= 1000.0
    assert wish.stop in (0, 16)
