"""The firmware's bus master and line reader under test: built as a shared library, with a HAL whose bytes are a test's.

Undefined behaviour traps: a test that reaches it does not survive.
"""

import ctypes
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
RUNTIME = ROOT / "firmware_gen" / "runtime"
SOURCES = [
    Path(__file__).with_name("runtime_shim.c"),
    *(RUNTIME / f"sv_{name}.c" for name in ("rig", "packets1", "packets2", "lines")),
    *sorted(RUNTIME.glob("sv_bus*.c")),
]
FLAGS = "-std=c99 -O1 -g -ffp-contract=off -Wall -Wextra -Wconversion -Wdouble-promotion -Wmissing-prototypes -Werror"
TRAPS = "-fsanitize=undefined -fsanitize-undefined-trap-on-error -ftrapv"

PROTOCOLS = {"dynamixel-2.0": 0, "feetech-sts": 1}
ENCODINGS = {"unsigned": 0, "twos": 1, "sign10": 10, "sign11": 11, "sign15": 15}
ALERTS = {"dynamixel-2.0": 0x80, "feetech-sts": 0xFF}
STATUSES = ("data", "refused", "missing", "corrupt")
DATA_MAX = 16 * 160


class _Reply(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_uint8) for name in ("status", "error", "late")),
        ("t_us", ctypes.c_uint32),
    )


_NOW = ctypes.CFUNCTYPE(ctypes.c_uint32)
_WAIT = ctypes.CFUNCTYPE(None, ctypes.c_uint32)
_BYTES = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.POINTER(ctypes.c_uint8), ctypes.c_int32)


class _Hal(ctypes.Structure):
    _fields_ = (("now_us", _NOW), ("wait", _WAIT), ("read", _BYTES), ("write", _BYTES))


class Said(NamedTuple):
    """What came of a question to one servo."""

    status: str
    data: bytes
    error: int
    alert: bool
    late: bool
    t_us: int


@pytest.fixture(scope="session")
def runtime(tmp_path_factory):
    """Return the shared library."""
    path = tmp_path_factory.mktemp("runtime") / "runtime.so"
    includes = [f"-I{RUNTIME}", f"-I{ROOT / 'controller' / 'runtime'}"]
    command = [
        "gcc",
        *FLAGS.split(),
        *TRAPS.split(),
        "-shared",
        "-fPIC",
        *includes,
        *map(str, SOURCES),
        "-o",
        str(path),
    ]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(path))
    library.shim_size.restype = ctypes.c_size_t
    library.shim_replies.restype = ctypes.POINTER(_Reply)
    library.shim_ping.restype = ctypes.c_uint16
    return library


def buffer(size):
    """Return room for bytes that C writes."""
    return ctypes.create_string_buffer(size)


class Runtime:
    """Hold one bus master and one line reader.

    Args:
        library: the shared library
    """

    def __init__(self, library):
        self._library = library
        self._state = ctypes.create_string_buffer(library.shim_size())

    def __getattr__(self, name):
        function = getattr(self._library, f"shim_{name}")
        return lambda *arguments: function(self._state, *arguments)


class Bus:
    """Drive the firmware's bus master as one drives the host's.

    Args:
        library: the shared library
        line: the other end: now_us, wait(until_us), take(size) and send(frame)
        protocol: of the servos
        ids: of the servos
        baud: [bits/s]
        return_delay_us: of the servos
        patience_us: how much later than the line needs a reply may come
        fast: whether to ask for one packet of all
    """

    def __init__(self, library, line, protocol, ids, baud=1_000_000, return_delay_us=0, patience_us=2000, fast=False):
        self.ids = tuple(ids)
        self._alerts = ALERTS[protocol]
        self._runtime = Runtime(library)
        self._library = library
        self._hal = _Hal(
            _NOW(lambda: line.now_us % 2**32),
            _WAIT(lambda until_us: line.wait(line.now_us + ctypes.c_int32(until_us - line.now_us).value)),
            _BYTES(lambda _, data, size: self._fill(data, line.take(size))),
            _BYTES(lambda _, data, size: line.send(ctypes.string_at(data, size))),
        )
        self._data = ctypes.create_string_buffer(DATA_MAX)
        settings = (PROTOCOLS[protocol], baud, return_delay_us, patience_us, fast)
        self._call("open", *settings, len(self.ids), bytes(self.ids))

    @property
    def strays(self):
        return self._runtime.strays()

    def ping(self, servo):
        model = self._call("ping", self.ids.index(servo))
        return self._said(0, b""), model

    def read(self, servo, address, length):
        self._call("read", self.ids.index(servo), address, length, self._data)
        return self._said(0, self._data.raw[:length])

    def write(self, servo, address, data):
        self._call("write", self.ids.index(servo), address, data, len(data))
        return self._said(0, b"")

    def sync_read(self, address, length):
        self._call("sync_read", address, length, self._data)
        return {servo: self._said(n, self._data.raw[n * length :][:length]) for n, servo in enumerate(self.ids)}

    def sync_write(self, address, data):
        self._call("sync_write", address, len(data) // len(self.ids), data)

    def read_register(self, servo, register):
        where = (register.address, register.size, ENCODINGS[register.encoding])
        count = self._call("read_register", self.ids.index(servo), *where)
        return self._said(0, b"").status, count

    def write_register(self, servo, register, count):
        where = (register.address, register.size, ENCODINGS[register.encoding])
        held = self._call("write_register", self.ids.index(servo), *where, count)
        return self._said(0, b"").status, held

    def _call(self, name, *arguments):
        self._library.shim_hooks(ctypes.byref(self._hal))
        return getattr(self._runtime, name)(*arguments)

    def _said(self, number, data):
        reply = self._runtime.replies()[number]
        taken = data if reply.status == 0 else b""
        alert = bool(reply.error & self._alerts)
        return Said(STATUSES[reply.status], taken, reply.error, alert, bool(reply.late), reply.t_us)

    def _fill(self, data, taken):
        ctypes.memmove(data, taken, len(taken))
        return len(taken)
