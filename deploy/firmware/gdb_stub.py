"""Talk to an emulator's debugger port: the GDB remote protocol, as much of it as lock step needs.

Questions may be sent together; each is answered in turn. An acknowledgement is never sent: the next question is one.
While the machine runs nothing is sent at all, for any byte would stop it.

Source: Debugging with GDB, appendix E; QEMU 7.2 gdbstub.c.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from typing import Final

from controller.errors import RunError

SP, LR, PC = 13, 14, 15
"""Numbers of the registers that have names."""

_CORE: Final = 16
_CHUNK: Final = 1024
_ANSWER_S: Final = 30.0


class GdbStub:
    """Hold a debugger's end of a connection; whoever made the socket closes it.

    Args:
        connection: to the emulator, which stands still
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._received = bytearray()
        connection.settimeout(_ANSWER_S)

    def fileno(self) -> int:
        """Return what `select` can wait on."""
        return self._connection.fileno()

    def ask(self, questions: Sequence[str]) -> list[str]:
        """Send questions together and return their answers.

        Args:
            questions: packets without frame, each of which has an answer

        Raises:
            RunError: the emulator is gone, or does not answer, or refuses
        """
        self._send(questions)
        answers = []
        for question in questions:
            answer = self._answer()
            if answer.startswith("E"):
                raise RunError(f"the emulator's debugger port answers {answer} to {question[:40]}; use QEMU 7 or later")
            answers.append(answer)
        return answers

    def describe(self) -> None:
        """Read the description of the registers, without which they can not be written."""
        offset = 0
        while True:
            answer = self.ask([f"qXfer:features:read:target.xml:{offset:x},{_CHUNK:x}"])[0]
            offset += len(answer) - 1
            if not answer.startswith("m"):
                return

    def registers(self) -> tuple[int, ...]:
        """Return r0..r15, (16,)."""
        return parse_registers(self.ask(["g"])[0])

    def write_register(self, number: int, value: int) -> None:
        """Write one of r0..r15.

        Args:
            number: which
            value: 32 bits
        """
        self.ask([register_write(number, value)])

    def read_memory(self, address: int, size: int) -> bytes:
        """Read memory.

        Args:
            address: of the first byte
            size: [bytes]
        """
        parts = [(address + i, min(_CHUNK, size - i)) for i in range(0, size, _CHUNK)]
        return b"".join(bytes.fromhex(self.ask([memory_read(begin, n)])[0]) for begin, n in parts)

    def write_memory(self, address: int, data: bytes) -> None:
        """Write memory, flash included.

        Args:
            address: of the first byte
            data: what it shall hold
        """
        for i in range(0, len(data), _CHUNK):
            self.ask([memory_write(address + i, data[i : i + _CHUNK])])

    def add_breakpoint(self, address: int) -> None:
        """Stop before the instruction at an address is executed.

        Args:
            address: of a Thumb instruction
        """
        self.ask([f"Z0,{address:x},2"])

    def remove_breakpoint(self, address: int) -> None:
        """Stop there no more.

        Args:
            address: of the instruction
        """
        self.ask([f"z0,{address:x},2"])

    def run(self) -> None:
        """Let the machine run; `stopped` tells when it has come to a breakpoint."""
        self._send(["c"])

    def step(self) -> None:
        """Execute one instruction, at a breakpoint or not."""
        self.ask(["s"])

    def run_after(self, questions: Sequence[str]) -> None:
        """Send questions, let the machine run after them, and drop the answers, which must be "OK".

        Args:
            questions: packets without frame
        """
        self._send([*questions, "c"])
        for question in questions:
            answer = self._answer()
            if answer != "OK":
                raise RunError(
                    f"the emulator's debugger port answers '{answer}' to {question[:40]}; use QEMU 7 or later"
                )

    def stopped(self) -> bool:
        """Return whether the machine is known to have stopped since `run`."""
        return self._packet() is not None

    def listen(self) -> None:
        """Take what has come; call it when there is something to read, and ask `stopped` then.

        Raises:
            RunError: the emulator is gone
        """
        self._fill()

    def _send(self, questions: Sequence[str]) -> None:
        frames = (f"${question}#{sum(question.encode()) & 0xFF:02x}" for question in questions)
        try:
            self._connection.sendall("".join(frames).encode())
        except OSError:
            raise RunError("the emulator is gone; see what it wrote above") from None

    def _answer(self) -> str:
        while True:
            packet = self._packet()
            if packet is not None:
                return packet
            self._fill()

    def _fill(self) -> None:
        try:
            data = self._connection.recv(65536)
        except OSError:
            raise RunError("the emulator's debugger port does not answer; run it again") from None
        if not data:
            raise RunError("the emulator has ended by itself; see what it wrote above")
        self._received += data

    def _packet(self) -> str | None:
        """Take one packet from what has been received, if there is a whole one."""
        begin = self._received.find(b"$")
        end = self._received.find(b"#", begin)
        if begin < 0 or end < 0 or len(self._received) < end + 3:
            return None
        body = bytes(self._received[begin + 1 : end])
        del self._received[: end + 3]
        return _unescape(body).decode("latin-1")


def memory_read(address: int, size: int) -> str:
    """Return the question for some memory.

    Args:
        address: of the first byte
        size: [bytes]
    """
    return f"m{address:x},{size:x}"


def memory_write(address: int, data: bytes) -> str:
    """Return the request to write some memory.

    Args:
        address: of the first byte
        data: not more than a packet holds
    """
    return f"M{address:x},{len(data):x}:{data.hex()}"


def register_write(number: int, value: int) -> str:
    """Return the request to write a register.

    Args:
        number: which of r0..r15
        value: 32 bits
    """
    return f"P{number:x}={struct.pack('<I', value).hex()}"


def parse_registers(answer: str) -> tuple[int, ...]:
    """Return r0..r15 of the answer to "g".

    Args:
        answer: hexadecimal, low bytes first
    """
    return struct.unpack_from(f"<{_CORE}I", bytes.fromhex(answer[: 8 * _CORE]))


def _unescape(body: bytes) -> bytes:
    out = bytearray()
    it = iter(body)
    for byte in it:
        out.append(next(it, 0) ^ 0x20 if byte == ord("}") else byte)
    return bytes(out)
