"""What an X servo does with each instruction that is for it alone, for its group, or for all.

Source: ROBOTIS e-Manual, docs/en/dxl/protocol2.md. What it says of no error is in `docs/rigs.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Final, Protocol, TypeAlias

from deploy.virtual import dynamixel2 as dxl
from deploy.virtual.control_table import ControlTable


class Instructed(Protocol):
    """Do what instructions ask of a servo."""

    table: ControlTable
    registered: bytes | None
    backup: Mapping[str, int] | None

    def read(self, address: int, length: int, now_ns: int) -> tuple[int, bytes]:
        """Return an error number and registers as they are now."""
        ...

    def check(self, address: int, data: bytes) -> int:
        """Return the error number that a write would have now, 0 for none."""
        ...

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """Write registers by the rules; return an error number."""
        ...

    def register(self, parameters: bytes | None) -> None:
        """Keep a write for the next action."""
        ...

    def factory_reset(self, kept: Iterable[str], now_ns: int) -> None:
        """Set the control table to the factory's, and boot."""
        ...

    def reboot(self, now_ns: int) -> None:
        """Start anew with what the EEPROM holds."""
        ...

    def clear_turns(self) -> bool:
        """Count the present position within one turn; return False if the shaft moves."""
        ...

    def back_up(self) -> None:
        """Keep a copy of what can be brought back."""
        ...

    def restore_backup(self, now_ns: int) -> None:
        """Bring the copy back, and boot."""
        ...


Handler: TypeAlias = Callable[[Instructed, dxl.Packet, int], tuple[int, bytes]]
"""(servo, packet, time [ns]) => error number, data."""

RESET_ALL, RESET_BUT_ID, RESET_BUT_ID_AND_BAUD = 0xFF, 1, 2
_KEPT: Final[Mapping[int, tuple[str, ...]]] = {
    RESET_ALL: (),
    RESET_BUT_ID: ("id",),
    RESET_BUT_ID_AND_BAUD: ("id", "baud_rate"),
}
_CLEAR_TURNS: Final = b"\x01DXL\x22"
_BACKUP_KEY: Final = b"CTRL"
_BACK_UP, _RESTORE = 1, 2


def unknown(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    """Answer an instruction that the servo does not have.

    Args:
        servo: who is asked
        packet: the instruction
        now_ns: time [ns]
    """
    return dxl.INSTRUCTION_ERROR, b""


def _ping(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    model = servo.table["model_number"]
    return 0, bytes((model & 0xFF, model >> 8, servo.table["firmware_version"]))


def _read(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    parameters = packet.parameters
    if len(parameters) != 4:
        return dxl.DATA_LENGTH_ERROR, b""
    return servo.read(_two(parameters, 0), _two(parameters, 2), now_ns)


def _write(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    if len(packet.parameters) < 3:
        return dxl.DATA_LENGTH_ERROR, b""
    return servo.write(_two(packet.parameters, 0), packet.parameters[2:], now_ns), b""


def _reg_write(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    if len(packet.parameters) < 3:
        return dxl.DATA_LENGTH_ERROR, b""
    error = servo.check(_two(packet.parameters, 0), packet.parameters[2:])
    if not error:
        servo.register(packet.parameters)
    return error, b""


def _action(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    registered = servo.registered
    if registered is None:
        return dxl.INSTRUCTION_ERROR, b""
    servo.register(None)
    return servo.write(_two(registered, 0), registered[2:], now_ns), b""


def _factory_reset(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    if len(packet.parameters) != 1:
        return dxl.DATA_LENGTH_ERROR, b""
    option = packet.parameters[0]
    if option not in _KEPT:
        return dxl.DATA_RANGE_ERROR, b""
    if packet.id == dxl.BROADCAST and option == RESET_ALL:
        return dxl.RESULT_FAIL, b""
    if servo.table["torque_enable"]:
        return dxl.ACCESS_ERROR, b""
    servo.factory_reset(_KEPT[option], now_ns)
    return 0, b""


def _reboot(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    if packet.parameters:
        return dxl.DATA_LENGTH_ERROR, b""
    servo.reboot(now_ns)
    return 0, b""


def _clear(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    if len(packet.parameters) != len(_CLEAR_TURNS):
        return dxl.DATA_LENGTH_ERROR, b""
    if packet.parameters != _CLEAR_TURNS:
        return dxl.DATA_RANGE_ERROR, b""
    return (0 if servo.clear_turns() else dxl.RESULT_FAIL), b""


def _backup(servo: Instructed, packet: dxl.Packet, now_ns: int) -> tuple[int, bytes]:
    if len(packet.parameters) != 1 + len(_BACKUP_KEY):
        return dxl.DATA_LENGTH_ERROR, b""
    option, key = packet.parameters[0], packet.parameters[1:]
    if key != _BACKUP_KEY or option not in (_BACK_UP, _RESTORE):
        return dxl.DATA_RANGE_ERROR, b""
    if servo.table["torque_enable"] or (option == _RESTORE and servo.backup is None):
        return dxl.RESULT_FAIL, b""
    if option == _BACK_UP:
        servo.back_up()
    else:
        servo.restore_backup(now_ns)
    return 0, b""


def _two(data: bytes, at: int) -> int:
    return data[at] | data[at + 1] << 8


INSTRUCTIONS: Final[Mapping[int, tuple[Handler, int]]] = {
    dxl.PING: (_ping, 0),
    dxl.READ: (_read, 1),
    dxl.WRITE: (_write, 2),
    dxl.REG_WRITE: (_reg_write, 2),
    dxl.ACTION: (_action, 2),
    dxl.FACTORY_RESET: (_factory_reset, 2),
    dxl.REBOOT: (_reboot, 2),
    dxl.CLEAR: (_clear, 2),
    dxl.BACKUP: (_backup, 2),
}
"""What a servo carries out, and the status return level from which it answers."""

GROUP_INSTRUCTIONS: Final = frozenset({dxl.WRITE, dxl.REG_WRITE, dxl.ACTION, dxl.REBOOT, dxl.CLEAR})
"""What is carried out, in silence, when it is sent to a secondary id: nothing that changes the EEPROM."""
