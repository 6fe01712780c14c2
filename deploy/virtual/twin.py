"""A twin: how the virtual rig's physics differ from the simulation's, as reality would."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from controller.toml_table import read_toml


@dataclass(frozen=True)
class Twin:
    """Say how the virtual rig differs from the rig's simulation; scale 1 and noise 0: not at all.

    Args:
        name: what to call it
        text: the file's own text, to be embedded in logs
        torque_scale: stall torque of every servo over the datasheet's, at the same no-load speed
        p_gain_scale: what the position P gain register means, over what the product says
        friction_scale: friction of floor and feet
        mass_scale: mass and inertia of every body
        joint_friction_scale: dry friction of every joint
        joint_damping_scale: viscous friction of every joint
        armature_scale: rotor inertia of every servo
        stiction_scale: dry friction at standstill over dry friction in motion
        stiction_speed_rad_s: speed at which the excess of stiction has fallen to 1 / e [rad/s]
        command_latency_s: time from a goal's arrival to its effect [s]
        supply_v: supply voltage [V]; 0: the rig's
        timestep_s: step of the physics [s]; 0: the virtual rig's own
        force_noise_n: standard deviation of the force's noise [N]
        position_noise_m: standard deviation of the noise of x, y, z [m]
        angle_noise_rad: standard deviation of the noise of heading, roll, pitch [rad]
    """

    name: str = "none"
    text: str = ""
    torque_scale: float = 1.0
    p_gain_scale: float = 1.0
    friction_scale: float = 1.0
    mass_scale: float = 1.0
    joint_friction_scale: float = 1.0
    joint_damping_scale: float = 1.0
    armature_scale: float = 1.0
    stiction_scale: float = 1.0
    stiction_speed_rad_s: float = 0.1
    command_latency_s: float = 0.0
    supply_v: float = 0.0
    timestep_s: float = 0.0
    force_noise_n: float = 0.0
    position_noise_m: float = 0.0
    angle_noise_rad: float = 0.0


_RANGES: dict[str, tuple[float, float]] = {
    "torque_scale": (0.05, 5.0),
    "p_gain_scale": (0.05, 5.0),
    "friction_scale": (0.05, 5.0),
    "mass_scale": (0.2, 5.0),
    "joint_friction_scale": (0.0, 20.0),
    "joint_damping_scale": (0.0, 20.0),
    "armature_scale": (0.1, 10.0),
    "stiction_scale": (1.0, 10.0),
    "stiction_speed_rad_s": (1e-3, 10.0),
    "command_latency_s": (0.0, 0.5),
    "supply_v": (0.0, 30.0),
    "timestep_s": (0.0, 0.005),
    "force_noise_n": (0.0, 10.0),
    "position_noise_m": (0.0, 0.1),
    "angle_noise_rad": (0.0, 1.0),
}


def _shipped() -> dict[str, Path]:
    return {path.stem: path for path in sorted((Path(__file__).parent / "twins").glob("*.toml"))}


def twin_names() -> tuple[str, ...]:
    """Return the names of the twins that come with servolve, sorted."""
    return tuple(sorted(_shipped()))


def load_twin(name_or_path: str | Path) -> Twin:
    """Load a twin.

    Args:
        name_or_path: a name that `twin_names` lists, or the path of a twin file

    Returns:
        the twin

    Raises:
        InputError: it can not be read, or something in it is wrong
    """
    top = read_toml(_shipped().get(str(name_or_path), Path(name_or_path)), "twin file")
    top.refuse_unknown(("format", "twin"))
    table = top.table("twin")
    table.refuse_unknown(field.name for field in fields(Twin) if field.name != "text")
    values = {key: table.number(key, *_RANGES[key]) for key in table.values if key in _RANGES}
    return Twin(name=table.name_value("name"), text=top.text, **values)
