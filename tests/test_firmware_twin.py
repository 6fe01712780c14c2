"""The process of the native twin: it is ended by its number, and whatever it does is told in a sentence."""

import os
import signal
import stat

import pytest
from firmware_runs import XC330, image

from controller.errors import InputError, RunError
from deploy.firmware.machine import Given
from deploy.firmware.twin import TwinProcess

ANSWER = """
def answer():
    head = sys.stdin.buffer.read(12)
    if len(head) < 12:
        sys.exit(0)
    for _ in range(3):
        sys.stdin.buffer.read(int.from_bytes(sys.stdin.buffer.read(4), "little"))
    return int.from_bytes(head[:8], "little")

def tell(data):
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()

def wait(until):
    tell(b"W" + until.to_bytes(8, "little"))
    return answer()
"""


def script(tmp_path, body):
    """Write a program that speaks the twin's protocol, or does not."""
    path = tmp_path / "firmware"
    path.write_text(f"#!/usr/bin/env python3\nimport os, sys, time\n{ANSWER}\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_what_it_does_before_and_after_its_first_wait_is_returned_together(tmp_path):
    path = script(
        tmp_path,
        'tell(b"C\\x05\\0\\0\\0hello"); now = wait(0); tell(b"B\\x02\\0\\0\\0ab"); tell(b"B\\x01\\0\\0\\0c");'
        " now = wait(now + 7); wait(now)",
    )
    with TwinProcess(path) as twin:
        taken = twin.resume(Given(100))
        assert (taken.until_us, taken.bus, taken.console) == (107, (b"ab", b"c"), b"hello")
        assert twin.resume(Given(103, bus=b"x" * 70000)).until_us == 103
        pid = twin.pid
    assert gone(pid)


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ("sys.exit(3)", r"the native twin has ended with exit status 3$"),
        ('wait(5); print("out of luck", file=sys.stderr); os.abort()', r"by SIGABRT; it said: out of luck$"),
        ('tell(b"Z")', r"sends 0x5a, which no twin does; build it again"),
        ('tell(b"B" + (2**31).to_bytes(4, "little"))', r"without waiting; this is a defect in it$"),
        ("wait(0); os.kill(os.getpid(), 9)", r"has ended by SIGKILL$"),
        ("os.close(1); time.sleep(20)", r"has closed its output and goes on; it is no twin, build it again$"),
    ],
)
def test_a_twin_that_fails_is_told_of_in_one_sentence(tmp_path, body, sentence):
    twin = TwinProcess(script(tmp_path, body))
    with pytest.raises(RunError, match=sentence):
        for t in range(3):
            twin.resume(Given(t))
    pid = twin.pid
    twin.close()
    twin.close()
    assert gone(pid)


def test_a_program_that_is_not_there_is_no_twin(tmp_path):
    with pytest.raises(InputError, match="can not be started"):
        TwinProcess(tmp_path / "nothing")
    text = tmp_path / "text"
    text.write_text("no program")
    with pytest.raises(InputError, match="can not be started"):
        TwinProcess(text)


def test_a_built_twin_says_hello_and_goes_when_its_input_ends():
    with TwinProcess(image(XC330, "host")) as twin:
        taken = twin.resume(Given(0))
        assert b"servolve: try help" in taken.console
        assert taken.until_us > 0
        assert b"ok" in twin.resume(Given(10_000, console=b"goal 0.3\n")).console
        pid = twin.pid
    assert gone(pid)


def test_a_twin_that_is_killed_is_told_of():
    with TwinProcess(image(XC330, "host")) as twin:
        twin.resume(Given(0))
        os.kill(twin.pid, signal.SIGKILL)
        with pytest.raises(RunError, match="SIGKILL"):
            for t in range(5):
                twin.resume(Given(t * 10_000))
