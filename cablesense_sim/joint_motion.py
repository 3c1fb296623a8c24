"""How commanded joint angles are approached: smoothly, no faster than the actuators go."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array

SHORTEST_MOVE_S = 0.1
_PEAK_TO_MEAN_SPEED = 1.875
_PEAK_ACCELERATION = 3.08  # peak acceleration of a move from rest, in peak speeds by its duration


def move_duration_s(largest_turn_rad: float, joint_speed_rad_s: float) -> float:
    """How long a move takes whose fastest joint turns by `largest_turn_rad` from rest to rest."""
    return max(SHORTEST_MOVE_S, _PEAK_TO_MEAN_SPEED * largest_turn_rad / joint_speed_rad_s)


class JointMotion:
    """Set-points from the present state to the last target; a new target may come at any time.

    The curve is the fifth-order polynomial that starts with the present angle, speed and
    acceleration and ends at rest (Flash and Hogan 1985), so the actuators never jump: a jump of
    half a degree would pull some cables of a stiff arm with thousands of newtons. An acceleration
    larger than that of a move of this duration from rest is limited to it: after a short step it
    would carry a long move far beyond its target.
    """

    def __init__(self, angles_rad: Array, joint_speed_rad_s: float) -> None:
        """At rest at `angles_rad` (2N,); `joint_speed_rad_s`: peak speed of a move from rest."""
        self._speed_rad_s = joint_speed_rad_s
        self._coefficients = np.zeros((6, len(angles_rad)))
        self._coefficients[0] = angles_rad
        self._elapsed_s = 0.0
        self._duration_s = 0.0
        self._target_rad = np.array(angles_rad, dtype=np.float64)

    @property
    def moving(self) -> bool:
        """Whether the target is still ahead."""
        return self._elapsed_s < self._duration_s

    @property
    def remaining_s(self) -> float:
        """Time until the target is reached."""
        return max(0.0, self._duration_s - self._elapsed_s)

    def go_to(self, target_rad: Array) -> None:
        """Head for `target_rad` (2N,) from wherever the motion is now."""
        angle, speed, acceleration = self.state
        duration = move_duration_s(float(np.abs(target_rad - angle).max()), self._speed_rad_s)
        hardest = _PEAK_ACCELERATION * self._speed_rad_s / duration
        acceleration = np.clip(acceleration, -hardest, hardest)
        t = duration
        rest = target_rad - angle - speed * t - 0.5 * acceleration * t**2
        to_lose = -speed - acceleration * t
        to_ease = -acceleration
        self._coefficients = np.stack(
            [
                angle,
                speed,
                0.5 * acceleration,
                (10 * rest - 4 * to_lose * t + 0.5 * to_ease * t**2) / t**3,
                (-15 * rest + 7 * to_lose * t - to_ease * t**2) / t**4,
                (6 * rest - 3 * to_lose * t + 0.5 * to_ease * t**2) / t**5,
            ]
        )
        self._elapsed_s = 0.0
        self._duration_s = duration
        self._target_rad = np.array(target_rad, dtype=np.float64)

    def advance(self, step_s: float) -> Array:
        """Let `step_s` pass and give the set-point (2N,) then."""
        return self.at(self._elapsed_s + step_s)

    def at(self, elapsed_s: float) -> Array:
        """The set-point (2N,) so long after the motion began."""
        self._elapsed_s = elapsed_s
        return self.state[0] if self.moving else self._target_rad

    @property
    def target_rad(self) -> Array:
        """(2N,) where it ends."""
        return self._target_rad

    @property
    def state(self) -> tuple[Array, Array, Array]:
        """Set-points (2N,) of angle, speed and acceleration, rad, rad/s and rad/s²."""
        if not self.moving:
            still = np.zeros_like(self._target_rad)
            return self._target_rad, still, still
        t = self._elapsed_s
        c = self._coefficients
        angle = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
        speed = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + t * 5 * c[5])))
        acceleration = 2 * c[2] + t * (6 * c[3] + t * (12 * c[4] + t * 20 * c[5]))
        return angle, speed, acceleration
