"""Breathing: the arm moves a little on purpose, so that readings follow the load despite friction.

If cables stick at their guides, readings do not follow the load. A breath turns every joint in a
small circle, pitch a quarter turn ahead of yaw. Each cable then slides at each of its guides, half
of the turn inwards and half outwards. The effect of friction on the logarithm of a tension changes
its sign after half a turn, so the mean over a whole turn is that of the arm without friction. This
holds by symmetry for rigid sticking and for bristles, whatever the coefficients. Motion with the
circle's frequency, swinging included, drops out of the same mean.

The joints turn by different amounts, and the arm's centre line bends like a wave: every cable
moves at every guide, and the tip nearly stays. The least circle turns every guide: there a cable
moves farther than its stretch over the friction loop, T sinh(μ θ) / k, and its give before it
slips.

The breather commands a `Breath` along its `Circle`; the estimator averages by `breath_readings`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import BREATH_END
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

SET_POINTS_A_TURN: Final = 20
"""Of the circle: neighbours differ by a third of its radius."""
_RISE = 10
"""Set-points from rest to the full circle."""
_LEAD = 10
"""Set-points on the full circle until the arm has followed."""
_FALL = 10
"""Set-points from the full circle back to rest."""
_LOADED = 2.0
"""The circle still turns a cable at this multiple of its unloaded tension."""
_LOADED_BEND_RAD = 0.1
"""Total bend of the joints by a load, beyond their command."""
_LEAST_RAD: Final = np.radians(0.03)
"""Smallest radius of the circle where the cables' friction asks for less."""
MOST_RAD: Final = np.radians(2.0)
"""Largest radius of the circle: a larger one is a motion of its own, and is refused."""
_ROUNDED_BRISTLES_FACTOR = 2.0
"""Rounded bristles carry 95 % of their limit after three times the `give_m` of sharp ones."""
_SLACK_N = 1.0
"""Tension below which a cable is as good as slack."""
_PHASES = 8
"""Poses of the circle in which cables must stay taut."""


class BreathError(CableSenseError):
    """An arm for which there is no breath; the message states why, and what would be right."""


@dataclass(frozen=True)
class Circle:
    """The full circle of a breath about a command.

    Attributes:
        axes_rad: (2, 2N) deviation from the command, at the start and a quarter turn later.
        tip_m: largest commanded displacement of the arm's tip.
    """

    axes_rad: Array
    tip_m: float = 0.0

    @property
    def largest_rad(self) -> float:
        """Largest angle by which a joint turns."""
        return float(np.hypot(*self.axes_rad).max())

    def at(self, turns: float) -> Array:
        """(2N,) deviation from the command after a number of turns."""
        phase = 2.0 * np.pi * turns
        return np.asarray(np.array([np.cos(phase), np.sin(phase)]) @ self.axes_rad)


class Breath:
    """Set-points of one breath: up to the full circle, whole turns, and back to the command."""

    def __init__(self, circle: Circle, turns: int) -> None:
        """With this number of whole turns; 0 continues for ever."""
        self._circle = circle
        self._first = _RISE + _LEAD
        self._last = self._first + turns * SET_POINTS_A_TURN if turns else math.inf
        self._number = 0

    @property
    def over(self) -> bool:
        """Whether the last set-point has been given."""
        return self._number > self._last + _FALL

    def next(self) -> tuple[Array, int]:
        """The next deviation from the command (2N,), and its turn (`messages.breath_turn`)."""
        number = self._number
        self._number += 1
        size = min(1.0, number / _RISE)
        turn = 0
        if number >= self._last:
            size = 1.0 - (number - self._last) / _FALL
        elif number >= self._first:
            turn = 1 + (number - self._first) // SET_POINTS_A_TURN
        if self.over:
            return np.zeros_like(self._circle.axes_rad[0]), BREATH_END
        return size * self._circle.at(number / SET_POINTS_A_TURN), turn


def breath_circle(
    arm: Arm, command_rad: Array, amplitude_rad: float = 0.0, largest_tip_m: float = 0.0
) -> Circle:
    """The circle of a breath of an arm about a command (2N,).

    Args:
        arm: with `capstan_friction` among its effects, unless the amplitude is given.
        command_rad: centre of the circle.
        amplitude_rad: of the joint that turns most; 0 takes the least that turns every guide.
        largest_tip_m: largest displacement of the tip; 0 for any.

    Raises:
        BreathError: no friction in the arm file and no amplitude, or one that is too large or
            leaves a cable slack, or moves the tip too far.
        EquilibriumError: the arm has no rest there.
    """
    mechanism = amended(mechanism_of(arm), entries_of(arm))
    axes = (_wave(mechanism)[:, None] * np.eye(2)[:, None]).reshape(2, -1)
    grip, give_m = _grip(arm, mechanism, command_rad)
    unloaded_n = solve_equilibrium(mechanism, command_rad).tensions_n
    wanted_m = _LOADED * unloaded_n * np.sinh(grip) / mechanism.stiffness_n_m + give_m
    per_wave = float(np.max(wanted_m[:, None] / _motion_m(mechanism, command_rad, axes)))
    largest_wave = float(np.abs(axes).max())
    least_rad = max(per_wave * largest_wave, _LEAST_RAD) if grip.any() else 0.0
    amplitude = amplitude_rad or least_rad
    if not amplitude:
        raise BreathError(
            f"arm {arm.name} lists no capstan_friction, so the least amplitude that turns its "
            "guides is unknown; add the effect to the arm file, or give an amplitude"
        )
    if amplitude > MOST_RAD:
        raise BreathError(
            f"no breath of arm {arm.name}: to turn every guide a joint would swing by "
            f"{np.degrees(amplitude):.2f} degrees, more than {np.degrees(MOST_RAD):g}; less "
            "friction or stiffer cables need less"
        )
    circle = Circle(axes * (amplitude / largest_wave))
    poses = command_rad + np.array([circle.at(k / _PHASES) for k in range(_PHASES)])
    lowest_n = solve_equilibrium(mechanism, poses).tensions_n.min(0) * np.exp(-2.0 * grip)
    worst = int(np.argmin(lowest_n))
    if lowest_n[worst] < _SLACK_N:
        raise BreathError(
            f"no breath here: it would leave cable_{worst + 1} with {lowest_n[worst]:.1f} N, as "
            f"good as slack (below {_SLACK_N:g} N); more pretension, or another pose, allows it"
        )
    moved_m = np.linalg.norm(tip_m(mechanism, poses) - tip_m(mechanism, command_rad), axis=-1)
    farthest_m = float(moved_m.max())
    if 0.0 < largest_tip_m < farthest_m:
        raise BreathError(
            f"a breath of {np.degrees(amplitude):.2f} degrees moves the tip by "
            f"{1e3 * farthest_m:.2f} mm, more than {1e3 * largest_tip_m:g}; allow that, or give a "
            "smaller amplitude"
        )
    return replace(circle, tip_m=farthest_m)


def offsets_m(arm: Arm, command_rad: Array, deviation_rad: Array) -> Array:
    """(M,) change of the cable lengths by a deviation (2N,) from a command."""
    mechanism = mechanism_of(arm)
    displaced_rad = command_rad + deviation_rad
    return held_lengths_m(mechanism, displaced_rad) - held_lengths_m(mechanism, command_rad)


def tip_m(mechanism: Mechanism, angles_rad: Array) -> Array:
    """(..., 3) position of the last segment's end at joint angles (..., 2N)."""
    last = kinematics.joint_positions_m(mechanism, angles_rad)[..., -1, :]
    along = kinematics.segment_rotations(mechanism, angles_rad)[..., -1, :, 0]
    return np.asarray(last + mechanism.segment_length_m[-1] * along)


def _wave(mechanism: Mechanism) -> Array:
    """(N,) relative amplitude of each joint.

    The rotation of each segment, the sum over the joints before it, differs from segment to
    segment and is nowhere zero, so that every cable moves at every guide. Weighted with the
    lengths it adds up to zero, so that the tip of the straight arm stays.
    """
    count = mechanism.segment_count
    if count == 1:
        return np.ones(1)
    pairs: Sequence[float] = [1.0, 2.0, -3.0] if count % 2 else []
    sizes = np.arange(1.0, (count - len(pairs)) // 2 + 1) + (3.0 if pairs else 0.0)
    turned = np.array([*sizes[::-1], *pairs, *-sizes])
    turned *= mechanism.segment_length_m.mean() / mechanism.segment_length_m
    return np.diff(turned, prepend=0.0)


def _grip(arm: Arm, mechanism: Mechanism, command_rad: Array) -> tuple[Array, float]:
    """(M,) μ θ of each cable, summed over its guides, and the give before it slips, m."""
    passed = mechanism.cable_segment[:, None] > np.arange(mechanism.segment_count)
    bends_rad = passed @ kinematics.bend_rad(command_rad) + _LOADED_BEND_RAD
    grip = np.zeros(mechanism.cable_count)
    give_m = 0.0
    for entry in entries_of(arm):
        if entry.effect.name == "capstan_friction":
            values = entry.values
            grip += values["coefficient"] * (bends_rad + values["pulley_wrap_rad"])
            give_m = max(
                give_m, values["give_m"] * (1.0 + _ROUNDED_BRISTLES_FACTOR * values["rounding"])
            )
    return grip, give_m


def _motion_m(mechanism: Mechanism, command_rad: Array, axes_rad: Array) -> Array:
    """(M, N) amplitude of each cable at the guides of each joint; infinite where it has none."""
    jacobian = kinematics.cable_jacobian_m(mechanism, command_rad)
    by_joint = (jacobian * axes_rad[:, None]).reshape(2, len(jacobian), -1, 2).sum(-1)
    beyond = np.hypot(*by_joint[..., ::-1].cumsum(-1)[..., ::-1])
    passed = mechanism.cable_segment[:, None] > np.arange(beyond.shape[-1])
    return np.where(passed, beyond, np.inf)
