"""Re-home servos: give each the homing offset that puts its encoder's wrap outside its joint's travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from controller.errors import RunError
from controller.rig import Joint, Rig
from deploy.buses.servo_bus import ServoBus
from deploy.commissioning.calibration import Travel, calibrate_joint, centred_offset, shifted
from deploy.commissioning.fix import apply_fixes, read_backup
from deploy.commissioning.servo_backup import save_backup
from deploy.finding import Fix
from servolve.rig_consent import agreed, backup_path, restore_command


@dataclass
class Pose:
    """Hold what a calibration knows of one joint.

    Args:
        joint: as the rig file has it
        settings: what its servo holds of "homing_offset" and "drive_mode"
        at: count where it stands at its neutral angle, or None
        travel: how far it goes, or None
    """

    joint: Joint
    settings: dict[str, int] = field(default_factory=dict)
    at: int | None = None
    travel: Travel | None = None


def centred(poses: Sequence[Pose], middle: bool, margin_rad: float) -> tuple[list[Fix], list[Pose]]:
    """Return the homing offsets that servos need, and the poses as the servos will report them then.

    Args:
        poses: of joints whose travel is known
        middle: whether the middle of the travel is angle 0
        margin_rad: how far inside the travel the limits lie [rad]

    Returns:
        what to change, and the poses afterwards

    Raises:
        InputError: a servo can not be re-homed, or could not be calibrated even then
    """
    fixes, after = [], []
    for pose in poses:
        assert pose.travel is not None
        held = pose.settings.get("homing_offset", 0)
        offset = centred_offset(pose.joint, pose.travel, held)
        travel = shifted(pose.joint, pose.travel, held, offset)
        at = None if pose.at is None else pose.at + travel.low - pose.travel.low
        # what can not be calibrated is refused before anything is written
        calibrate_joint(pose.joint, at=at, travel=travel, middle=middle, margin_rad=margin_rad)
        after.append(Pose(pose.joint, pose.settings | {"homing_offset": offset}, at, travel))
        if offset != held:
            fixes.append(Fix(pose.joint.id, "homing_offset", held, offset, "puts the wrap outside the travel"))
    return fixes, after


def rehome(
    bus: ServoBus, rig: Rig, port: str, fixes: Sequence[Fix], backup: Path | None, yes: bool, console: Console
) -> None:
    """Write homing offsets, with consent and a backup.

    Args:
        bus: the rig's bus
        rig: the rig
        port: its port, for the command that undoes it
        fixes: as `centred` returns them
        backup: where to keep what the servos held; None: a new file in this folder
        yes: whether somebody has agreed already
        console: where to show and ask

    Raises:
        RunError: nobody agreed, or a servo did not take it
    """
    if not fixes:
        return
    if not agreed(console, rig, fixes, yes):
        raise RunError("the servos were not re-homed; nothing was written")
    joints = {joint.id: joint for joint in rig.joints}
    held = [read_backup(bus, rig, fix.servo, joints[fix.servo].product, rig.bus.baud) for fix in fixes]
    kept = backup or backup_path(rig.name)
    save_backup(kept, rig.name, held)
    undo = restore_command(rig, port, kept)
    try:
        apply_fixes(bus, rig, held, fixes, lambda _: None)
    except RunError as error:
        raise RunError(f"{error}; `{undo}` puts all of it back") from None
    console.print(f"re-homed; `{undo}` puts it back", soft_wrap=True)
