"""The X series' profiles: a goal is reached by a trapezoid of velocity, reckoned when the goal is given.

Source: ROBOTIS e-Manual, "What is the Profile", _includes/en/dxl/control_table_profile_velocity.md. A profile starts
with the velocity of the one that it overrides, so that velocity has no steps but where acceleration has no bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

STEP: Final = 0
RECTANGULAR: Final = 1
TRIANGULAR: Final = 2
TRAPEZOIDAL: Final = 3


class Sample(NamedTuple):
    """Hold where a trajectory is at a time.

    Args:
        position: [units]
        velocity: [units/s]
        acceleration: [units/s2]
    """

    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class Trajectory:
    """Hold a motion with piecewise constant acceleration that ends at rest, or at a velocity.

    Args:
        kind: as bits 4 and 5 of the moving status have it: step, rectangular, triangular or trapezoidal
        pieces: (start [s], position, velocity, acceleration) of each piece, in order
        end_s: when it has ended [s]
        goal: where it ends
        goal_velocity: with which velocity
    """

    kind: int
    pieces: tuple[tuple[float, float, float, float], ...]
    end_s: float
    goal: float
    goal_velocity: float = 0.0

    def at(self, t_s: float) -> Sample:
        """Return where the motion is.

        Args:
            t_s: time since its start [s]
        """
        if t_s >= self.end_s:
            return Sample(self.goal + self.goal_velocity * (t_s - self.end_s), self.goal_velocity, 0.0)
        start_s, position, velocity, acceleration = next(piece for piece in reversed(self.pieces) if piece[0] <= t_s)
        dt = t_s - start_s
        return Sample(position + dt * (velocity + 0.5 * acceleration * dt), velocity + acceleration * dt, acceleration)


def rest(position: float) -> Trajectory:
    """Return no motion: a step.

    Args:
        position: where [units]
    """
    return Trajectory(STEP, (), 0.0, position)


def to_position(start: Sample, goal: float, velocity_max: float, acceleration_max: float) -> Trajectory:
    """Return the fastest motion to rest at a goal within bounds.

    Args:
        start: where and how fast it begins
        goal: where it ends [units]
        velocity_max: [units/s]; 0: none, a step
        acceleration_max: [units/s2]; 0: none
    """
    distance = goal - start.position
    if velocity_max <= 0.0:
        return rest(goal)
    if acceleration_max <= 0.0:
        speed = math.copysign(velocity_max, distance)
        return Trajectory(RECTANGULAR, ((0.0, start.position, speed, 0.0),), abs(distance) / velocity_max, goal)
    a = acceleration_max
    # seen towards where braking at once would not end
    way = math.copysign(1.0, distance - start.velocity * abs(start.velocity) / (2.0 * a))
    distance, v0 = way * distance, way * start.velocity
    peak = math.sqrt(max(0.0, a * distance + 0.5 * v0 * v0))
    kind = TRAPEZOIDAL if peak > velocity_max else TRIANGULAR
    top = min(peak, velocity_max)
    rise = a if top >= v0 else -a  # a profile that overrides a faster one brakes to its own velocity
    rise_s = (top - v0) / rise
    rise_way = 0.5 * (v0 + top) * rise_s
    brake_s = top / a
    cruise_s = max(0.0, distance - rise_way - 0.5 * top * brake_s) / top if top > 0.0 else 0.0
    pieces = (
        (0.0, start.position, way * v0, way * rise),
        (rise_s, start.position + way * rise_way, way * top, 0.0),
        (rise_s + cruise_s, start.position + way * (rise_way + top * cruise_s), way * top, -way * a),
    )
    return Trajectory(kind, pieces, rise_s + cruise_s + brake_s, goal)


def in_time(start: Sample, goal: float, total_s: float, rise_s: float) -> Trajectory:
    """Return a motion to rest at a goal that takes a time, if it starts at rest.

    Args:
        start: where and how fast it begins
        goal: where it ends [units]
        total_s: how long it takes [s]; 0: none, a step
        rise_s: how long it accelerates, at most half of that [s]
    """
    if total_s <= 0.0:
        return rest(goal)
    rise_s = min(rise_s, 0.5 * total_s)
    speed = abs(goal - start.position) / (total_s - rise_s)
    return to_position(start, goal, speed, speed / rise_s if rise_s > 0.0 else 0.0)


def to_velocity(start: Sample, goal: float, rise_s: float) -> Trajectory:
    """Return a motion to a velocity.

    Args:
        start: where and how fast it begins
        goal: velocity at its end [units/s]
        rise_s: how long it takes [s]
    """
    if rise_s <= 0.0:
        return Trajectory(STEP, (), 0.0, start.position, goal)
    acceleration = (goal - start.velocity) / rise_s
    end = start.position + 0.5 * (start.velocity + goal) * rise_s
    return Trajectory(TRAPEZOIDAL, ((0.0, start.position, start.velocity, acceleration),), rise_s, end, goal)
