"""`servolve rig calibrate`: where a rig's joints have their zero and how far they go, into a rig file of its own."""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.live import Live
from rich.table import Table

from controller.errors import InputError, RunError
from controller.families import family_of
from controller.registers import registers
from controller.rig import Joint, Rig
from controller.rig_file import load_rig, parse_rig, require_bus, rig_names
from deploy.buses.servo_bus import ServoBus
from deploy.clock import RealClock
from deploy.commissioning.calibration import (
    MARGIN_RAD,
    Travel,
    calibrate_joint,
    exported_motor,
    imported_travel,
)
from deploy.commissioning.lerobot import MotorCalibration, calibration_text, read_calibration
from deploy.commissioning.range_recorder import read_counts, record_travel
from deploy.commissioning.toml_edit import set_values
from deploy.joint_counts import count_limits
from deploy.stop_request import StopRequest
from deploy.torque import release, unsure_sentence
from servolve.rehome import Pose, centred, rehome
from servolve.rig_bus import PATIENCE_S, rig_bus

_KEYS = ("zero_tick", "low_rad", "high_rad")


def calibrate(
    rig: str,
    /,
    *,
    port: str | None = None,
    neutral: Annotated[bool, Parameter(negative="")] = False,
    range_: Annotated[float | None, Parameter(name="--range")] = None,
    middle: Annotated[bool, Parameter(negative="")] = False,
    center: Annotated[bool, Parameter(negative="")] = False,
    margin: float = MARGIN_RAD,
    joints: str | None = None,
    import_: Annotated[Path | None, Parameter(name="--import")] = None,
    export: Path | None = None,
    out: Path | None = None,
    backup: Path | None = None,
    yes: Annotated[bool, Parameter(negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> int:
    """Calibrate a rig: record zeros and travel, and write them into a copy of its rig file.

    With --neutral or --range the torque of all servos goes off first: hold the robot. Nothing that outlasts power is
    written to a servo, but by --center.

    Args:
        rig: name that `servolve rig list` prints, or path of a rig file
        port: serial device, or socket://HOST:PORT; may be left out where no servo is asked
        neutral: the joints stand at their neutral angles now: take their zeros from that
        range_: for so long move every joint from stop to stop by hand: take the limits from that [s]
        middle: put angle 0 in the middle of the travel
        center: re-home the servos so that the encoder's wrap is outside the travel (STS3215), with consent
        margin: how far inside the travel the limits lie [rad]
        joints: calibrate these only, as a0,a2
        import_: LeRobot calibration file to take the travel from
        export: LeRobot calibration file to write
        out: rig file to write; comments and order are kept
        backup: where --center keeps what the servos held; left out: a new file in this folder
        yes: agree to --center without being asked
        json_: print one JSON object

    Returns:
        exit status
    """
    about = load_rig(rig)
    require_bus(about, "calibration")
    asked = neutral or range_ is not None or center
    _check_options(about, port, asked, range_, middle, center, margin, import_, export, backup, yes, json_)
    for file in (out, export):
        _refuse_existing(file, about)
    poses = [Pose(joint) for joint in _chosen(about, joints)]
    motors = read_calibration(import_) if import_ else {}
    console = Console(stderr=json_)
    with _maybe_bus(about, port) as bus:
        if bus is not None:
            for pose in poses:
                pose.settings = _settings(bus, pose.joint)
        if bus is not None and asked:
            _release(bus, about, console)
            stand = read_counts(bus, [pose.joint for pose in poses])
            if neutral:
                for pose in poses:
                    pose.at = stand[pose.joint.name]
            if range_ is not None:
                _record(bus, poses, stand, range_, console)
            if center:
                fixes, poses = centred(poses, middle, margin)
                rehome(bus, about, port or "", fixes, backup, yes, console)
        for pose in poses:
            if motors:
                pose.travel = _imported(pose, motors, import_, asked=bus is not None)
    changes = {
        pose.joint.name: calibrate_joint(pose.joint, at=pose.at, travel=pose.travel, middle=middle, margin_rad=margin)
        for pose in poses
    }
    made = _edited(about, changes, out or about.path)
    if out:
        _write(out, made.text)
    if export:
        _write(export, calibration_text(_exported(made, poses)))
    _tell(about, made, changes, console, out, export, json_)
    return 0


def _check_options(
    rig: Rig,
    port: str | None,
    asked: bool,
    range_: float | None,
    middle: bool,
    center: bool,
    margin: float,
    import_: Path | None,
    export: Path | None,
    backup: Path | None,
    yes: bool,
    json_: bool,
) -> None:
    if not (asked or import_ or export):
        raise InputError(
            f"rig {rig.name}: nothing is asked for; give --neutral, --range SECONDS, --import FILE or --export FILE"
        )
    if asked and port is None:
        raise InputError(f"rig {rig.name}: --neutral, --range and --center read the servos; name their --port")
    if range_ is not None and not 0.0 < range_ < math.inf:
        raise InputError(f"--range {range_:g}: is no time to move the joints in; give seconds above 0")
    if range_ is not None and import_ is not None:
        raise InputError("--range and --import: both say how far the joints travel; choose one of them")
    if middle and range_ is None and import_ is None:
        raise InputError("--middle: needs a travel to be in the middle of; add --range SECONDS or --import FILE")
    if center and range_ is None:
        raise InputError("--center: needs to know the travel; add --range SECONDS")
    if not 0.0 <= margin < math.pi:
        raise InputError(f"--margin {margin:g}: is no angle to keep from the stops; give radians from 0, as 0.02")
    if (backup or yes) and not center:
        raise InputError(f"{'--backup' if backup else '--yes'}: means nothing without --center; leave it out")
    if center and not yes and (json_ or not sys.stdin.isatty()):
        raise InputError("--center asks before it writes, and there is nobody to ask; add --yes to agree")


def _refuse_existing(file: Path | None, rig: Rig) -> None:
    if file is None:
        return
    shipped = {load_rig(name).path.resolve() for name in rig_names()}
    own = file.resolve() == rig.path.resolve() and file.resolve() not in shipped
    if file.exists() and not own:
        raise InputError(f"{file}: is there already; name a new file")
    if not file.parent.is_dir():
        raise InputError(f"{file}: its folder is not there; make it, or name another file")


def _chosen(rig: Rig, names: str | None) -> list[Joint]:
    if names is None:
        return list(rig.joints)
    wanted = [name.strip() for name in names.split(",")]
    known = {joint.name: joint for joint in rig.joints}
    for name in wanted:
        if name not in known:
            raise InputError(f"--joints {names}: there is no joint '{name}'; the rig has {', '.join(known)}")
    return [joint for joint in rig.joints if joint.name in wanted]


@contextmanager
def _maybe_bus(rig: Rig, port: str | None) -> Iterator[ServoBus | None]:
    if port is None:
        yield None
        return
    with rig_bus(rig, port, "calibration", PATIENCE_S) as bus:
        yield bus


def _settings(bus: ServoBus, joint: Joint) -> dict[str, int]:
    """Read what moves a servo's counts, and see that it is the servo that the rig says."""
    table = registers(joint.product)
    model = bus.read_register(joint.id, table[family_of(joint.product).model_number])
    if model != joint.product.model_number:
        raise InputError(
            f"joint {joint.name} (servo {joint.id}): is a model {model}, the rig says {joint.product.name}; connect "
            "the right servo or correct the rig"
        )
    names = [name for name in ("homing_offset", "drive_mode") if name in table]
    return {name: bus.read_register(joint.id, table[name]) for name in names}


def _release(bus: ServoBus, rig: Rig, console: Console) -> None:
    console.print("torque goes off", highlight=False)
    left = release(bus, rig, RealClock())
    if left:
        raise RunError(unsure_sentence(left))


def _record(bus: ServoBus, poses: Sequence[Pose], stand: Mapping[str, int], seconds: float, console: Console) -> None:
    joints = [pose.joint for pose in poses]
    console.print(
        f"move {', '.join(joint.name for joint in joints)} from stop to stop for {seconds:g} s; q ends it early, "
        "Ctrl-C gives it up",
        highlight=False,
    )
    with StopRequest() as stop, Live(console=console, auto_refresh=False, transient=True) as live:

        def watch(travels: Mapping[str, Travel], left_s: float) -> bool:
            if console.is_terminal:
                live.update(_progress(joints, travels, left_s), refresh=True)
            return stop.reason() is None

        travels = record_travel(bus, joints, RealClock(), stand, seconds, watch)
        reason = stop.reason()
    if reason is not None and "key" not in reason:
        raise RunError("the recording was given up; nothing was written")
    for pose in poses:
        pose.travel = travels[pose.joint.name]


def _progress(joints: Sequence[Joint], travels: Mapping[str, Travel], left_s: float) -> Table:
    table = Table("joint", title=f"{left_s:.0f} s left", title_justify="left")
    for name in ("lowest", "now", "highest", "rad"):
        table.add_column(name, justify="right")
    for joint in joints:
        travel = travels[joint.name]
        span = (travel.high - travel.low) * 2.0 * math.pi / joint.product.ticks_per_turn
        table.add_row(joint.name, str(travel.low), str(travel.last), str(travel.high), f"{span:.2f}")
    return table


def _imported(pose: Pose, motors: Mapping[str, MotorCalibration], file: Path | None, asked: bool) -> Travel:
    joint = pose.joint
    found = next((motor for motor in motors.values() if motor.id == joint.id), None)
    named = motors.get(joint.name)
    if named is not None and named.id != joint.id:
        raise InputError(
            f"{file}: motor '{joint.name}' has id {named.id}, the rig says {joint.id}; correct one of them"
        )
    if found is None:
        raise InputError(
            f"{file}: holds no motor with id {joint.id} (joint {joint.name}); name the joints with --joints"
        )
    family = family_of(joint.product)
    held = pose.settings.get("homing_offset") if family.homing_offset else None
    if family.homing_offset and not asked:
        # without a servo to ask: as the loop needs it, or as the file says that it is
        held = dict(family.settings).get(family.homing_offset, found.homing_offset)
        pose.settings = {**pose.settings, "homing_offset": held}
    return imported_travel(joint, found, held)


def _edited(rig: Rig, changes: Mapping[str, Mapping[str, int | float]], path: Path) -> Rig:
    """Return the rig with the changes in its text; it is read again, so that it is a rig that loads."""
    text = rig.text
    for index, joint in enumerate(rig.joints):
        if changes.get(joint.name):
            text = set_values(text, str(rig.path), "joint", index, changes[joint.name])
    body = os.path.relpath(rig.body, path.resolve().parent)
    if path.resolve().parent != rig.path.resolve().parent:
        text = set_values(text, str(rig.path), "rig", 0, {"body": body})
    return replace(parse_rig(text, path), body=rig.body)


def _exported(rig: Rig, poses: Sequence[Pose]) -> dict[str, MotorCalibration]:
    settings = {pose.joint.name: pose.settings for pose in poses}
    joints = [joint for joint in rig.joints if joint.name in settings]
    for joint in joints:
        if joint.unlimited:
            raise InputError(
                f"joint {joint.name}: may turn for ever and has no range to export; leave it out of --joints"
            )
    return {joint.name: exported_motor(joint, count_limits(joint), settings[joint.name]) for joint in joints}


def _write(path: Path, text: str) -> None:
    """Replace or make a file, whole or not at all."""
    try:
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            umask = os.umask(0)
            os.umask(umask)
            Path(name).chmod(0o666 & ~umask)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise RunError(f"{path}: can not be written ({error.strerror}); name another file") from None


def _tell(
    rig: Rig,
    made: Rig,
    changes: Mapping[str, Mapping[str, int | float]],
    console: Console,
    out: Path | None,
    export: Path | None,
    as_json: bool,
) -> None:
    if as_json:
        told: dict[str, Any] = {
            "rig": rig.name,
            "joints": {name: dict(values) for name, values in changes.items()},
            "out": None if out is None else str(out),
            "export": None if export is None else str(export),
        }
        print(json.dumps(told))
        return
    if any(changes.values()):
        table = Table("joint", *_KEYS)
        for before, after in zip(rig.joints, made.joints, strict=True):
            cells = []
            for key in _KEYS:
                old, new = getattr(before, key), getattr(after, key)
                cells.append(f"{old:g}" if old == new else f"{old:g} -> {new:g}")
            table.add_row(before.name, *cells)
        console.print(table)
    if out:
        console.print(f"{out} is the calibrated rig", highlight=False, soft_wrap=True)
    elif any(changes.values()):
        console.print("nothing was written; add --out FILE.rig.toml to keep it", highlight=False)
    if export:
        console.print(f"{export} is its LeRobot calibration", highlight=False, soft_wrap=True)
