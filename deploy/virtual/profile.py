"""The servo's own profile: how its goal moves when profile velocity and acceleration are set."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class Profile:
    """Move a reference to a goal with bounded velocity and acceleration; a bound of 0 is none.

    Args:
        position: where the reference is [ticks]
        velocity: how fast it moves [ticks/s]
    """

    position: float = 0.0
    velocity: float = 0.0

    def jump(self, position: float) -> None:
        """Put the reference somewhere, at rest.

        Args:
            position: where [ticks]
        """
        self.position = position
        self.velocity = 0.0

    def step(self, goal: float, velocity_max: float, acceleration_max: float, dt: float) -> bool:
        """Move the reference; return whether it is still on its way.

        Args:
            goal: where to [ticks]
            velocity_max: [ticks/s], 0: none
            acceleration_max: [ticks/s2], 0: none
            dt: time step [s]
        """
        rest = goal - self.position
        if velocity_max <= 0.0:
            self.jump(goal)
            return False
        wanted = min(velocity_max, abs(rest) / dt)
        if acceleration_max > 0.0:
            # v**2 / 2a is the way that braking takes; the half step keeps the discrete motion from overshooting
            brake = 0.5 * acceleration_max * dt
            wanted = min(wanted, max(math.sqrt(brake * brake + 2.0 * acceleration_max * abs(rest)) - brake, 0.0))
        wanted = math.copysign(wanted, rest)
        if acceleration_max > 0.0:
            change = acceleration_max * dt
            wanted = min(max(wanted, self.velocity - change), self.velocity + change)
        self.velocity = wanted
        self.position += wanted * dt
        if abs(goal - self.position) < 1e-6 and abs(self.velocity) * dt < 1e-3 + abs(rest):
            self.jump(goal)
            return False
        return True
