"""Which unloaded poses teach most about an arm, in which order.

Poses are chosen one by one from random candidates. Each unloaded reading will lower the covariance
Σ of the arm's parameters, whatever it reads; taken is the candidate after which contacts will be
known best, by the determinant of their information (D-optimal; Fedorov, Theory of Optimal
Experiments, 1972), on average over the reference contacts. How far cables have slid at their
guides is another unknown in each pose, so it counts as noise.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import MODEL_STD_N, Calibration, Calibrator
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.law import Law
from cablesense_contact.reference_contacts import ReferenceContacts
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import mean_variance_n2, reading_variance_n2

POSES = 25
"""Of a commissioning, unless a user states another number."""
BEND_RAD = float(np.deg2rad(10.0))
"""Largest joint angle of a pose, unless a user states another one."""
READINGS = 20
"""Averaged in a pose: fifty lower the deviation of a force by four hundredths."""
_CANDIDATES = 160
"""Random poses of which those are chosen that teach most."""
_TAUT_SHARE = 0.2
"""A cable is taut for certain above this share of its pretension."""
_BEND_SHARE = 0.8
"""Joints stay within this share of the bend at which guide plates meet."""
_PREDICTION_STEPS = 6
"""Newton steps from the pretension to the reading in a pose."""
_PREDICTED_N = 0.01
"""Change of a reading that is too small to continue them."""


class PoseError(CableSenseError):
    """An arm without enough poses in which all its cables are taut."""


class UnloadedReadings:
    """Predicts what an arm reads without a load, by the law and a calibration."""

    def __init__(self, arm: Arm, law: Law) -> None:
        self._law = law
        self._start_n = np.full(arm.cable_count, float(arm.cables.pretension_n))
        self._taut_n = _TAUT_SHARE * arm.cables.pretension_n
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))

    def predicted_n(self, command_rad: Array, calibration: Calibration) -> Array:
        """Readings (K, M) at commands (K, 2N); those of nearly slack cables are too high."""
        reading_n = np.tile(self._start_n, (len(command_rad), 1))
        belief = (calibration.mean, calibration.covariance, self._unrest)
        for _ in range(_PREDICTION_STEPS):
            change_n = -self._law(reading_n, command_rad, *belief).innovation_n
            # kept taut: where a cable is slack the law may not be solvable
            reading_n = np.maximum(reading_n + change_n, 0.5 * self._taut_n)
            if np.abs(change_n).max() < _PREDICTED_N:
                break
        return reading_n

    def taut(self, command_rad: Array, calibration: Calibration) -> Array:
        """(K,) whether all cables are well above zero at commands (K, 2N)."""
        return np.asarray(self.predicted_n(command_rad, calibration).min(axis=1) > self._taut_n)


def chosen_poses(
    arm: Arm,
    law: Law,
    count: int = POSES,
    bend_rad: float = BEND_RAD,
    readings: int = READINGS,
    seed: int = 0,
) -> Array:
    """Commands (K, 2N) that teach most about an arm, in an order that takes short moves.

    Args:
        arm: whose tolerances say what is unknown.
        law: of this arm.
        count: how many poses K.
        bend_rad: of each joint angle, at most.
        readings: how many are averaged in each.
        seed: of the candidates.

    Raises:
        PoseError: in too few poses all cables are taut.
    """
    prior = Calibrator(FeltArm(arm), law).by_tolerances()
    candidates = _candidates(arm, law, prior, bend_rad, np.random.default_rng(seed))
    if len(candidates) < count:
        raise PoseError(
            f"only {len(candidates)} of {_CANDIDATES} poses within {np.rad2deg(bend_rad):.1f} "
            f"degrees leave all cables of {arm.name} above {_TAUT_SHARE:.0%} of their pretension; "
            f"{count} are needed: bend less, or give more pretension"
        )
    design = _Design(arm, law, prior, readings)
    slopes, noise_n2 = design.seen_from(candidates)
    remaining = np.arange(len(candidates))
    chosen = []
    for _ in range(count):
        best = int(design.information(slopes[remaining], noise_n2[remaining]).argmax())
        taken = remaining[best]
        design.add(slopes[taken], noise_n2[taken])
        chosen.append(taken)
        remaining = np.delete(remaining, best)
    return _tour(candidates[chosen])


def _candidates(
    arm: Arm, law: Law, prior: Calibration, bend_rad: float, rng: np.random.Generator
) -> Array:
    """Poses (C, 2N), the straight one first, in which the arm of the file has no slack cable."""
    drawn = rng.uniform(-bend_rad, bend_rad, (_CANDIDATES, arm.joint_count))
    # poses near the ends of the range teach most, so half of them are drawn nearer to these
    inner = _CANDIDATES // 2
    drawn[inner:] = np.sign(drawn[inner:]) * np.sqrt(np.abs(drawn[inner:]) * bend_rad)
    drawn[0] = 0.0
    limit_rad = _BEND_SHARE * mechanism_of(arm).bend_limit_rad
    shrink = np.minimum(1.0, limit_rad / np.maximum(kinematics.bend_rad(drawn), 1e-9))
    drawn *= np.repeat(shrink, 2, axis=1)
    return drawn[UnloadedReadings(arm, law).taut(drawn, prior)]


class _Design:
    """The covariance that chosen poses will leave, and what it means for the contacts.

    Lasting parameters are all but what friction carries, which is another in each pose.
    """

    def __init__(self, arm: Arm, law: Law, prior: Calibration, readings: int) -> None:
        self._law = law
        self._prior = prior
        self._predicted = UnloadedReadings(arm, law)
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))
        self._carried = np.zeros(len(prior.mean), dtype=bool)
        self._carried[FeltArm(arm).carried_friction] = True
        self._carried_variance = np.diagonal(prior.covariance)[self._carried]
        self._mean_variance_n2 = mean_variance_n2(arm.sensors, readings) + MODEL_STD_N**2
        contacts = ReferenceContacts.of_arm(arm)
        seen = contacts.response(law, prior.mean, prior.covariance)
        self._by_contact = seen.by_contact
        self._prior_precision = contacts.prior_precision
        self._by_lasting, self._contact_noise_n2 = self._parted(
            seen.by_parameter, reading_variance_n2(arm.sensors)
        )
        self.covariance = prior.covariance[np.ix_(~self._carried, ~self._carried)]

    def seen_from(self, candidates: Array) -> tuple[Array, Array]:
        """Slopes (C, M, L) by lasting parameters, and noise (C, M, M), of unloaded readings."""
        reading_n = self._predicted.predicted_n(candidates, self._prior)
        belief = (self._prior.mean, self._prior.covariance, self._unrest)
        slopes = self._law(reading_n, candidates, *belief).by_parameter
        return self._parted(slopes, self._mean_variance_n2)

    def information(self, slopes: Array, noise_n2: Array) -> Array:
        """(C,) what contacts will be known by after one more reading: mean log determinant."""
        of_contacts = self._by_lasting @ self.covariance
        spread = of_contacts @ self._by_lasting.transpose(0, 2, 1) + self._contact_noise_n2
        crossed = of_contacts[:, None] @ slopes.transpose(0, 2, 1)
        innovation = slopes @ self.covariance @ slopes.transpose(0, 2, 1) + noise_n2
        whitened = np.linalg.inv(np.linalg.cholesky(innovation)).transpose(0, 2, 1)
        learnt = crossed @ whitened
        spread_after = spread[:, None] - learnt @ learnt.transpose(0, 1, 3, 2)
        by_contact = self._by_contact[:, None]
        known = by_contact.transpose(0, 1, 3, 2) @ np.linalg.solve(spread_after, by_contact)
        known = known + self._prior_precision[:, None]
        return np.asarray(np.linalg.slogdet(known)[1].mean(axis=0))

    def add(self, slope: Array, noise_n2: Array) -> None:
        """Take a reading with this slope (M, L) and noise (M, M)."""
        shown = slope @ self.covariance
        gained = shown.T @ np.linalg.solve(shown @ slope.T + noise_n2, shown)
        covariance = self.covariance - gained
        self.covariance = 0.5 * (covariance + covariance.T)

    def _parted(self, slopes: Array, variance_n2: float) -> tuple[Array, Array]:
        """Slopes by lasting parameters, and the noise of sensors and friction together."""
        by_carried = slopes[..., self._carried]
        noise_n2 = (by_carried * self._carried_variance) @ by_carried.transpose(0, 2, 1)
        return slopes[..., ~self._carried], noise_n2 + variance_n2 * np.eye(slopes.shape[1])


def _tour(poses: Array) -> Array:
    """The poses (K, 2N) from the one nearest to straight on, always the nearest one next."""
    remaining = list(range(len(poses)))
    present_pose = np.zeros(poses.shape[1])
    order = []
    while remaining:
        turns = np.abs(poses[remaining] - present_pose).max(axis=1)
        nearest = remaining.pop(int(turns.argmin()))
        order.append(nearest)
        present_pose = poses[nearest]
    return poses[order]
