"""Show how each servo of a rig is, as a check has read it: for `servolve rig check` and a dry run of `deploy`."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table

from deploy.buses.reading import Reading


def reading_table(readings: Sequence[Reading]) -> Table:
    """Return a table of what was read, a line for each servo.

    Args:
        readings: of each servo; a "-" stands for what could not be read
    """
    table = Table("joint", "servo", "product")
    for name in ("count", "rad", "V", "°C"):
        table.add_column(name, justify="right")
    table.add_column("torque")
    table.add_column("errors")
    for reading in readings:
        joint = reading.joint
        table.add_row(
            joint.name,
            str(joint.id),
            joint.product.name,
            str(reading.values.get(joint.family.position, "-")),
            _shown(reading.angle_rad, "+.3f"),
            _shown(reading.supply_v, ".1f"),
            _shown(reading.temperature_c, ".0f"),
            reading.torque,
            ", ".join(reading.errors) or ("none" if reading.values else "-"),
        )
    return table


def _shown(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
