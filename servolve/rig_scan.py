"""`servolve rig scan`: which servos are on a port, at which bit rate, and what they are set to."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from controller.errors import InputError, RunError
from controller.families import family_of
from controller.products import PRODUCTS
from controller.registers import registers
from controller.rig_file import load_rig, rig_names
from deploy.buses.port import SerialPort
from deploy.commissioning.scan import PROTOCOLS, Found, Step, found_servos, scan, scan_steps

ID_MAX: Final = 253
_SOCKET_BAUD: Final = 57_600
"""A socket has no bit rate; this one only says how long to wait."""


def scan_port(
    port: str,
    /,
    *,
    protocol: Annotated[tuple[Literal["dynamixel-2.0", "dynamixel-1.0", "feetech"], ...], Parameter(negative="")] = (),
    bauds: str | None = None,
    ids: str | None = None,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Find every servo on a port: all protocols, all bit rates, all ids. Nothing is written to a servo.

    All of it takes about half a minute; --protocol, --bauds and --ids narrow it down. Ctrl-C ends it and keeps what was
    found.

    Args:
        port: serial device, or socket://HOST:PORT
        protocol: look for these only; may be repeated
        bauds: bit rates to ask at, as 57600,1000000 [bits/s]
        ids: ids to tell of, as 1-8,20
        json_: print one JSON object

    Returns:
        exit status
    """
    rates = _numbers("--bauds", bauds, 1, 2**31 - 1)
    wanted = _numbers("--ids", ids, 0, ID_MAX)
    socket = port.startswith("socket://")
    if socket and rates:
        raise InputError(f"--bauds {bauds}: a socket has no bit rate; leave it out")
    steps = scan_steps(protocol or PROTOCOLS, [_SOCKET_BAUD] if socket else rates)
    asked, interrupted = _scan(port, steps, wanted)
    found = found_servos(asked)
    first = [step for step in asked if not step.again]
    rigs = _rigs(found)
    notes = _notes(port, found, rigs, socket)
    if json_:
        told = {
            "port": port,
            "complete": not interrupted,
            "asked": [
                {
                    "framing": step.framing,
                    "baud": None if socket else step.baud,
                    "skipped": step.skipped or None,
                    "again": step.again,
                }
                for step in asked
            ],
            "servos": [_described(servo, socket) for servo in found],
            "rigs": rigs,
            "notes": notes,
        }
        print(json.dumps(told))
    elif found:
        Console().print(_table(found, socket))
        for note in notes:
            print(note)
    if interrupted:
        raise RunError(f"{port}: interrupted after {len(first)} of {len(steps)} steps; scan again for the rest")
    if not found and not json_:
        raise RunError(
            f"{port}: nobody answered in {len(first)} steps of protocol and bit rate; check power, cable and the "
            "adapter's direction control, and that the port is the servos'"
        )
    return 0 if found else 1


def _scan(port: str, steps: Sequence[tuple[Any, int]], ids: Sequence[int]) -> tuple[list[Step], bool]:
    """Return what was asked, and whether somebody interrupted it; say on the way how it goes."""
    console = Console(stderr=True)
    asked: list[Step] = []
    try:
        with console.status("", spinner="line") as status:
            for step in scan(lambda baud: SerialPort(port, baud), steps, ids):
                if step.found is None:
                    how = step.framing if step.framing == "dynamixel-2.0" else "dynamixel-1.0 and feetech"
                    where = "once more" if step.again else f"{len(asked) + 1}/{len(steps)}"
                    count = len(found_servos(asked))
                    status.update(f"{where}: {how} at {step.baud} bit/s, {count} found")
                    continue
                asked.append(step)
    except KeyboardInterrupt:
        return asked, True
    return asked, False


def _numbers(option: str, text: str | None, low: int, high: int) -> list[int]:
    """Return the numbers of a list with ranges, as 1-8,20."""
    if text is None:
        return []
    numbers: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,10})(?:-(\d{1,10}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if not low <= first <= last <= high or (match and match[2] and high > ID_MAX):
            shape = "1-8,20" if high == ID_MAX else "57600,1000000"
            raise InputError(f"{option} {text}: '{part}' is no number from {low} to {high}; write it as {shape}")
        numbers.update(range(first, last + 1))
    return sorted(numbers)


def _table(found: Sequence[Found], socket: bool) -> Table:
    mixed = len({(servo.protocol, servo.baud) for servo in found}) > 1
    table = Table("id", "servo", "model", *(("protocol", "baud") if mixed else ()), "delay", "°C", "V", "notes")
    for servo in found:
        told = _described(servo, socket)
        table.add_row(
            str(servo.id),
            " or ".join(servo.products) or "unknown",
            str(servo.model or "-"),
            *((servo.protocol, str(told["baud"] or "-")) if mixed else ()),
            _shown(told["return_delay_us"], "{:.0f} us"),
            _shown(told["temperature_c"], "{:.0f}"),
            _shown(told["voltage_v"], "{:.1f}"),
            ", ".join(told["notes"]),
        )
    return table


def _described(servo: Found, socket: bool) -> dict[str, Any]:
    """Return a servo as JSON."""
    told: dict[str, Any] = {
        "id": servo.id,
        "protocol": servo.protocol,
        "baud": None if socket else servo.baud,
        "model": servo.model or None,
        "products": list(servo.products),
        "shared_id": servo.shared,
    }
    told |= dict.fromkeys(("return_delay_us", "temperature_c", "voltage_v", "torque"))
    notes = ["shares its id"] if servo.shared else [] if servo.products else ["model not known here"]
    if servo.values:
        product = PRODUCTS[servo.products[0]]
        family, table, values = family_of(product), registers(product), servo.values
        told["baud"] = family.bauds.get(values[family.baud_rate]) if socket else servo.baud
        told["return_delay_us"] = round(1e6 * values[family.return_delay] * table[family.return_delay].scale)
        told["temperature_c"] = values[family.temperature]
        told["voltage_v"] = round(values[family.voltage] * table[family.voltage].scale, 1)
        told["torque"] = bool(values[family.torque_enable])
        notes += ["torque on"] if told["torque"] else []
        if values[family.status_level] != family.status_level_all:
            notes.append("does not answer everything")
        bits = values[family.hardware_error] if family.hardware_error else 0
        notes += family.errors(bits)
    return told | {"notes": notes, "registers": dict(servo.values)}


def _notes(port: str, found: Sequence[Found], rigs: Sequence[str], socket: bool) -> list[str]:
    """Return what to know about the bus as a whole, a sentence each."""
    notes = []
    groups = sorted({(servo.protocol, servo.baud) for servo in found})
    where = " and ".join(protocol if socket else f"{protocol} at {baud} bit/s" for protocol, baud in groups)
    if found:
        notes.append(f"{len(found)} servo{'s' if len(found) > 1 else ''} on {port}: {where}.")
    if len(groups) > 1:
        notes.append("One rig needs one protocol and one bit rate; set all servos alike.")
    for servo in found:
        if servo.shared:
            notes.append(f"Several servos answer to id {servo.id}; connect them one by one and give each its own id.")
    if rigs:
        notes.append(f"They fit rig {' and '.join(rigs)}: servolve rig check {rigs[0]} --port {port}")
    return notes


def _rigs(found: Sequence[Found]) -> list[str]:
    """Return the shipped rigs whose servos these are."""
    there = {servo.id: servo.products for servo in found if not servo.shared}
    rates = {servo.baud for servo in found}
    fitting = []
    for name in rig_names():
        rig = load_rig(name)
        ids = {joint.id: joint.product.name for joint in rig.joints}
        if rig.simulated_only or ids.keys() != there.keys() or len(rates) != 1:
            continue
        if all(product in there[servo] for servo, product in ids.items()):
            fitting.append(name)
    return fitting


def _shown(value: float | None, pattern: str) -> str:
    return "-" if value is None else pattern.format(value)
