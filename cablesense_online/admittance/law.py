"""How far to move away from a contact: one step of an admittance in joint space.

The law is D q̇ + K (q − q_home) + friction = Jᵀ f with J the Jacobian of the contact point at the
commanded angles and f the environment's force. Friction is dry: it takes up the torque of
`deadband_n` along the contact, so that the arm rests under less. A step of length T solves the law
with the torque k |J|² Δ that a wall of the assumed worst stiffness k would take away during the
step already taken off (linearly implicit Euler):

    (D/T + K) Δ + k j (jᵀ Δ) = τ max(0, 1 − deadband |j| / |τ|),   τ = j |f| − K (q − q_home),
    j = Jᵀ f / |f|.

docs/controller.md derives when the loop that is closed by the estimator is stable. The joint
angles that may be commanded are, for each joint, a disc about straight (`Reach`); a force is the
average of the wrenches that came after the arm had arrived (`ForceAverage`); and a new contact is
yielded to by little until it is seen in the pose after that (`Confirmation`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

PLATE_MARGIN_RAD = float(np.deg2rad(2.0))
"""How far the guide plates stay apart at least."""
_ROUNDING_RAD = 1e-9


class Reach:
    """Discs √(pitch² + yaw²) ≤ radius, one a joint.

    A disc holds the bend of the joint below its radius, as √(pitch² + yaw²) is never less than the
    bend. Discs are convex, so the nearest point of a disc to a step's end is never against the
    step.

    Attributes:
        radius_rad: (N,) of each joint's disc.
    """

    def __init__(self, mechanism: Mechanism, limit_rad: float) -> None:
        """As far as `limit_rad`, but never so far that guide plates come near each other."""
        self.radius_rad = np.minimum(limit_rad, mechanism.bend_limit_rad - PLATE_MARGIN_RAD)

    def nearest(self, joint_angles_rad: Array) -> Array:
        """The nearest joint angles (2N,) within reach."""
        joints = joint_angles_rad.reshape(-1, 2)
        bent = np.linalg.norm(joints, axis=1)
        share = np.where(
            bent > self.radius_rad, self.radius_rad / np.maximum(bent, self.radius_rad), 1.0
        )
        return np.asarray((joints * share[:, None]).reshape(-1))

    def holds(self, joint_angles_rad: Array) -> bool:
        """Whether these joint angles (2N,) are within reach, but for rounding."""
        bent = np.linalg.norm(joint_angles_rad.reshape(-1, 2), axis=1)
        return bool((bent <= self.radius_rad + _ROUNDING_RAD).all())


LONGEST_STEP_S = 1.0
"""However long ago the last step was, the next one moves no farther than for this time."""


@dataclass(frozen=True)
class AdmittanceSettings:
    """All numbers of the controller: of the law, of the trust in estimates, and of the cycle.

    Attributes:
        damping_n_m_s_rad: D of every joint axis, N·m·s/rad.
        return_stiffness_n_m_rad: K of every joint axis, N·m/rad; 0 never goes home.
        deadband_n: forces up to this one move nothing.
        worst_stiffness_n_m: k, the stiffest contact that is expected.
        step_limit_rad: no joint turns farther in one step.
        speed_limit_rad_s: nor, on the average of a step, faster.
        touch_n: a step towards home may run into an unseen wall of the worst stiffness with at
            most this force.
        smallest_step_rad: a step in which every joint turns less is not made, as each
            interrupts the estimates.
        stale_after_s: without a fresh wrench for this long there is no estimator.
        resume_after_s: estimates must come for this long before they are trusted again.
        joint_speed_rad_s, settle_s: as the estimator's: how long after a command it gives no
            estimate.
        joint_limit_rad: radius of each joint's disc of commands.
        measure_s: estimates are averaged over this time.
        confirm_rad: no joint turns farther for a new contact before it is confirmed, which is seen
            again after that turn.
        confirm_s: for so long; readings of a wrong cable fit a contact in one pose.
        yield_s: after a command of another node, none is sent for this long.
        await_command: send nothing before the first command of another node was received.
    """

    damping_n_m_s_rad: float = 5.0
    return_stiffness_n_m_rad: float = 1.0
    deadband_n: float = 2.0
    worst_stiffness_n_m: float = 20_000.0
    step_limit_rad: float = float(np.deg2rad(1.0))
    speed_limit_rad_s: float = float(np.deg2rad(5.0))
    touch_n: float = 4.0
    smallest_step_rad: float = float(np.deg2rad(0.002))
    stale_after_s: float = 0.2
    resume_after_s: float = 1.0
    joint_speed_rad_s: float = float(np.deg2rad(20.0))
    settle_s: float = 0.5
    joint_limit_rad: float = float(np.deg2rad(10.0))
    measure_s: float = 0.1
    confirm_rad: float = float(np.deg2rad(0.45))
    confirm_s: float = 1.0
    yield_s: float = 2.0
    await_command: bool = False


class ContactForce(NamedTuple):
    """An estimated contact: a force (3,) in base axes, N, on segment `segment` (from 1)."""

    segment: int
    force_base_n: Array


class AdmittanceLaw:
    """Steps for one arm."""

    def __init__(self, mechanism: Mechanism, reach: Reach, settings: AdmittanceSettings) -> None:
        self._mechanism = mechanism
        self.reach = reach
        self.settings = settings

    def step(
        self, command_rad: Array, home_rad: Array, contact: ContactForce | None, elapsed_s: float
    ) -> Array:
        """The next command (2N,), `elapsed_s` after the last; the same where no step is worth it.

        `command_rad` (2N,) is in force, `home_rad` (2N,) is where to be when nothing touches, and
        no contact is a sure "nothing touches".
        """
        period_s, given = min(elapsed_s, LONGEST_STEP_S), self.settings
        away = command_rad - home_rad
        step = (
            self._homeward(command_rad, away, period_s)
            if contact is None
            else self._yielding(command_rad, away, contact, period_s)
        )
        largest = float(np.abs(step).max())
        limit = min(given.step_limit_rad, given.speed_limit_rad_s * period_s)
        if largest > limit:
            step = step * (limit / largest)
        target = self.reach.nearest(command_rad + step)
        worth_it = np.abs(target - command_rad).max() >= given.smallest_step_rad
        return target if worth_it else command_rad

    def loop_gain(
        self,
        command_rad: Array,
        segment: int,
        direction: Array,
        stiffness_n_m: float,
        step_s: float,
    ) -> float:
        """How much of a contact's force above its rest one unlimited step takes away, as a share.

        Below 1 the force falls without overshoot, below 2 the loop is stable; `direction` (3,) is
        the force's in base axes, `stiffness_n_m` the contact's.
        """
        squared = float(np.sum((self._jacobian(command_rad, segment).T @ direction) ** 2))
        implicit = self.settings.worst_stiffness_n_m * squared
        return stiffness_n_m * squared / (self._diagonal(step_s) + implicit)

    def _homeward(self, command_rad: Array, away: Array, period_s: float) -> Array:
        step = -away * (self.settings.return_stiffness_n_m_rad / self._diagonal(period_s))
        jacobians = kinematics.contact_jacobians_m(self._mechanism, command_rad)
        moved = float(np.linalg.norm(jacobians @ step, axis=-1).max())
        touching_n = self.settings.worst_stiffness_n_m * moved
        return step * min(1.0, self.settings.touch_n / max(touching_n, 1e-12))

    def _yielding(
        self, command_rad: Array, away: Array, contact: ContactForce, period_s: float
    ) -> Array:
        given, force_n = self.settings, contact.force_base_n
        magnitude_n = float(np.linalg.norm(force_n))
        if magnitude_n == 0.0:
            return np.zeros_like(command_rad)
        lever = self._jacobian(command_rad, contact.segment).T @ (force_n / magnitude_n)
        torque = lever * magnitude_n - given.return_stiffness_n_m_rad * away
        size, friction = np.linalg.norm(torque), given.deadband_n * np.linalg.norm(lever)
        if size <= friction:
            return np.zeros_like(command_rad)
        torque = torque * (1.0 - friction / size)
        diagonal, stiffness = self._diagonal(period_s), given.worst_stiffness_n_m
        implicit = stiffness * float(lever @ torque)
        implicit /= diagonal + stiffness * float(lever @ lever)
        return (torque - lever * implicit) / diagonal

    def _jacobian(self, command_rad: Array, segment: int) -> Array:
        """(3, 2N) of a segment's contact point."""
        return np.asarray(
            kinematics.contact_jacobians_m(self._mechanism, command_rad)[segment - 1]
        )

    def _diagonal(self, period_s: float) -> float:
        given = self.settings
        return given.damping_n_m_s_rad / max(period_s, 1e-6) + given.return_stiffness_n_m_rad


FEWEST_SAMPLES = 3


_SAME_N = 5.0
"""A confirmed contact whose force changes by more, and by more than itself, is a new one."""


class Confirmation:
    """Whether the present contact was seen in two poses, and how far it is yielded to until then.

    What fits a force in one pose may be a fault; in another, readings of most faults do not fit.

    Attributes:
        confirmed: whether the present contact is; also where there is none.
    """

    def __init__(self, settings: AdmittanceSettings) -> None:
        self._turn_rad, self._measure_s = settings.confirm_rad, settings.measure_s
        self._confirm_s = max(settings.confirm_s, settings.measure_s)
        self.forget()

    def forget(self) -> None:
        """There is no contact."""
        self._contact: ContactForce | None = None
        self._from_rad = np.zeros(0)
        self.confirmed = True

    def seen(self, contact: ContactForce | None, command_rad: Array) -> None:
        """A contact was measured at a command (2N,), or that there is none."""
        if contact is None:
            self.forget()
        elif not self._same(contact):
            if self.confirmed:
                self._from_rad = command_rad
            self._contact, self.confirmed = contact, False
        elif not self.confirmed and self._turned(command_rad):
            self.confirmed = True

    def span_s(self, command_rad: Array) -> float:
        """For how long to measure at a command (2N,)."""
        waits = not self.confirmed and self._turned(command_rad)
        return self._confirm_s if waits else self._measure_s

    def shortened(self, command_rad: Array, target_rad: Array) -> Array:
        """The part of the way to a target (2N,) that may be gone."""
        step = target_rad - command_rad
        if self.confirmed or not step.any():
            return target_rad
        left = self._turn_rad - np.sign(step) * (command_rad - self._from_rad)
        share = np.min(left[step != 0.0] / np.abs(step[step != 0.0]))
        return np.asarray(command_rad + step * float(np.clip(share, 0.0, 1.0)))

    def _same(self, contact: ContactForce) -> bool:
        before = self._contact
        if before is None or before.segment != contact.segment:
            return False
        changed_n = float(np.linalg.norm(contact.force_base_n - before.force_base_n))
        return changed_n <= max(_SAME_N, float(np.linalg.norm(before.force_base_n)))

    def _turned(self, command_rad: Array) -> bool:
        return bool(np.abs(command_rad - self._from_rad).max() >= (1.0 - 1e-6) * self._turn_rad)


class ForceAverage:
    """Averages forces in a segment's axes over a stretch of stamps, all of the same command.

    A sample without contact counts as no force, so that one that is doubtful weakens the answer.
    Where samples name several segments, those of the most frequent one count.
    """

    def __init__(self, longest_gap_s: float) -> None:
        """A gap longer than `longest_gap_s` begins anew."""
        self._longest_gap_ns = round(longest_gap_s * 1e9)
        self._samples: list[tuple[int, int, Array]] = []

    def clear(self) -> None:
        """Begin anew."""
        self._samples.clear()

    def add(self, stamp_ns: int, segment: int, force_n: Array) -> None:
        """A sample's force (3,) in its segment's axes; segment 0 is no contact."""
        if self._samples and not 0 < stamp_ns - self._samples[-1][0] <= self._longest_gap_ns:
            self._samples.clear()
        self._samples.append((stamp_ns, segment, force_n))

    def spans(self, seconds: float) -> bool:
        """Whether the samples do."""
        return (
            len(self._samples) >= FEWEST_SAMPLES
            and self._samples[-1][0] - self._samples[0][0] >= seconds * 1e9
        )

    def take(self) -> tuple[int, Array]:
        """Segment and mean force (3,) in its axes, N; (0, zero) for no contact. Begins anew."""
        touched = Counter(segment for _, segment, _ in self._samples if segment)
        segment = touched.most_common(1)[0][0] if touched else 0
        total = sum(
            (force for _, number, force in self._samples if number == segment and segment),
            start=np.zeros(3),
        )
        mean = total / max(len(self._samples), 1)
        self.clear()
        return segment, np.asarray(mean)
