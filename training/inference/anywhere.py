"""A model of contacts anywhere: its graph makes a `TorqueBalance` (`networks.statics`).

The posterior of place and force in the reach follows (`cablesense_sim.contact_location`).
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import (
    ContactPair,
    Location,
    TorqueBalance,
    compiled_input,
    is_known,
    locate,
    locate_two,
    touched_at,
)
from cablesense_training.inference.estimator import (
    NORMAL_95,
    ContactPlace,
    Estimate,
    Estimates,
    Estimator,
)

BALANCE_OUTPUTS = ("torque_n_m", "precision", "by_force_m", "by_place", "by_twist", "residual")

_NUMBERS = 4
"""Of one contact: the components of its force, and its place."""


class AnywhereEstimator(Estimator):
    """A model of one or two contacts anywhere, opened; not for several threads at once.

    Attributes:
        reach_m: (N, 2) where each segment can be touched, from its joint centre.
        surface: where it is touched with friction; None where contacts act on the axis.
        torque_covariance_n2_m2: (2N, 2N) of what else may turn the joints, as damping does in
            motion; None without. Batches do without.
    """

    outputs = BALANCE_OUTPUTS
    torque_covariance_n2_m2: Array | None = None

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        super().__init__(path, arm)
        self.reach_m, self.surface = touched_at(arm or self.metadata.arm)
        length_m = mechanism_of(self.metadata.arm).segment_length_m
        self._joint_m = [0.0, *np.cumsum(length_m).tolist()]
        from cablesense_sim.contact_posterior import locate_each, unfilled

        # views of the buffers that every single sample is answered in; the precision is that of
        # the pose, and is written with a new one only
        stated = TorqueBalance(*(part[None] for part in self._single.outputs[:-1]))
        self._precision = stated.precision[0]
        self._balance = stated._replace(precision=stated.precision.copy())
        self._found = unfilled(1, len(self.reach_m))
        posterior_input = compiled_input(self._balance, self.reach_m, self.surface)
        self._locate = partial(locate_each, *posterior_input, self._found)

    def locate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> tuple[Location, Array]:
        """Contacts behind differences (B, M) at commands (B, 2N) or (2N,), and misfits (B,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        balance, residual = self.balance_batch(tension_differences_n, joint_commands_rad)
        found = locate(balance, self.reach_m, self.surface)
        misfits = map(_misfit, found.chi2.tolist(), residual)
        return found, np.array(list(misfits))

    def balance_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> tuple[TorqueBalance, Array]:
        """The balance of torques of differences (B, M), and the residuals (B, M) of lengths.

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        *balance, residual = self._batch(tension_differences_n, joint_commands_rad)
        return TorqueBalance(*balance), residual

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> Estimates:
        """See the base class: the normal force of one contact each, wherever it acts."""
        balance, residual = self.balance_batch(tension_differences_n, joint_commands_rad)
        found = locate(balance, self.reach_m, self.surface)
        each = [self._estimate(found, row, residual[row]) for row in range(len(residual))]
        return Estimates(*map(np.array, zip(*(one[:-1] for one in each), strict=True)))

    def prepare(self) -> None:
        """Compile now what the first contact would wait for, for many seconds once a machine."""
        arm = self.metadata.arm
        self.estimate(np.zeros(arm.cable_count), np.zeros(arm.joint_count))
        self.two()

    def two(self) -> tuple[ContactPair, float]:
        """Two contacts behind the sample that was estimated last, and their misfit."""
        pair = locate_two(self._balance, self.reach_m, surface=self.surface)
        return pair, _misfit(pair.chi2.item(), self._single.outputs[-1], 2)

    def _of_one(self, outputs: list[Array]) -> Estimate:
        precision = self._precision
        if (further := self.torque_covariance_n2_m2) is not None:
            precision = np.linalg.solve(np.eye(len(further)) + precision @ further, precision)
        self._balance.precision[0] = precision
        self._locate()
        return self._estimate(self._found, 0, outputs[-1])

    def _estimate(self, found: Location, row: int, residual: Array) -> Estimate:
        """One of the located samples, whose cables have these residuals (M,)."""
        _, force_y, force_z = force = found.force_n[row].tolist()
        low_n, high_n = found.magnitude_ci95_n[row].tolist()
        size_n = max(math.hypot(force_y, force_z), 1e-9)
        covariance, probabilities = found.covariance[row].copy(), found.probability[row].copy()
        (yy, yz), (_, zz) = covariance[2:, 2:].tolist()
        across = force_z**2 * yy + force_y**2 * zz - 2.0 * force_y * force_z * yz
        own_m = self._joint_m[int(probabilities[1:].argmax())]
        ends = zip(found.region_segment[row].tolist(), found.region_m[row].tolist(), strict=True)
        low_m, high_m = (self._joint_m[segment - 1] - own_m + end_m for segment, end_m in ends)
        chi2 = found.chi2.item(row)
        return Estimate(
            probabilities=probabilities,
            segment=found.segment.item(row),
            angle_deg=math.degrees(math.atan2(force_y, force_z)) % 360.0,
            magnitude_n=size_n,
            magnitude_std_n=(high_n - low_n) / (2.0 * NORMAL_95),
            angle_std_deg=math.degrees(math.atan(math.sqrt(max(across, 0.0)) / size_n**2)),
            low_n=low_n,
            high_n=high_n,
            place=ContactPlace(
                place_m=found.place_m.item(row),
                low_m=low_m,
                high_m=high_m,
                along_n=force[0],
                covariance=covariance,
                moment_n_m=math.hypot(*found.moment_n_m[row].tolist()),
                force_known=is_known(high_n - low_n, size_n),
                misfit=_misfit(chi2, residual),
                log_evidence=found.log_evidence.item(row),
                chi2=max(chi2, 0.0),
            ),
        )


def _misfit(chi2: float, residual: Array, contacts: int = 1) -> float:
    """Root mean square of all residuals, by chi² of torques and residuals (M,) of lengths."""
    free = max(len(residual) - _NUMBERS * contacts, 1)
    return math.sqrt((max(chi2, 0.0) + float(residual.dot(residual))) / free)
