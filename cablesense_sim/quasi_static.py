"""An arm that goes from equilibrium to equilibrium: statics with history-dependent effects.

At each sample the arm is in static equilibrium again, and in which depends on the last: a cable
that sticks on its guide keeps its tension, a cable that creeps is longer than before. Several arms
of the same kind, with different numbers, are simulated side by side, as a fit needs.

Each equilibrium is found by Newton's method on the balance of joint torques, which with friction
is no longer the slope of a potential. Without friction a cable has one tension k max(0, s), with
the stretch s of the whole; with it, every span has its own (`cablesense_sim.cable_chain`).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.cable_pull import CablePull
from cablesense_sim.compiled import compiled
from cablesense_sim.effects.effect import ArmEquilibrium
from cablesense_sim.effects.registry import Variants, transmissions
from cablesense_sim.equilibrium import RESIDUAL_LIMIT_N_M, EquilibriumError, solve_equilibrium
from cablesense_sim.equilibrium_search import (
    Imbalance,
    Pose,
    balanced,
    escape_step,
    plates_of,
    posed,
)
from cablesense_sim.linear_equations import eliminate
from cablesense_sim.mechanism import Mechanism, stack

_TOLERATED_N_M = 1e-4
"""Torque that may remain in an equilibrium: it changes a reading by some mN."""
_MOST_STEPS = 80
"""Of the search for one equilibrium; those that need more do not converge."""
_SHORTEST = 1e-3
"""Relative width of a bracket about a kink that is not halved any more."""
_LEAST_FRACTION = 1e-7
"""Of a step: a shorter one moves nothing."""
_OVER_KINK = 0.3
"""Share of the drive at the start of a step, against it, from which on a step went over a kink."""
_SHORT_OF_KINK = 0.7
"""Share of this drive, along the step, from which on a cut step fell short of the kink."""
_SMALLEST_CUT = 0.05
"""Smallest factor of a step that went over a kink."""
_LARGEST_CUT = 0.8
"""Largest factor of a step that went over a kink: it must become shorter."""
_LONGEST_TURN_RAD = 0.05
"""Of a joint in one step: half of that without friction, whose kinks are closer."""
_FOLLOWED_FROM_N = 10.0
"""Change of a tension by the command alone from which on the start follows it."""
_FOLLOWING_STEPS = 2
"""Newton steps by which the start follows the command."""
_SMALL_STEPS = 5
"""By which an equilibrium that is not found at once is reached."""


class _TrialPose(NamedTuple):
    angles_rad: Array
    shape: Pose
    tensions_n: Array
    balance: Imbalance


class _Steps(NamedTuple):
    """The last steps of P arms: their start, and the fraction of them that was taken."""

    start: Array  # (P, 2N)
    step: Array  # (P, 2N)
    driven: Array  # (P,) how hard torques drove the arm along the step, where it began
    fraction: Array  # (P,) of the step
    near: Array  # (P,) fraction that fell short of a kink
    far: Array  # (P,) fraction that went beyond it, or infinite


class QuasiStaticArm:
    """P arms from equilibrium to equilibrium; holds their state."""

    def __init__(
        self, mechanisms: Sequence[Mechanism], variants: Variants, *, some_may_fail: bool = False
    ) -> None:
        """Arms of the amended `mechanisms`, with what of each variant depends on the past.

        If some may fail, an arm without equilibrium has tensions NaN from then on, and the others
        continue.
        """
        self._each = list(mechanisms)
        self._mechanism = stack(mechanisms)
        # loads and weights notice lengths that differ by tolerances; cables' pieces do not
        self._lengths_m = np.stack([mechanism.segment_length_m for mechanism in mechanisms])
        self._plates = plates_of(self._mechanism, len(self._each))
        self._bend_limit_rad = self._mechanism.bend_limit_rad
        spring = self._mechanism.joint_stiffness_n_m_rad
        self._spring_n_m_rad = np.repeat(spring, 2, axis=-1)
        self._transmissions = transmissions(variants)
        self._angles_rad = np.zeros((len(self._each), self._mechanism.joint_count))
        spans = kinematics.spans(self._mechanism, self._angles_rad).length_m.sum(-1)
        self._straight_m = spans - self._mechanism.pretension_n / self._mechanism.stiffness_n_m
        self._some_may_fail = some_may_fail
        self._lost = np.zeros(len(self._each), dtype=bool)
        self._begun = False
        self._last: tuple[Array, Array, _TrialPose] | None = None

    def branched(self) -> QuasiStaticArm:
        """A copy that continues from the same state."""
        other = copy.copy(self)
        other._lost = self._lost.copy()
        other._transmissions = copy.deepcopy(self._transmissions)
        return other

    @property
    def joint_angles_rad(self) -> Array:
        """(P, 2N) where the arms are in equilibrium; straight before the first step."""
        return self._angles_rad.copy()

    def step(
        self,
        time_s: float,
        held_m: Array,
        forces_n: Array,
        contact_m: Array | None = None,
        expected_turn_rad: Array | None = None,
    ) -> Array:
        """Tensions (P, M) at the actuators at the next equilibrium.

        `held_m` (P, M) are the cable lengths that the actuators hold, relative to the straight
        arm; `forces_n` (N, 3), or (P, N, 3) for each arm its own, act in base axes. They act at
        `contact_m` (N,) or (P, N) on the axes, from the joint centres, or at the mechanisms'
        contact points. The search begins at the last equilibrium plus the `expected_turn_rad`
        (2N,), for example that of an arm with similar numbers.

        Raises:
            EquilibriumError: an arm finds no equilibrium; its `failed` names them all.
        """
        slack_m = self._straight_m + held_m
        longer_m = np.zeros_like(held_m)
        forces = np.broadcast_to(forces_n, (len(self._each), *forces_n.shape[-2:]))
        places = self._mechanism.contact_m if contact_m is None else contact_m
        places = np.broadcast_to(places, forces.shape[:-1])
        if not self._begun:
            self._longer_m = longer_m
            self._hold(slack_m)
            self._begin(time_s, held_m, forces, places)
        for transmission in self._transmissions:
            longer = transmission.lengthening_m(time_s)
            if longer is not None:
                longer_m = longer_m + longer
        self._longer_m = longer_m
        slack_m = slack_m + longer_m
        self._hold(slack_m)
        loaded = replace(self._mechanism, contact_m=places, segment_length_m=self._lengths_m)
        arms = kinematics.load_arms(loaded, forces)
        with np.errstate(all="ignore"):  # an arm without an equilibrium may go anywhere
            while True:
                try:
                    pose = self._next(slack_m, arms, expected_turn_rad)
                    self._require_room(pose.angles_rad)
                    break
                except EquilibriumError as error:
                    self._lose(error)
        self._angles_rad = pose.angles_rad
        shape = pose.shape
        equilibrium = ArmEquilibrium(
            time_s, pose.angles_rad, shape.span_m, shape.bend_rad, pose.tensions_n
        )
        for transmission in self._transmissions:
            transmission.settle(equilibrium)
        return np.where(self._lost[:, None], np.nan, pose.tensions_n)

    def _lose(self, error: EquilibriumError) -> None:
        if not self._some_may_fail:
            raise error
        self._lost[error.failed] = True

    def _hold(self, slack_m: Array) -> None:
        for transmission in self._transmissions:
            transmission.hold(slack_m - self._longer_m, self._longer_m)

    def _next(self, slack_m: Array, arms: Array, turn_rad: Array | None) -> _TrialPose:
        """The next equilibrium, which is the last one if nothing has changed."""
        if self._last is not None:
            last_slack_m, last_arms, pose = self._last
            if np.array_equal(slack_m, last_slack_m) and np.array_equal(arms, last_arms):
                return pose
        start = self._followed(slack_m) if turn_rad is None else self._angles_rad + turn_rad
        try:
            pose = self._search(start, slack_m, arms)
        except EquilibriumError:
            pose = self._in_small_steps(slack_m, arms)
        self._last = slack_m, arms, pose
        return pose

    def _followed(self, slack_m: Array) -> Array:
        """Where to begin: moved so that every cable, slack or not, keeps the stretch that it had.

        With slack cables, Newton's method does not know how far the others were drawn.
        """
        angles = self._angles_rad
        if self._last is None:
            return angles
        last_m = self._last[0]
        stiffness = self._mechanism.stiffness_n_m
        if (stiffness * np.abs(slack_m - last_m)).max() < _FOLLOWED_FROM_N:
            return angles
        wanted = self._last[2].shape.span_m.sum(-1) - last_m + slack_m
        for _ in range(_FOLLOWING_STEPS):
            shape = posed(self._plates, angles)
            jacobian = shape.by_turn_m.reshape(*wanted.shape, -1)
            cable_stiffness = np.broadcast_to(stiffness, wanted.shape)[..., None, :]
            pull = np.swapaxes(jacobian, -1, -2) * cable_stiffness
            missing = (wanted - shape.span_m.sum(-1))[..., None]
            angles = angles + np.linalg.solve(pull @ jacobian, pull @ missing)[..., 0]
        return np.asarray(angles)

    def _in_small_steps(self, slack_m: Array, arms: Array) -> _TrialPose:
        """The same equilibrium by way of others, which change no state."""
        angles = self._angles_rad
        last_m, last_arms = (slack_m, 0.0 * arms) if self._last is None else self._last[:2]
        for share in np.linspace(0.0, 1.0, _SMALL_STEPS + 1)[1:]:
            on_the_way_m = last_m + share * (slack_m - last_m)
            self._hold(on_the_way_m)
            pose = self._search(angles, on_the_way_m, last_arms + share * (arms - last_arms))
            angles = pose.angles_rad
        return pose

    def _begin(self, time_s: float, held_m: Array, forces_n: Array, contact_m: Array) -> None:
        """The state begins where an arm without history-dependent effects would rest."""
        self._angles_rad = np.zeros_like(self._angles_rad)
        tensions = np.broadcast_to(self._mechanism.pretension_n, held_m.shape).copy()
        alike = all(mechanism is self._each[0] for mechanism in self._each)
        sets = [slice(None)] if alike else [slice(arm, arm + 1) for arm in range(len(self._each))]
        for arms in sets:
            start = self._angles_rad[arms]
            forces = forces_n[arms]
            held = held_m[arms]
            try:
                touched = replace(self._each[arms][0], contact_m=contact_m[arms])
                equilibrium = solve_equilibrium(touched, start, forces, held_m=held)
            except EquilibriumError as error:
                self._lose(EquilibriumError(str(error), np.arange(len(self._each))[arms]))
                continue
            self._angles_rad[arms] = equilibrium.joint_angles_rad
            tensions[arms] = equilibrium.tensions_n
        shape = posed(self._plates, self._angles_rad)
        first = ArmEquilibrium(time_s, self._angles_rad, shape.span_m, shape.bend_rad, tensions)
        for transmission in self._transmissions:
            transmission.begin(self._mechanism, first)
        self._begun = True

    def _search(self, start: Array, slack_m: Array, arms: Array) -> _TrialPose:
        pose = self._pose(start, slack_m, arms)
        count = len(start)
        no_step = np.zeros_like(start)
        fraction = np.ones(count)
        near = np.zeros(count)
        far = np.full(count, np.inf)
        steps = _Steps(start.copy(), no_step, np.zeros(count), fraction, near, far)
        for _ in range(_MOST_STEPS):
            if np.abs(pose.balance.torque_n_m).max() <= RESIDUAL_LIMIT_N_M:
                return pose
            pose = self._pose(_step_on(steps, pose.angles_rad, *pose.balance), slack_m, arms)
        unbalanced = np.abs(pose.balance.torque_n_m).max(-1)
        if unbalanced.max() <= _TOLERATED_N_M:
            return pose
        raise EquilibriumError(
            f"{int((unbalanced > _TOLERATED_N_M).sum())} of {len(unbalanced)} arms found no rest "
            f"after a small step; {unbalanced.max():.2g} N·m stay unbalanced; lower the loads or "
            "the size of the effects",
            np.flatnonzero(unbalanced > _TOLERATED_N_M),
        )

    def _require_room(self, angles_rad: Array) -> None:
        """Require that no joint is bent beyond the angle at which guide plates touch."""
        bend = kinematics.bend_rad(angles_rad)
        limit = self._bend_limit_rad
        bend = np.where(self._lost[:, None], 0.0, bend)
        if (bend < limit).all():
            return
        arm, joint = np.unravel_index(int(np.argmax(bend - limit)), bend.shape)
        raise EquilibriumError(
            f"arm {arm} of {len(bend)} would bend joint {joint + 1} by "
            f"{np.rad2deg(bend[arm, joint]):.1f} degrees, and its guide plates touch before; "
            "lower the loads or the commanded angles",
            np.flatnonzero((bend >= limit).any(-1)),
        )

    def _pose(self, angles: Array, slack_m: Array, arms: Array) -> _TrialPose:
        shape = posed(self._plates, angles)
        pull = self._pull(shape.span_m, shape.bend_rad, slack_m)
        resisted = self._spring_n_m_rad * angles
        stiffer = self._spring_n_m_rad
        for transmission in self._transmissions:
            resistance = transmission.joint_torque_n_m(angles)
            if resistance is not None:
                resisted = resisted + resistance[0]
                stiffer = stiffer + resistance[1]
        # copies, so that the compiled code is of one kind of array
        along = pull.tensions_n[..., 1:].copy()
        by_span = pull.by_length_n_m[..., 1:, 1:].copy()
        balance = balanced(shape, along, by_span, arms, resisted, stiffer)
        if self._lost.any():
            balance.torque_n_m[self._lost] = 0.0
            balance.slope_n_m[self._lost] = np.eye(angles.shape[-1])
        return _TrialPose(angles, shape, pull.tensions_n[..., 0], balance)

    def _pull(self, spans_m: Array, bends_rad: Array, slack_m: Array) -> CablePull:
        for transmission in self._transmissions:
            pull = transmission.pull(spans_m, bends_rad)
            if pull is not None:
                return pull
        stretch = spans_m.sum(-1) - slack_m
        stiffness = self._mechanism.stiffness_n_m * (stretch > 0.0)
        count = 1 + spans_m.shape[-1]
        return CablePull(
            np.broadcast_to((stiffness * stretch)[..., None], (*stretch.shape, count)),
            np.broadcast_to(stiffness[..., None, None], (*stretch.shape, count, count)),
        )


@compiled
def _step_on(steps: _Steps, angles: Array, torque: Array, slope: Array) -> Array:
    """Angles (P, 2N) to try next, after those that leave a torque (P, 2N) with a slope.

    Over a kink, where cables go slack or slip, whole steps can go to and fro for ever: a step is
    cut while the torques at its end drive the arm back as hard as it was driven. If a cut step
    falls short of the kink, the next one ends between the two.
    """
    for p in range(len(angles)):
        driven = steps.driven[p]
        fraction = steps.fraction[p]
        back = (torque[p] * steps.step[p]).sum()
        over = back > _OVER_KINK * driven
        short = back < -_SHORT_OF_KINK * driven and steps.far[p] < np.inf
        if over:
            steps.far[p] = fraction
        if short:
            steps.near[p] = fraction
        near = steps.near[p]
        far = steps.far[p]
        if (over or short) and far - near > _SHORTEST * far and far > _LEAST_FRACTION:
            shorter = min(max(driven / max(driven + back, 1e-300), _SMALLEST_CUT), _LARGEST_CUT)
            steps.fraction[p] = 0.5 * (near + far) if near > 0.0 else shorter * fraction
            continue
        steps.start[p] = angles[p]
        steps.step[p] = 0.0
        if np.abs(torque[p]).max() > RESIDUAL_LIMIT_N_M:
            steps.step[p] = _newton_rad(torque[p], slope[p])
        steps.driven[p] = -(torque[p] * steps.step[p]).sum()
        steps.fraction[p] = 1.0
        steps.near[p] = 0.0
        steps.far[p] = np.inf
    return steps.start + steps.fraction.reshape(-1, 1) * steps.step


@compiled
def _newton_rad(torque: Array, slope: Array) -> Array:
    """Newton's step; where that leads uphill, with too many cables slack, a step that descends."""
    step = eliminate(slope, -torque)
    if (torque * step).sum() > 0.0:
        step = escape_step(0.5 * (slope + slope.T), torque)
    return step * min(1.0, _LONGEST_TURN_RAD / max(np.abs(step).max(), 1e-300))
