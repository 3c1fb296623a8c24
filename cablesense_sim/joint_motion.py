"""How commanded joint angles are approached: smoothly, no faster than the actuators go."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array

SHORTEST_MOVE_S = 0.1
"""Duration of a move, however small: a jump would pull cables of a stiff arm with thousands of
newtons."""
_PEAK_TO_MEAN_SPEED = 1.875
"""Of a fifth-order move from rest to rest."""
_PEAK_ACCELERATION = 3.08
"""Of such a move, in peak speeds by its duration."""
SUDDEN_OVER_STEADY = 2.0
"""A sudden acceleration swings an undamped machine by this many times what a steady one bends
it."""


def move_duration_s(largest_turn_rad: float, joint_speed_rad_s: float) -> float:
    """How long a move takes whose fastest joint turns by `largest_turn_rad` from rest to rest."""
    return max(SHORTEST_MOVE_S, _PEAK_TO_MEAN_SPEED * largest_turn_rad / joint_speed_rad_s)


@dataclass(frozen=True)
class JointMotion:
    """Set-points from the present state to the last target; a new target may come at any time.

    The curve is the fifth-order polynomial that starts with the present angle, speed and
    acceleration and ends at rest (Flash and Hogan 1985), so the actuators never jump: a jump of
    half a degree would pull some cables of a stiff arm with thousands of newtons. An acceleration
    larger than that of a move of this duration from rest is limited to it: after a short step it
    would carry a long move far beyond its target.

    Attributes:
        joint_speed_rad_s: peak speed of a move from rest.
        target_rad: (2N,) where it ends.
        coefficients: (6, 2N) of the powers of time, from the constant on.
        duration_s: of the move.
        elapsed_s: since it began.
    """

    joint_speed_rad_s: float
    target_rad: Array
    coefficients: Array
    duration_s: float = 0.0
    elapsed_s: float = 0.0

    @classmethod
    def at_rest(cls, angles_rad: Array, joint_speed_rad_s: float) -> JointMotion:
        """None yet, with the joints at angles (2N,)."""
        coefficients = np.zeros((6, len(angles_rad)))
        coefficients[0] = angles_rad
        return cls(joint_speed_rad_s, np.array(angles_rad, dtype=np.float64), coefficients)

    def towards(self, target_rad: Array) -> JointMotion:
        """The motion that heads for `target_rad` (2N,) from wherever this one is now."""
        angle, speed, acceleration = self.state
        largest_turn_rad = float(np.abs(target_rad - angle).max())
        t = move_duration_s(largest_turn_rad, self.joint_speed_rad_s)
        hardest = _PEAK_ACCELERATION * self.joint_speed_rad_s / t
        acceleration = np.clip(acceleration, -hardest, hardest)
        remaining = target_rad - angle - speed * t - 0.5 * acceleration * t**2
        to_lose = -speed - acceleration * t
        to_ease = -acceleration
        coefficients = np.stack(
            [
                angle,
                speed,
                0.5 * acceleration,
                (10 * remaining - 4 * to_lose * t + 0.5 * to_ease * t**2) / t**3,
                (-15 * remaining + 7 * to_lose * t - to_ease * t**2) / t**4,
                (6 * remaining - 3 * to_lose * t + 0.5 * to_ease * t**2) / t**5,
            ]
        )
        target = np.array(target_rad, dtype=np.float64)
        return JointMotion(self.joint_speed_rad_s, target, coefficients, t)

    def at(self, elapsed_s: float) -> JointMotion:
        """The same motion so long after it began."""
        return replace(self, elapsed_s=elapsed_s)

    def after(self, step_s: float) -> JointMotion:
        """The same motion when `step_s` more have passed."""
        return replace(self, elapsed_s=self.elapsed_s + step_s)

    @property
    def moving(self) -> bool:
        """Whether the target is still ahead."""
        return self.elapsed_s < self.duration_s

    @property
    def remaining_s(self) -> float:
        """Time until the target is reached."""
        return max(0.0, self.duration_s - self.elapsed_s)

    @property
    def angle_rad(self) -> Array:
        """(2N,) the set-point now."""
        return self.state[0]

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """Set-points (2N,) of angle, speed and acceleration, rad, rad/s and rad/s²."""
        if not self.moving:
            still = np.zeros_like(self.target_rad)
            return self.target_rad, still, still
        t = self.elapsed_s
        c = self.coefficients
        angle = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
        speed = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + t * 5 * c[5])))
        acceleration = 2 * c[2] + t * (6 * c[3] + t * (12 * c[4] + t * 20 * c[5]))
        return angle, speed, acceleration
