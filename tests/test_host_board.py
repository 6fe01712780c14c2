"""The host board's lines, clock and watchdog, spoken to byte for byte over its standard input and output."""

import struct
import subprocess

import pytest
from rig_in_c import FLAGS

from firmware_gen.projects.board import load_board
from firmware_gen.projects.project import RUNTIME

# answers what it is told: says its cause and time, then repeats each line's bytes on bus and console
PROGRAM = """
#include "sv_hal.h"

int main(void);

static void say(char line, int32_t n) {
  uint8_t text[2] = {(uint8_t)line, (uint8_t)n};
  sv_hal_write(SV_LINE_CONSOLE, text, 2);
}

int main(void) {
  uint8_t data[64];
  sv_hal_init();
  say('R', sv_hal_reset_cause());
  for (;;) {
    sv_hal_wait(sv_hal_now_us() + 1000);
    say('I', (int32_t)sv_hal_inputs());
    for (int32_t line = 0; line < 3; line++) {
      const int32_t n = sv_hal_read(line, data, sizeof data);
      say('N', n);
      sv_hal_write(line, data, n);
      if (line == SV_LINE_CONSOLE && n > 0) {
        switch (data[0]) {
          case 'f':
            sv_hal_feed_watchdog();
            break;
          case 'h':
            for (;;) {
            }
          default:
            break;
        }
      }
    }
  }
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    folder = tmp_path_factory.mktemp("host")
    (folder / "main.c").write_text(PROGRAM)
    hal = load_board("host").folder / "hal.c"
    command = ["gcc", *FLAGS, f"-I{RUNTIME}", "-o", folder / "program", folder / "main.c", hal]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "program"


class Process:
    """The program, and what it has said since it was last answered."""

    def __init__(self, path):
        self.process = subprocess.Popen([path], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            pipe.close()

    def listen(self):
        """Return (kind, bytes) of all that is sent until it waits, and until when."""
        sent = []
        while True:
            kind = self._take(1)
            if kind == b"W":
                return sent, struct.unpack("<q", self._take(8))[0]
            sent.append((kind, self._take(struct.unpack("<I", self._take(4))[0])))

    def answer(self, now_us, inputs=0, bus=b"", sensors=b"", console=b""):
        data = struct.pack("<qI", now_us, inputs)
        self.process.stdin.write(
            data + b"".join(struct.pack("<I", len(line)) + line for line in (bus, sensors, console))
        )
        self.process.stdin.flush()

    def _take(self, size):
        data = self.process.stdout.read(size)
        assert len(data) == size, "it has ended"
        return data


def test_time_bytes_and_inputs_come_from_the_runner(program):
    with Process(program) as twin:
        assert twin.listen() == ([(b"C", b"R\x00")], 1000)
        twin.answer(123, 3, b"servo", b"$P", b"status")
        sent, until = twin.listen()
        assert until == 1123
        # nothing is sent on the sensors' line
        assert sent == [
            *((b"C", b"I\x03"), (b"C", b"N\x05"), (b"B", b"servo"), (b"C", b"N\x02"), (b"C", b"N\x06")),
            (b"C", b"status"),
        ]


def test_what_is_not_read_at_once_waits_in_order_and_what_is_too_much_is_lost(program):
    data = bytes(range(256)) * 260  # more than a line holds
    with Process(program) as twin:
        twin.listen()
        twin.answer(1, bus=data)
        got = b""
        for k in range(2, 1100):
            sent, _ = twin.listen()
            got += b"".join(piece for kind, piece in sent if kind == b"B")
            twin.answer(k)
        assert got == data[:65536]


def test_the_watchdog_bites_when_it_is_not_fed_and_never_before_the_first_time(program):
    with Process(program) as twin:
        twin.listen()
        twin.answer(1_000_000)
        twin.listen()
        twin.answer(1_000_001, console=b"f")
        twin.listen()
        twin.answer(1_140_000)
        assert (b"C", b"I\x00") in twin.listen()[0], "still running"
        twin.answer(1_160_000)
        # it starts anew, and the clock goes on
        assert twin.listen() == ([(b"C", b"R\x01")], 1_161_000)


def test_the_watchdog_bites_a_main_loop_that_hangs(program):
    with Process(program) as twin:
        for at, said in ((10, b"f"), (20, b"h")):
            twin.listen()
            twin.answer(at, console=said)
        assert twin.listen() == ([(b"C", b"R\x01")], 1020), "what it had not sent yet is lost with it"


def test_the_end_of_the_input_ends_it(program):
    with Process(program) as twin:
        twin.listen()
        twin.process.stdin.close()
        assert twin.process.wait() == 0
