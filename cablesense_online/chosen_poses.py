"""Which unloaded poses teach most about a machine, in which order.

Poses are chosen one by one from random candidates. Each unloaded reading will lower the covariance
Σ of the machine's parameters, whatever it reads; taken is the candidate after which contacts will
be known best, by the determinant of their information (D-optimal; Fedorov, Theory of Optimal
Experiments, 1972), on average over the reference contacts. How far cables have slid at their
guides is another unknown in each pose, so it counts as noise.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import MODEL_STD_N, Calibration, Calibrator
from cablesense_contact.felt import torque_covariance_at_rest
from cablesense_contact.law import Law
from cablesense_online.movable import TAUT_SHARE, Movable, taut

READINGS = 20
"""Averaged in a pose, unless told otherwise: of more, the noise of the mean is lower, but it is no
longer what limits how well a force is known."""
_FEWEST_CANDIDATES = 160
"""Random poses of which those are chosen that teach most."""
_CANDIDATES_PER_POSE = 2
"""At least so many: some leave a cable slack, and the rest are to be chosen among."""


class PoseError(CableSenseError):
    """A machine without enough poses in which all its cables are taut."""


def chosen_poses(
    movable: Movable,
    law: Law,
    count: int,
    bend_rad: float,
    readings: int = READINGS,
    seed: int = 0,
) -> Array:
    """Commands (K, C) that teach most about a machine, in an order that takes short moves.

    Args:
        movable: the machine, whose tolerances say what is unknown.
        law: of this machine.
        count: how many poses K.
        bend_rad: of each joint angle from the first command, at most.
        readings: how many are averaged in each.
        seed: of the candidates.

    Raises:
        PoseError: in too few poses all cables are taut.
    """
    felt = movable.felt
    prior = Calibrator(felt, law).by_tolerances()
    tried = max(_FEWEST_CANDIDATES, _CANDIDATES_PER_POSE * count)
    drawn = movable.candidates(tried, bend_rad, np.random.default_rng(seed))
    candidates = drawn[taut(movable, drawn, prior)]
    if len(candidates) < count:
        raise PoseError(
            f"only {len(candidates)} of {tried} poses within {np.rad2deg(bend_rad):.1f} "
            f"degrees leave all cables of {felt.name} above {TAUT_SHARE:.0%} of their pretension; "
            f"{count} are needed: bend less, or give more pretension"
        )
    design = _Design(movable, law, prior, readings)
    slopes, noise_n2 = design.seen_from(candidates)
    remaining = np.arange(len(candidates))
    chosen = []
    for _ in range(count):
        best = int(design.information(slopes[remaining], noise_n2[remaining]).argmax())
        taken = remaining[best]
        design.add(slopes[taken], noise_n2[taken])
        chosen.append(taken)
        remaining = np.delete(remaining, best)
    return _tour(candidates[chosen], felt.first_command)


class _Design:
    """The covariance that chosen poses will leave, and what it means for the contacts.

    Lasting parameters are all but what friction carries, which is another in each pose.
    """

    def __init__(self, movable: Movable, law: Law, prior: Calibration, readings: int) -> None:
        felt = movable.felt
        self._law = law
        self._prior = prior
        self._movable = movable
        self._covariance_at_rest = torque_covariance_at_rest(felt)
        self._carried = np.zeros(len(prior.mean), dtype=bool)
        self._carried[felt.carried_friction] = True
        self._carried_variance = np.diagonal(prior.covariance)[self._carried]
        self._mean_variance_n2 = felt.mean_variance(readings) + MODEL_STD_N**2
        contacts = movable.reference_contacts()
        seen = contacts.response(law, prior.mean, prior.covariance)
        self._by_contact = seen.by_contact
        self._prior_precision = contacts.prior_precision
        self._by_lasting, self._contact_noise_n2 = self._parted(
            seen.by_parameter, felt.mean_variance(1)
        )
        self.covariance = prior.covariance[np.ix_(~self._carried, ~self._carried)]

    def seen_from(self, candidates: Array) -> tuple[Array, Array]:
        """Slopes (K, M, L) by lasting parameters, and noise (K, M, M), of unloaded readings."""
        reading_n = self._movable.predicted_n(candidates, self._prior)
        belief = (self._prior.mean, self._prior.covariance, self._covariance_at_rest)
        slopes = self._law(reading_n, candidates, *belief).by_parameter
        return self._parted(slopes, self._mean_variance_n2)

    def information(self, slopes: Array, noise_n2: Array) -> Array:
        """(K,) what contacts will be known by after one more reading: mean log determinant."""
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

    def _parted(self, slopes: Array, variance_n2: Array) -> tuple[Array, Array]:
        """Slopes by lasting parameters, and the noise of sensors (M,) and friction together."""
        by_carried = slopes[..., self._carried]
        noise_n2 = (by_carried * self._carried_variance) @ by_carried.transpose(0, 2, 1)
        return slopes[..., ~self._carried], noise_n2 + np.diag(variance_n2)


def _tour(poses: Array, first: Array) -> Array:
    """The poses (K, C) from the one nearest to the first command on, always the nearest next."""
    remaining = list(range(len(poses)))
    present_pose = first
    order = []
    while remaining:
        turns = np.abs(poses[remaining] - present_pose).max(axis=1)
        nearest = remaining.pop(int(turns.argmin()))
        order.append(nearest)
        present_pose = poses[nearest]
    return poses[order]
