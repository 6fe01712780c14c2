"""What deployment can not drive, refused before anything is opened."""

from __future__ import annotations

from controller.errors import InputError
from controller.rig import Rig
from controller.rig_file import require_bus


def require_drivable(rig: Rig) -> None:
    """Refuse a rig that the host loop and the virtual servos can not drive.

    Args:
        rig: the rig

    Raises:
        InputError: it has no bus, or a joint in velocity mode
    """
    require_bus(rig, "deployment")
    for joint in rig.joints:
        if joint.mode == "velocity":
            raise InputError(
                f"rig {rig.name}: joint {joint.name} is in velocity mode, which deployment does not drive; "
                "choose a rig whose joints are all in position mode"
            )
