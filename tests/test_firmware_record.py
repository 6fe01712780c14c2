"""The firmware's records, read by a decoder that follows sv_record.h's words and nothing else."""

import ctypes
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

ROOT = Path(__file__).parents[1]
RUNTIME = ROOT / "firmware_gen" / "runtime"
RECORD_MAX = 250
HAL = """
#include "sv_hal.h"
#include "sv_record.h"
static uint8_t line[1024];
static int32_t nline, room;
static uint32_t now_us;
int32_t taken(uint8_t* data);
void open_line(int32_t bytes);
int32_t taken(uint8_t* data) {
  for (int32_t i = 0; i < nline; i++) {
    data[i] = line[i];
  }
  return nline;
}
void open_line(int32_t bytes) {
  nline = 0;
  now_us = 0;
  room = bytes;
}
uint32_t sv_hal_now_us(void) { return now_us; }
void sv_hal_feed_watchdog(void) {}
// a byte leaves every 10 us
void sv_hal_wait(uint32_t until_us) {
  room += (int32_t)(until_us - now_us) / 10;
  now_us = until_us;
}
int32_t sv_hal_write(int32_t number, const uint8_t* data, int32_t size) {
  int32_t n = 0;
  for (; number == SV_LINE_CONSOLE && n < size && room > 0; n++, room--) {
    line[nline++] = data[n];
  }
  return n;
}
"""
FLAGS = "-std=c99 -O1 -Wall -Wextra -Wconversion -Wmissing-prototypes -Werror -fsanitize=undefined"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("record")
    (folder / "hal.c").write_text(HAL)
    command = ["gcc", *FLAGS.split(), "-fsanitize-undefined-trap-on-error", "-shared", "-fPIC", f"-I{RUNTIME}"]
    sources = [str(folder / "hal.c"), *(str(RUNTIME / name) for name in ("sv_record.c", "sv_packets2.c"))]
    subprocess.run([*command, *sources, "-o", str(folder / "record.so")], check=True)
    built = ctypes.CDLL(str(folder / "record.so"))
    built.sv_record_f32.argtypes = (ctypes.c_void_p, ctypes.c_float)
    built.sv_record_end.argtypes = (ctypes.c_void_p, ctypes.c_uint32)
    return built


class Writer:
    """One record, and the line that it goes out on."""

    def __init__(self, library, kind, room=1024):
        self.library = library
        self.record = ctypes.create_string_buffer(RECORD_MAX + 64)
        self.library.open_line(room)
        self.library.sv_record_begin(self.record, kind)

    def put(self, kind, value):
        getattr(self.library, f"sv_record_{kind}")(self.record, value)
        return self

    def end(self, wait_us=0):
        sent = self.library.sv_record_end(self.record, wait_us)
        data = ctypes.create_string_buffer(1024)
        size = self.library.taken(data)
        return sent, data.raw[:size]


def crc_bits(data):
    """Return the remainder of data * x^16 by x^16 + x^15 + x^2 + 1, computed as one long division."""
    remainder = int.from_bytes(data, "big") << 16
    for place in range(remainder.bit_length() - 1, 15, -1):
        if remainder >> place & 1:
            remainder ^= 0x18005 << (place - 16)
    return remainder


def decode(line):
    """Return type and body of the one record on a line."""
    assert line[0] == 0
    assert line[-1] == 0
    code = line[1:-1]
    assert 0 not in code
    data = bytearray()
    while code:
        run, code = code[1 : code[0]], code[code[0] :] if code[0] <= len(code) else pytest.fail("runs over")
        data += run
        data.append(0)
    data.pop()  # the zero that the end of the code stands for
    body, crc = bytes(data[:-2]), int.from_bytes(data[-2:], "little")
    assert crc == crc_bits(body)
    return body[0], body[1:]


def varint(data):
    """Return the number at the start of LEB128 bytes in zigzag code, and what is left."""
    value = 0
    for place, byte in enumerate(data):
        value |= (byte & 127) << 7 * place
        if byte < 128:
            return (value // 2 if value % 2 == 0 else -(value // 2) - 1), data[place + 1 :]
    return pytest.fail("no end")


FIXED = {"u8": "B", "u32": "I"}
NUMBERS = st.one_of(
    *(st.tuples(st.just(kind), st.integers(0, (1 << bits) - 1)) for kind, bits in (("u8", 8), ("u32", 32))),
    st.tuples(st.just("f32"), st.floats(width=32)),
    st.tuples(st.just("varint"), st.one_of(st.integers(-200, 200), st.integers(-(1 << 31), (1 << 31) - 1))),
)


@given(kind=st.integers(1, 255), numbers=st.lists(NUMBERS, max_size=25))
def test_every_number_comes_back(library, kind, numbers):
    writer = Writer(library, kind)
    for number in numbers:
        writer.put(*number)
    sent, line = writer.end()
    assert sent == 1
    got, body = decode(line)
    assert got == kind
    for what, value in numbers:
        if what == "varint":
            read, body = varint(body)
        elif what == "f32":
            assert body[:4] == struct.pack("<f", value)
            body = body[4:]
            continue
        else:
            size = struct.calcsize(FIXED[what])
            (read,), body = struct.unpack("<" + FIXED[what], body[:size]), body[size:]
        assert read == value
    assert body == b""


def test_a_known_record_byte_for_byte(library):
    sent, line = Writer(library, 7).put("u8", 0).put("u8", 0).put("u8", 1).put("varint", -2).end()
    crc = crc_bits(bytes((7, 0, 0, 1, 3)))
    assert sent == 1
    assert line == bytes((0, 2, 7, 1, 5, 1, 3, crc & 255, crc >> 8, 0))


@pytest.mark.parametrize("byte", [0, 1, 255])
def test_the_longest_record_is_sent_and_one_byte_more_is_not(library, byte):
    longest = RECORD_MAX - 3
    writer = Writer(library, 9)
    for _ in range(longest):
        writer.put("u8", byte)
    sent, line = writer.end()
    assert sent == 1
    assert decode(line) == (9, bytes([byte]) * longest)
    writer = Writer(library, 9)
    for _ in range(longest + 1):
        writer.put("u8", byte)
    assert writer.end() == (0, b"")


@given(extra=st.integers(1, 5000))
def test_no_length_writes_beyond_the_record(library, extra):
    writer = Writer(library, 9)
    for _ in range(RECORD_MAX + extra):
        writer.put("u8", 0xA5)
    size = RECORD_MAX + 3 + 5  # bytes, padding and count of sv_record
    assert writer.end() == (0, b"")
    assert writer.record.raw[size:] == bytes(len(writer.record.raw) - size)


def test_a_record_waits_for_room_as_long_as_it_may(library):
    def long():
        writer = Writer(library, 5, room=10)
        for value in range(100):
            writer.put("u8", value)
        return writer

    sent, line = long().end()
    assert (sent, len(line)) == (0, 10)
    sent, line = long().end(500)
    assert (sent, len(line)) == (0, 60)
    sent, line = long().end(20_000)
    assert sent == 1
    assert decode(line) == (5, bytes(range(100)))
