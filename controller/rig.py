"""A rig: the servos, sensors and limits of one robot, as its `rig.toml` states them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from controller.families import Family, family_of
from controller.products import IDEAL, Product


@dataclass(frozen=True)
class Joint:
    """Describe one servo joint.

    The product of a joint without a servo is `IDEAL`; it has no gains.

    Args:
        name: joint name, also the terminal of its angle and the name of its output
        mjcf_joint: name of the hinge in the body's MJCF
        id: servo id on the bus
        product: the servo
        sign: +1 or -1, rig angle against encoder direction
        zero_tick: encoder ticks at angle 0
        low_rad: lower limit of the angle, -inf for an unlimited joint [rad]
        high_rad: upper limit of the angle, inf for an unlimited joint [rad]
        neutral_rad: angle at rest, where homing goes [rad]
        gains: register name => count of the gains of its mode, which the loop writes and reads back
        ceiling: torque ceiling in counts of the register that sets it; all there is for a servo that has none
        mode: what is commanded, the joint's angle or its velocity
        unlimited: whether the joint may turn for ever
        speed_rad_s_max: fastest velocity that may be commanded, for mode "velocity" [rad/s]
    """

    name: str
    mjcf_joint: str
    id: int
    product: Product
    sign: int
    zero_tick: int
    low_rad: float
    high_rad: float
    neutral_rad: float
    gains: Mapping[str, int] = field(hash=False)
    ceiling: int
    mode: Literal["position", "velocity"] = "position"
    unlimited: bool = False
    speed_rad_s_max: float = 0.0

    @property
    def ideal(self) -> bool:
        """Return whether no servo drives it, but the actuator of the body's MJCF."""
        return self.product == IDEAL

    @property
    def family(self) -> Family:
        """Return the family of its servo."""
        return family_of(self.product)

    @property
    def p_gain(self) -> int:
        """Return the position P gain, 0 for a servo or mode without one."""
        return self._gain("position", "p_gain")

    @property
    def i_gain(self) -> int:
        """Return the position I gain, 0 for a servo or mode without one."""
        return self._gain("position", "i_gain")

    @property
    def d_gain(self) -> int:
        """Return the position D gain, 0 for a servo or mode without one."""
        return self._gain("position", "d_gain")

    @property
    def velocity_p_gain(self) -> int:
        """Return the velocity P gain, 0 for a servo or mode without one."""
        return self._gain("velocity", "velocity_p_gain")

    @property
    def velocity_i_gain(self) -> int:
        """Return the velocity I gain, 0 for a servo or mode without one."""
        return self._gain("velocity", "velocity_i_gain")

    @property
    def pwm_limit(self) -> int:
        """Return the torque ceiling."""
        return self.ceiling

    def _gain(self, mode: Literal["position", "velocity"], key: str) -> int:
        if self.ideal:
            return 0
        return self.gains.get(self.family.gains.get(mode, {}).get(key, ("",))[0], 0)


@dataclass(frozen=True)
class Sensor:
    """Describe one channel of the sensor node.

    Args:
        name: channel name; "x", "y", "z", "heading", "roll", "pitch" are the base pose, "vx", "vy", "vz" the base's
            velocity along its heading, to its left and up, "force" the base contact force
        message: letter of the line that carries it, as ``F`` in ``$F,<seq>,<t_us>,<raw…>*HH``
        field: position among the raw integers of that line, from 0
        unit: "N", "m", "m/s" or "rad"
        scale: SI per count
        zero: counts at 0 SI
        rate_hz: how often the node sends that line; it samples at multiples of 1 / rate_hz from t = 0
        latency_s: time from the sample to the last byte of its line [s]
        age_s_max: oldest value that counts as fresh [s]
        terminal: the terminal that reads it directly (as "s0"), or None
    """

    name: str
    message: str
    field: int
    unit: str
    scale: float
    zero: int
    rate_hz: float
    latency_s: float
    age_s_max: float
    terminal: str | None


@dataclass(frozen=True)
class Bus:
    """Describe the servo bus.

    Args:
        protocol: wire protocol, of Feetech's with its series; "none": the rig exists in simulation only
        baud: bits per second; 0 without a bus
        return_delay_us: status return delay of every servo, as its EEPROM must hold [us]
    """

    protocol: Literal["dynamixel-2.0", "dynamixel-1.0", "feetech-sts", "feetech-scs", "none"]
    baud: int
    return_delay_us: int


@dataclass(frozen=True)
class Safety:
    """Hold the limits and policies of the host loop and the firmware.

    Args:
        stop: what a servo does at the end: "off" (torque off) or "hold" (torque on at the last goal)
        homing_rad_s: speed of homing [rad/s]
        tracking_rad_max: largest |goal - angle| [rad] …
        tracking_s_max: … that may last so long [s]
        missed_cycles_max: replies of one servo that may be missing in a row
        temperature_c_max: stop above this [degrees Celsius]
        voltage_low_v: stop below this supply voltage [V]
        tilt_rad_max: stop when the base tilts more than this [rad]; 0: never
        overrun_cycles_max: periods in a row that may overrun
        watchdog_s: bus watchdog of the servos, 0: none [s]
    """

    stop: Literal["off", "hold"]
    homing_rad_s: float
    tracking_rad_max: float
    tracking_s_max: float
    missed_cycles_max: int
    temperature_c_max: float
    voltage_low_v: float
    tilt_rad_max: float
    overrun_cycles_max: int
    watchdog_s: float


@dataclass(frozen=True)
class Rig:
    """Describe one robot, everything in SI but the register values and ticks that say so.

    The raw channels of a rig, as the control cycle reads them, are in this order: position counts of each joint,
    velocity counts of each joint, load counts of each joint, sensors.

    Args:
        name: as `rig list` prints it
        path: the file it came from
        body: the MJCF beside it
        period_s: control period [s]
        supply_v: supply voltage of the servos, 0 without servos [V]
        bus: the servo bus
        safety: limits and policies
        joints: in bus order, (njoint,)
        sensors: in raw-channel order, (nsensor,)
        text: the file's own text, to be embedded in logs
        facing: joint whose angle turns the direction that the rig looks in from the heading, or None
    """

    name: str
    path: Path
    body: Path
    period_s: float
    supply_v: float
    bus: Bus
    safety: Safety
    joints: tuple[Joint, ...]
    sensors: tuple[Sensor, ...]
    text: str
    facing: str | None = None

    @property
    def nraw(self) -> int:
        """Return the number of raw channels."""
        return 3 * len(self.joints) + len(self.sensors)

    @property
    def simulated_only(self) -> bool:
        """Return whether it has no bus: nobody can build it."""
        return self.bus.protocol == "none"
