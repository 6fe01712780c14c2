"""Ask everybody on a line at once whether they are there, faster than one question and answer at a time.

Nothing is asked twice here and nobody waits for a servo that is not there longer than the line needs: who answers is
to be asked again, properly, through a bus.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from deploy.buses.port import SerialPort

_PING: Final = 0x01
_BROADCAST: Final = 0xFE
_STATUS: Final = 0x55
_HEADER_2: Final = bytes((0xFF, 0xFF, 0xFD, 0x00))
_STATUS_2_BYTES: Final = 14
_STATUS_1_BYTES: Final = 6
_SLOT_2_S: Final = 0.003
"""Turn of each id in answering a broadcast ping [s]. Source: dynamixel-sdk 4.1, `broadcastPing`."""
_IDS_2: Final = 253
_RETURN_DELAY_S_MAX: Final = 508e-6
_PATIENCE_S: Final = 0.003
"""How long to wait for one servo, beyond the line's time, before the next is asked: three USB frames [s]."""

_sdk: Final = Protocol2PacketHandler()


@dataclass(frozen=True)
class Answers:
    """Hold who answered.

    Args:
        models: id => model number, 0 where the protocol's ping does not tell it
        garbled: whether bytes came that were no answer
    """

    models: dict[int, int]
    garbled: bool


def broadcast_ping(port: SerialPort) -> Answers:
    """Ask every Dynamixel 2.0 servo on a line with one packet.

    Args:
        port: the open port
    """
    question = bytes((*_HEADER_2, _BROADCAST, 3, 0, _PING))
    question += _crc(question)
    port.clearPort()
    port.writePort(question)
    heard = _hear(port, port.now() + len(question) * port.byte_s + _IDS_2 * _SLOT_2_S + port.latency_s)
    models: dict[int, int] = {}
    rest = heard.replace(question, b"", 1)  # an adapter may echo
    garbled = False
    while len(rest) >= _STATUS_2_BYTES:
        packet = rest[:_STATUS_2_BYTES]
        valid = packet[:4] == _HEADER_2 and packet[5:8] == bytes((7, 0, _STATUS)) and packet[-2:] == _crc(packet[:-2])
        if valid:
            garbled |= packet[4] in models
            models[packet[4]] = int.from_bytes(packet[9:11], "little")
        else:
            garbled = True
        rest = rest[_STATUS_2_BYTES if valid else 1 :]
    return Answers(models, garbled or bool(rest))


def ping_each(port: SerialPort, ids: Sequence[int], until_s: float = math.inf) -> Answers:
    """Ask servos of protocol 1 framing one after the other: Dynamixel 1.0 and Feetech.

    An adapter that holds replies back does not hold up the line: the next question goes out when the line is free, and
    an answer names its servo, however late it comes. Should two meet on the line, the answers are garbled.

    Args:
        port: the open port
        ids: whom to ask
        until_s: when to ask nobody else, by the port's time [s]
    """
    line_s = 2 * _STATUS_1_BYTES * port.byte_s + _RETURN_DELAY_S_MAX
    heard: list[bytes] = []
    questions = []
    garbled = False
    pending = b""
    port.clearPort()
    for number, servo in enumerate(ids):
        body = bytes((servo, 2, _PING))
        question = b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))
        questions.append(question)
        port.writePort(question)
        last = number == len(ids) - 1 or port.now() >= until_s
        until = port.now() + line_s + (port.latency_s if last else min(port.latency_s, _PATIENCE_S))
        while port.wait(until):
            pending += port.readPort(port.getBytesAvailable())
            pending, found, bad = _statuses_1(pending)
            heard += found
            garbled |= bad
            if not pending and any(packet[2] == servo and packet != question for packet in found):
                break
        if last:
            break
    port.end_transaction()
    if len(questions) > 1 and all(question in heard for question in questions):
        # the adapter echoes; a servo whose voltage is wrong answers with the very bytes of the question, once more
        for question in questions:
            heard.remove(question)
    return Answers({packet[2]: 0 for packet in heard}, garbled or bool(pending))


def _statuses_1(data: bytes) -> tuple[bytes, list[bytes], bool]:
    """Return what may be the start of a packet, the whole packets, and whether there was anything else."""
    found = []
    bad = False
    while data:
        packet = data[:_STATUS_1_BYTES]
        if not b"\xff\xff".startswith(packet[:2]):
            data, bad = data[1:], True
        elif len(packet) < _STATUS_1_BYTES:
            break
        elif packet[3] == 2 and (sum(packet[2:]) & 0xFF) == 0xFF:
            found.append(packet)
            data = data[_STATUS_1_BYTES:]
        else:
            data, bad = data[1:], True
    return data, found, bad


def _hear(port: SerialPort, until: float) -> bytes:
    """Return all that comes by a time, which each byte puts off by its own length."""
    heard = b""
    while port.wait(until):
        data = port.readPort(port.getBytesAvailable())
        heard += data
        until += len(data) * port.byte_s
    port.end_transaction()
    return heard


def _crc(packet: bytes) -> bytes:
    return int(_sdk.updateCRC(0, list(packet), len(packet))).to_bytes(2, "little")
