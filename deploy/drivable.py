"""What deployment can not drive, refused before anything is opened."""

from __future__ import annotations

from controller.rig import Rig
from controller.rig_file import require_bus


def require_drivable(rig: Rig) -> None:
    """Refuse a rig that the host loop and the virtual servos can not drive.

    Args:
        rig: the rig

    Raises:
        InputError: it has no bus
    """
    require_bus(rig, "deployment")
