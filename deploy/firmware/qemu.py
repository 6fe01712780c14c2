"""Run a board's image under QEMU in lock step, through its debugger port.

The image is the one that would be flashed. What it does between two calls of `sv_hal_wait` takes no time of the rig's:
the machine is stopped at each call, given the rig's time and bytes, and sent back to its caller. The debugger writes
new bytes into the board's receive rings and replaces two functions in the machine's memory, `sv_hal_now_us` and
`sv_hal_inputs`, by loads of what it has written there; what the image sends leaves through the emulated UARTs.

QEMU counts instructions (`-icount`), so that ticks and watchdog too come after the same instruction in every run: the
same bytes in give the same bytes out.
"""

from __future__ import annotations

import ctypes
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from select import select
from types import MappingProxyType
from typing import IO, Final, Protocol

from controller.errors import InputError, RunError
from deploy.firmware.elf import Symbol, read_symbols
from deploy.firmware.gdb_stub import LR, PC, GdbStub, memory_read, memory_write, parse_registers, register_write
from deploy.firmware.machine import Given, Taken

QEMU: Final = "qemu-system-arm"
NOTHING_S: Final = 60.0
"""How long a machine may compute without coming to wait [s of this computer's time]."""

_LINES: Final = ("bus", "sensors", "console")
_RING: Final = struct.Struct("<IHHHH")
_WRITTEN: Final = 6
_LOST: Final = 10
_CLOCK: Final = 2**32
"""The image's clock begins anew after so many microseconds."""
_DEATH_SIGNAL: Final = 1  # PR_SET_PDEATHSIG


@dataclass(frozen=True)
class EmulatedBoard:
    """Say what a machine of QEMU has.

    Args:
        uarts: numbers of the UARTs for bus, sensors and console, (3,)
        spare: address of some RAM that no image uses
    """

    uarts: tuple[int, int, int]
    spare: int


BOARDS: Final = MappingProxyType(
    {
        "netduinoplus2": EmulatedBoard((0, 2, 5), 0x20020000),
        "mps2-an386": EmulatedBoard((0, 1, 2), 0x21000000),
    }
)
"""Machines of QEMU that servolve has boards for, by name."""


@dataclass(frozen=True)
class _Ring:
    """Hold where one of the image's receive rings stands."""

    address: int
    bytes: int
    mask: int
    written: int
    taken: int
    lost: int


def require_emulator(machine: str) -> None:
    """Check that a machine can be emulated here.

    Args:
        machine: one of `BOARDS`

    Raises:
        InputError: there is no QEMU, or no such machine
    """
    if machine not in BOARDS:
        raise InputError(f"no board of servolve is QEMU's machine '{machine}'; choose one of {', '.join(BOARDS)}")
    if shutil.which(QEMU) is None:
        raise InputError(f"there is no {QEMU}; install it, as with: apt-get install qemu-system-arm")


class Qemu:
    """Run an image in lock step; close it after use.

    Args:
        image: path of the linked image
        machine: one of `BOARDS`

    Raises:
        InputError: there is no QEMU, no such machine, or no such image
    """

    def __init__(self, image: Path, machine: str) -> None:
        require_emulator(machine)
        self._board = BOARDS[machine]
        self._symbols = read_symbols(image)
        needed = ("sv_hal_init", "sv_hal_wait", "sv_hal_now_us", "sv_hal_inputs", "board_send_bus", "board_received")
        missing = [name for name in needed if name not in self._symbols]
        if missing:
            raise InputError(f"{image}: has no symbol {missing[0]}; build it with the board's own HAL, with symbols")
        self._process, self._sockets, self._words = _start(image, machine, self._board)
        self._finalize = weakref.finalize(self, _end, self._process, (*self._sockets.values(), self._words))
        self.stub = GdbStub(self._sockets["gdb"])
        self._sent: dict[str, bytearray] = {line: bytearray() for line in _LINES}
        self._sizes: list[int] = []
        self._lr: int | None = None
        self._rings: tuple[_Ring, ...] = ()
        try:
            self.stub.describe()
            for name in ("sv_hal_init", "sv_hal_wait", "board_send_bus"):
                self.stub.add_breakpoint(self._symbols[name].address)
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Return the process of the emulator."""
        return self._process.pid

    @property
    def lines(self) -> MappingProxyType[str, socket.socket]:
        """Return the far ends of the UARTs "bus", "sensors" and "console"."""
        return MappingProxyType(self._sockets)

    def symbol(self, name: str) -> Symbol:
        """Return where something of the image lies.

        Args:
            name: of a function or variable

        Raises:
            InputError: the image has none of this name
        """
        if name not in self._symbols:
            raise InputError(f"the image has no symbol {name}; build it with symbols")
        return self._symbols[name]

    def resume(self, given: Given) -> Taken:
        """Wake the image and let it work until it waits.

        The first call boots the image, lets it come to its first wait, and wakes it there with what is given.

        Args:
            given: what has come since the last call

        Returns:
            what it has done

        Raises:
            RunError: the image has died or does not come to wait
        """
        boot: tuple[bytes, ...] = ()
        if self._lr is None:
            self.stub.run_after([self._world(Given(0))])
            self._come_to_wait()
            boot = self._take_packets()
        until = self._wake(given)
        bus, console = self._take_packets(), bytes(self._sent["console"])
        for sent in self._sent.values():
            sent.clear()
        return Taken(until, bus, console, boot)

    def close(self) -> None:
        """End the emulator, whatever state it is in; a second call does nothing."""
        self._finalize()

    def _wake(self, given: Given) -> int:
        """Give, send the image back to where it called `sv_hal_wait`, and run to the next call: => until when [us]."""
        assert self._lr is not None
        writes = [self._world(given)]
        for ring, data in zip(self._rings, (given.bus, given.sensors, given.console), strict=True):
            writes += _append(ring, data)
        self.stub.run_after([*writes, register_write(PC, self._lr & ~1)])
        ahead = (self._come_to_wait() - given.now_us) % _CLOCK
        return given.now_us + (ahead if ahead < _CLOCK // 2 else ahead - _CLOCK)

    def _world(self, given: Given) -> str:
        return memory_write(self._board.spare, struct.pack("<II", given.now_us % _CLOCK, given.inputs))

    def _come_to_wait(self) -> int:
        """Let the machine run until it calls `sv_hal_wait`: => until when on its own clock [us]."""
        received = self._symbols["board_received"]
        deadline = time.monotonic() + NOTHING_S
        while True:
            self._run_to_stop(deadline)
            answers = self.stub.ask(["g", memory_read(received.address, _RING.size * len(_LINES))])
            registers = parse_registers(answers[0])
            if registers[PC] == self._symbols["sv_hal_wait"].address:
                self._lr = registers[LR]
                rings = enumerate(_RING.iter_unpack(bytes.fromhex(answers[1])))
                self._rings = tuple(_Ring(received.address + _RING.size * i, *ring) for i, ring in rings)
                return registers[0]
            if registers[PC] == self._symbols["board_send_bus"].address:
                self._sizes.append(registers[1])
            elif registers[PC] == self._symbols["sv_hal_init"].address:
                self._forget_unsent()
                self._replace()
            else:
                raise RunError(f"the image stopped at 0x{registers[PC]:08x}, where nothing should; see what it wrote")
            self.stub.step()
            self.stub.run()

    def _run_to_stop(self, deadline: float) -> None:
        """Wait until the machine stands still, taking what its UARTs send so that none of them stands in its way."""
        sources: list[_Readable] = [self.stub, *(self._sockets[line] for line in _LINES)]
        while not self.stub.stopped():
            left = deadline - time.monotonic()
            ready = select(sources, [], [], left)[0] if left > 0 else ()
            if not ready:
                raise RunError(
                    f"the image has computed for {NOTHING_S:g} s without coming to wait; look for a loop, or for resets"
                )
            self._take_sent()
            if self.stub in ready:
                self._listen()
        self._take_sent()

    def _listen(self) -> None:
        try:
            self.stub.listen()
        except RunError as error:
            self._words.seek(0)
            words = " ".join(self._words.read().decode(errors="replace").split())[:300]  # registers follow
            raise RunError(f"{error}: {words}" if words else str(error)) from None

    def _take_sent(self) -> None:
        for line in _LINES:
            while True:
                try:
                    data = self._sockets[line].recv(65536)
                except BlockingIOError:
                    break
                if not data:
                    break
                self._sent[line] += data

    def _take_packets(self) -> tuple[bytes, ...]:
        """Cut what has left the bus's UART into the packets that were handed to it."""
        data = bytes(self._sent["bus"])
        packets, begin = [], 0
        for size in self._sizes:
            packets.append(data[begin : begin + size])
            begin += size
        if begin != len(data):
            raise RunError(f"{begin} bytes were handed to the bus and {len(data)} left it; the board's HAL is wrong")
        self._sent["bus"].clear()
        self._sizes.clear()
        return tuple(packet for packet in packets if packet)

    def _forget_unsent(self) -> None:
        """Drop packets of a program that died before its lines were up."""
        while sum(self._sizes) > len(self._sent["bus"]):
            self._sizes.pop()

    def _replace(self) -> None:
        """Make clock and inputs read what the debugger writes; after a reset the memory may be as it was built.

        Both are too short for that, and go on in `sv_hal_wait`, whose own code never runs here.
        """
        load = _move(1, self._board.spare)
        back = struct.pack("<2H", 0x4770, 0xBF00)  # bx lr; nop
        clock = load + struct.pack("<2H", 0x6808, 0x4770)  # ldr r0, [r1]; bx lr
        inputs = load + struct.pack("<2H", 0x6848, 0x4770)  # ldr r0, [r1, #4]; bx lr
        self._patch("sv_hal_wait", back + clock + inputs)
        place = self._symbols["sv_hal_wait"].address + len(back)
        for name, code in (("sv_hal_now_us", clock), ("sv_hal_inputs", inputs)):
            self._patch(name, _branch(self._symbols[name].address, place))
            place += len(code)

    def _patch(self, name: str, code: bytes) -> None:
        symbol = self._symbols[name]
        if symbol.size < len(code):
            raise RunError(f"{name} is shorter than its replacement; build the image with the board's own HAL")
        self.stub.write_memory(symbol.address, code)


class _Readable(Protocol):
    def fileno(self) -> int: ...


def _append(ring: _Ring, data: bytes) -> list[str]:
    """Return the writes that put bytes into a ring, as an interrupt would: what does not fit is lost."""
    if not data:
        return []
    space = ring.mask + 1 - ((ring.written - ring.taken) & 0xFFFF)
    fits, begin = data[:space], ring.written & ring.mask
    first = fits[: ring.mask + 1 - begin]
    writes = [(ring.bytes + begin, first), (ring.bytes, fits[len(first) :])]
    writes.append((ring.address + _WRITTEN, struct.pack("<H", (ring.written + len(fits)) & 0xFFFF)))
    writes.append((ring.address + _LOST, struct.pack("<H", (ring.lost + len(data) - len(fits)) & 0xFFFF)))
    return [memory_write(address, part) for address, part in writes if part]


def _move(register: int, value: int) -> bytes:
    """Return Thumb code that loads a constant.

    Source: Armv7-M Architecture Reference Manual, A7.7.76 (MOV immediate, T3), A7.7.79 (MOVT).
    """
    code = b""
    for opcode, half in ((0xF240, value & 0xFFFF), (0xF2C0, value >> 16)):
        high = opcode | (half >> 11 & 1) << 10 | half >> 12
        code += struct.pack("<2H", high, (half >> 8 & 7) << 12 | register << 8 | half & 0xFF)
    return code


def _branch(here: int, there: int) -> bytes:
    """Return Thumb code that goes elsewhere.

    Source: Armv7-M Architecture Reference Manual, A7.7.12 (B, T4).
    """
    offset = (there - here - 4) >> 1
    sign, i1, i2 = (offset >> bit & 1 for bit in (23, 22, 21))
    high = 0xF000 | sign << 10 | offset >> 11 & 0x3FF
    return struct.pack("<2H", high, 0x9000 | (1 ^ i1 ^ sign) << 13 | (1 ^ i2 ^ sign) << 11 | offset & 0x7FF)


def _start(
    image: Path, machine: str, board: EmulatedBoard
) -> tuple[subprocess.Popen[bytes], dict[str, socket.socket], IO[bytes]]:
    """Start QEMU, standing still, with a socket pair for the debugger and for each line: nobody else can connect."""
    pairs = {name: socket.socketpair() for name in ("gdb", *_LINES)}
    chardevs = [f"socket,id={name},fd={far.fileno()}" for name, (_, far) in pairs.items()]
    serials = ["null"] * (max(board.uarts) + 1)
    for line, uart in zip(_LINES, board.uarts, strict=True):
        serials[uart] = f"chardev:{line}"
    words = tempfile.TemporaryFile()  # noqa: SIM115 — closed with the emulator
    process = subprocess.Popen(
        [
            *(QEMU, "-M", machine, "-kernel", str(image.resolve()), "-nodefaults", "-display", "none"),
            *("-icount", "shift=4,sleep=off", "-S"),
            *(word for chardev in chardevs for word in ("-chardev", chardev)),
            *("-gdb", "chardev:gdb"),
            *(word for serial in serials for word in ("-serial", serial)),
        ],
        stdin=subprocess.DEVNULL,
        stdout=words,
        stderr=words,
        pass_fds=[far.fileno() for _, far in pairs.values()],
        start_new_session=True,  # Ctrl-C is for us: we tell the firmware to stop
        preexec_fn=_die_with_parent if sys.platform == "linux" else None,  # noqa: PLW1509 — no threads hold locks here
    )
    for near, far in pairs.values():
        far.close()
        near.setblocking(False)
    return process, {name: near for name, (near, _) in pairs.items()}, words


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)


def _end(process: subprocess.Popen[bytes], resources: Sequence[socket.socket | IO[bytes]]) -> None:
    process.kill()
    process.wait()
    for resource in resources:
        resource.close()
