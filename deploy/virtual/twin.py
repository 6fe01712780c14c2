"""A twin: how the virtual rig's physics differ from the simulation's, as reality would."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from controller.errors import InputError
from controller.toml_table import Table, read_toml


@dataclass(frozen=True)
class JointTwin:
    """Say how one joint and its servo differ; scale 1 and bias 0: not at all.

    Args:
        torque_scale: stall torque over the datasheet's, at the same no-load speed
        torque_constant_scale: torque per current and back-EMF per speed over the datasheet's: stall torque grows with
            it, no-load speed falls
        p_gain_scale: what the position P gain register means, over what the product says
        d_gain_scale: what the position D gain register means, over what the product says
        joint_friction_scale: dry friction
        joint_damping_scale: viscous friction
        armature_scale: rotor inertia
        backlash_scale: play between gears over the product's; 0: none
        voltage_slope_scale: how fast the motor's voltage may change, over what the servo's register says; 0: at once
        encoder_bias_rad: how much too far the encoder is, in the rig's angle [rad]
    """

    torque_scale: float = 1.0
    torque_constant_scale: float = 1.0
    p_gain_scale: float = 1.0
    d_gain_scale: float = 1.0
    joint_friction_scale: float = 1.0
    joint_damping_scale: float = 1.0
    armature_scale: float = 1.0
    backlash_scale: float = 0.0
    voltage_slope_scale: float = 0.0
    encoder_bias_rad: float = 0.0


@dataclass(frozen=True)
class Twin(JointTwin):
    """Say how the virtual rig differs from the rig's simulation; scale 1, bias and noise 0: not at all.

    What it has in common with `JointTwin` is for every joint; a joint of `joints` has its own on top: scales are
    multiplied; biases, backlash and slope, which are 0 unless stated, added.

    Args:
        name: what to call it
        text: the file's own text, to be embedded in logs
        friction_scale: friction of floor and feet
        mass_scale: mass and inertia of every body
        com_x_m: how far forward the base's centre of mass is shifted [m]
        com_y_m: how far to its left [m]
        stiction_scale: dry friction at standstill over dry friction in motion
        stiction_speed_rad_s: speed at which the excess of stiction has fallen to 1 / e [rad/s]
        command_latency_s: time from a goal's arrival to its effect [s]
        supply_v: supply voltage [V]; 0: the rig's
        supply_scale: supply voltage without load over that
        supply_ohm: resistance of battery and wires, in which the servos' currents make the supply sag [ohm]
        timestep_s: step of the physics [s]; 0: the virtual rig's own
        force_noise_n: standard deviation of the force's noise [N]
        position_noise_m: standard deviation of the noise of x, y, z [m]
        angle_noise_rad: standard deviation of the noise of heading, roll, pitch [rad]
        force_bias_n: how much too high the force is [N]
        position_bias_m: how much too far x, y, z are [m]
        angle_bias_rad: how much too far heading, roll, pitch are [rad]
        sensor_latency_s: how much later than the rig says a sensor line arrives [s]
        joints: names of joints and what is their own
    """

    name: str = "none"
    text: str = ""
    friction_scale: float = 1.0
    mass_scale: float = 1.0
    com_x_m: float = 0.0
    com_y_m: float = 0.0
    stiction_scale: float = 1.0
    stiction_speed_rad_s: float = 0.1
    command_latency_s: float = 0.0
    supply_v: float = 0.0
    supply_scale: float = 1.0
    supply_ohm: float = 0.0
    timestep_s: float = 0.0
    force_noise_n: float = 0.0
    position_noise_m: float = 0.0
    angle_noise_rad: float = 0.0
    force_bias_n: float = 0.0
    position_bias_m: float = 0.0
    angle_bias_rad: float = 0.0
    sensor_latency_s: float = 0.0
    joints: tuple[tuple[str, JointTwin], ...] = ()

    def changes(self, key: str) -> bool:
        """Return whether a key has another value than in a twin that differs in nothing, for the rig or one joint.

        Args:
            key: name of a parameter
        """
        joints = [own for _, own in self.joints if key in JOINT_KEYS]
        return any(getattr(each, key) != getattr(type(each)(), key) for each in (self, *joints))

    def open_circuit_v(self, rated_v: float) -> float:
        """Return the supply voltage without load [V].

        Args:
            rated_v: the rig's [V]
        """
        return (self.supply_v or rated_v) * self.supply_scale

    def joint(self, name: str) -> JointTwin:
        """Return how a joint differs, in all.

        Args:
            name: the joint's
        """
        own = dict(self.joints).get(name, JointTwin())
        values = {}
        for key in JOINT_KEYS:
            every, only = getattr(self, key), getattr(own, key)
            values[key] = every + only if key in _ADDED else every * only
        return JointTwin(**values)


JOINT_KEYS: Final = tuple(field.name for field in fields(JointTwin))
"""Keys that a joint can have of its own."""

_ADDED: Final = ("backlash_scale", "voltage_slope_scale", "encoder_bias_rad")

_RANGES: Final[dict[str, tuple[float, float]]] = {
    "torque_scale": (0.05, 5.0),
    "torque_constant_scale": (0.2, 5.0),
    "p_gain_scale": (0.05, 5.0),
    "d_gain_scale": (0.0, 5.0),
    "joint_friction_scale": (0.0, 20.0),
    "joint_damping_scale": (0.0, 20.0),
    "armature_scale": (0.1, 10.0),
    "backlash_scale": (0.0, 20.0),
    "voltage_slope_scale": (0.0, 20.0),
    "encoder_bias_rad": (-0.5, 0.5),
    "friction_scale": (0.05, 5.0),
    "mass_scale": (0.2, 5.0),
    "com_x_m": (-0.05, 0.05),
    "com_y_m": (-0.05, 0.05),
    "stiction_scale": (1.0, 10.0),
    "stiction_speed_rad_s": (1e-3, 10.0),
    "command_latency_s": (0.0, 0.5),
    "supply_v": (0.0, 30.0),
    "supply_scale": (0.2, 2.0),
    "supply_ohm": (0.0, 10.0),
    "timestep_s": (0.0, 0.005),
    "force_noise_n": (0.0, 10.0),
    "position_noise_m": (0.0, 0.1),
    "angle_noise_rad": (0.0, 1.0),
    "force_bias_n": (-10.0, 10.0),
    "position_bias_m": (-0.1, 0.1),
    "angle_bias_rad": (-1.0, 1.0),
    "sensor_latency_s": (0.0, 0.5),
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
    path = _shipped().get(str(name_or_path), Path(name_or_path))
    if not path.exists():
        raise InputError(
            f"twin '{name_or_path}' is not known; choose one of {', '.join(twin_names())}, or give the path of a twin "
            "file"
        )
    top = read_toml(path, "twin file")
    top.refuse_unknown(("format", "twin", "joint"))
    table = top.table("twin")
    table.refuse_unknown(("name", *_RANGES))
    joints: dict[str, JointTwin] = {}
    for own in top.tables("joint"):
        own.refuse_unknown(("name", *JOINT_KEYS))
        name = own.name_value("name")
        if name in joints:
            own.fail("name", f"name '{name}' has a table already; write its keys there")
        joints[name] = JointTwin(**_numbers(own))
    return Twin(name=table.name_value("name"), text=top.text, joints=tuple(joints.items()), **_numbers(table))


def check_twin(twin: Twin, joints: Iterable[str], rig: str) -> None:
    """Check that a rig has the joints of a twin.

    Args:
        twin: the twin
        joints: names of the rig's joints
        rig: name of the rig

    Raises:
        InputError: it lacks one
    """
    known = tuple(joints)
    for name, _ in twin.joints:
        if name not in known:
            raise InputError(
                f"twin {twin.name}: rig {rig} has no joint '{name}'; name one of its joints: {', '.join(known)}"
            )


def _numbers(table: Table) -> dict[str, float]:
    return {key: table.number(key, *_RANGES[key]) for key in table.values if key in _RANGES}
