"""`servolve rig check`: what keeps a rig from being driven, and, with consent, the registers that settle it."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table
from rich.text import Text

from controller.errors import InputError, RunError
from controller.families import family_of
from controller.products import PRODUCTS
from controller.rig import Rig
from controller.rig_file import load_rig
from deploy.buses.reading import Reading
from deploy.buses.sensor_port import SensorPort
from deploy.buses.sensor_reader import SensorReader
from deploy.buses.servo_bus import BusError, ServoBus
from deploy.buses.usb_latency import shorten_timer, slow_timer
from deploy.checks import check_sensors, check_servos
from deploy.commissioning.fix import apply_fixes, find_baud, read_backup, restoring
from deploy.commissioning.servo_backup import ServoBackup, load_backup, save_backup
from deploy.finding import Finding, Fix
from deploy.servo_findings import setting_findings
from servolve.reading_table import reading_table
from servolve.rig_bus import PATIENCE_S, rig_bus
from servolve.rig_consent import agreed, backup_path, restore_command

LISTEN_S: Final = 1.0
_POLL_S: Final = 0.02


@dataclass(frozen=True)
class _Survey:
    """Hold what a check found.

    Args:
        readings: of each servo
        findings: what is wrong
        elsewhere: id => bit rate of servos that answer at another one than the rig's
    """

    readings: tuple[Reading, ...]
    findings: tuple[Finding, ...]
    elsewhere: dict[int, int]

    @property
    def errors(self) -> int:
        """Return how many findings forbid to arm."""
        return sum(finding.level == "error" for finding in self.findings)

    @property
    def fixes(self) -> list[Fix]:
        """Return the registers that would settle findings."""
        return [finding.fix for finding in self.findings if finding.fix is not None]


def check(
    rig: str,
    /,
    *,
    port: str,
    sensor_port: str | None = None,
    fix: Annotated[bool, Parameter(negative="")] = False,
    restore: Path | None = None,
    backup: Path | None = None,
    yes: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Check a rig as a run does before it arms: every servo's settings and state, what is wrong, what to change.

    Without --fix and --restore nothing is written to a servo. With them it says what would be changed, asks, backs up
    every register of the servos concerned, switches their torque off, and changes one register after the other.

    Args:
        rig: name that `servolve rig list` prints, or path of a rig file
        port: serial device, or socket://HOST:PORT
        sensor_port: serial device or socket of the sensor node, to check it too
        fix: change the registers that settle what was found
        restore: backup file whose registers are to be put back
        backup: where --fix and --restore keep what the servos held; left out: a new file in this folder
        yes: agree to the changes without being asked
        json_: print one JSON object

    Returns:
        exit status; 1 if the rig is not ready, unless it was to be put back
    """
    about = load_rig(rig)
    if fix and restore:
        raise InputError("--fix and --restore: one changes what the other puts back; choose one of them")
    if (yes or backup) and not (fix or restore):
        raise InputError(f"{'--yes' if yes else '--backup'}: means nothing without --fix or --restore; leave it out")
    if (fix or restore) and not yes and (json_ or not sys.stdin.isatty()):
        raise InputError("--fix and --restore ask before they write, and there is nobody to ask; add --yes to agree")
    saved = load_backup(restore) if restore else ()
    console = Console(stderr=json_)
    kept: Path | None = None
    made: list[Fix] = []
    with rig_bus(about, port, "a check", PATIENCE_S) as bus:
        survey = _survey(bus, about, sensor_port)
        _show(console, about, port, survey)
        if fix:
            _shorten(console, port, yes)
        if fix or restore:
            held = _held(bus, about, survey, saved, None if restore else survey.fixes)
            fixes = _putting_back(saved, held) if restore else survey.fixes
            if fixes and agreed(console, about, fixes, yes):
                kept = backup or backup_path(about.name)
                save_backup(kept, about.name, held)
                _change(bus, about, port, held, fixes, kept, made, console)
                survey = _survey(bus, about, sensor_port)
                _show(console, about, port, survey)
    if json_:
        print(json.dumps(_told(about, port, survey, made, kept)))
    if restore:
        return 0
    if survey.errors:
        raise RunError(_not_ready(about, survey, fixing=fix))
    console.print(f"{about.name} is ready", highlight=False)
    return 0


def _survey(bus: ServoBus, rig: Rig, sensor_port: str | None) -> _Survey:
    readings, findings = check_servos(bus, rig)
    elsewhere: dict[int, int] = {}
    for number, reading in enumerate(readings):
        joint = reading.joint
        if reading.values or bus.ping(joint.id)[0].status == "data":
            continue
        baud = find_baud(bus, rig, joint.id, joint.product)
        if baud is None:
            continue
        try:
            values = read_backup(bus, rig, joint.id, joint.product, baud).values
        except BusError:
            continue
        elsewhere[joint.id] = baud
        readings[number] = Reading(joint, values)
        named = f"joint {joint.name} (servo {joint.id})"
        findings = [finding for finding in findings if not finding.text.startswith(f"{named}:")]
        findings += [_told_where(rig, named, baud, finding) for finding in setting_findings(rig, joint, values)]
    if sensor_port is not None:
        findings += _listen(rig, sensor_port)
    return _Survey(tuple(readings), tuple(sorted(findings, key=lambda finding: finding.level)), elsewhere)


def _told_where(rig: Rig, named: str, baud: int, finding: Finding) -> Finding:
    """Say of a servo's bit rate that this is how it answers."""
    if finding.fix is None or finding.fix.register != "baud_rate":
        return finding
    text = f"{named}: answers at {baud} baud, not at the rig's {rig.bus.baud}; set baud_rate to {finding.fix.want}"
    return Finding(finding.level, text, finding.fix)


def _listen(rig: Rig, sensor_port: str) -> list[Finding]:
    reader = SensorReader(rig.sensors)
    with closing(SensorPort(sensor_port)) as port:
        until = time.monotonic() + LISTEN_S
        while time.monotonic() < until:
            reader.feed(port.read_available(), time.monotonic())
            time.sleep(_POLL_S)
        reader.feed(port.read_available(), time.monotonic())
    return check_sensors(rig, reader, frozenset(range(len(rig.sensors))), time.monotonic())


def _shorten(console: Console, port: str, yes: bool) -> None:
    """Let a USB adapter hand replies over sooner, with consent."""
    timer = slow_timer(port)
    if timer is None:
        return
    question = f"Set the USB adapter's latency timer to 1 ms, from {timer.read_text().strip()}? \\[y/N] "
    if yes or console.input(question).strip().lower() in ("y", "yes"):
        shorten_timer(timer)
        console.print("latency timer: 1 ms until the adapter is unplugged", highlight=False)


def _held(
    bus: ServoBus, rig: Rig, survey: _Survey, saved: Sequence[ServoBackup], fixes: Sequence[Fix] | None
) -> list[ServoBackup]:
    """Read all that the servos hold that are to be changed: those of the fixes, or those of a backup file."""
    held = []
    if fixes is not None:
        for joint in rig.joints:
            if any(fix.servo == joint.id for fix in fixes):
                baud = survey.elsewhere.get(joint.id, rig.bus.baud)
                held.append(read_backup(bus, rig, joint.id, joint.product, baud))
        return held
    for servo in saved:
        product = PRODUCTS[servo.product]
        if family_of(product).bus_protocol != rig.bus.protocol:
            raise InputError(
                f"the backup is of a {servo.product}, which does not speak {rig.bus.protocol}; name its rig"
            )
        there = bus.ping(servo.id)[0].status == "data"
        baud = rig.bus.baud if there else find_baud(bus, rig, servo.id, product) or rig.bus.baud
        held.append(read_backup(bus, rig, servo.id, product, baud))
    return held


def _putting_back(saved: Sequence[ServoBackup], held: Sequence[ServoBackup]) -> list[Fix]:
    return [fix for old, now in zip(saved, held, strict=True) for fix in restoring(old, now.values)]


def _change(
    bus: ServoBus,
    rig: Rig,
    port: str,
    held: Sequence[ServoBackup],
    fixes: Sequence[Fix],
    kept: Path,
    made: list[Fix],
    console: Console,
) -> None:
    undo = restore_command(rig, port, kept)

    def told(fix: Fix) -> None:
        made.append(fix)
        console.print(f"servo {fix.servo}: {fix.register} {fix.held} -> {fix.want}", highlight=False)

    try:
        apply_fixes(bus, rig, held, fixes, told)
    except RunError as error:
        raise RunError(f"{error}; `{undo}` puts all of it back") from None
    console.print(f"{len(made)} changed; what was there before is in {kept}: `{undo}` puts it back", soft_wrap=True)


def _show(console: Console, rig: Rig, port: str, survey: _Survey) -> None:
    console.print(f"rig {rig.name} on {port}, {rig.bus.protocol} at {rig.bus.baud} bit/s", highlight=False)
    console.print(reading_table(survey.readings))
    if not survey.findings:
        return
    table = Table("", "found; what to change", "--fix writes")
    for finding in survey.findings:
        style = "red" if finding.level == "error" else "yellow"
        fix = finding.fix
        change = "" if fix is None else f"{fix.register} {fix.held} -> {fix.want}"
        table.add_row(Text(finding.level, style=style), Text(finding.text), change)
    console.print(table)


def _not_ready(rig: Rig, survey: _Survey, fixing: bool) -> str:
    count = f"{survey.errors} error{'s' if survey.errors > 1 else ''}"
    if survey.fixes and not fixing:
        return f"rig {rig.name} is not ready: {count}; change what the table says, or let --fix write the registers"
    return f"rig {rig.name} is not ready: {count}; change what the table says"


def _told(rig: Rig, port: str, survey: _Survey, made: Sequence[Fix], kept: Path | None) -> dict[str, Any]:
    """Return it all as JSON."""
    return {
        "rig": rig.name,
        "port": port,
        "ready": survey.errors == 0,
        "findings": [
            {
                "level": finding.level,
                "text": finding.text,
                "fix": None if finding.fix is None else dict(finding.fix.message()),
            }
            for finding in survey.findings
        ],
        "servos": [
            {"joint": reading.joint.name, "id": reading.joint.id, "registers": dict(reading.values)}
            for reading in survey.readings
        ],
        "changed": [dict(fix.message()) for fix in made],
        "backup": None if kept is None else str(kept),
    }
