"""A model of contacts anywhere: the balance of torques from the graph, then its posterior.

The graph makes a `TorqueBalance` of tensions (`networks.anywhere`); the posterior of place and
force within the arm's reach follows from it (`cablesense_sim.contact_location`).
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
    """

    outputs = BALANCE_OUTPUTS

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        super().__init__(path, arm)
        self.reach_m, self.surface = touched_at(arm or self.metadata.arm)
        length_m = mechanism_of(self.metadata.arm).segment_length_m
        self._joint_m = np.concatenate([[0.0], np.cumsum(length_m)])
        from cablesense_sim.contact_posterior import locate_each, unfilled

        # views of the buffers that every single sample is answered in
        self._balance = TorqueBalance(*(part[None] for part in self._single.outputs[:-1]))
        self._found = unfilled(1, len(self.reach_m))
        posterior_input = compiled_input(self._balance, self.reach_m, self.surface)
        self._locate = partial(locate_each, *posterior_input, self._found)

    def locate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> tuple[Location, Array]:
        """The contacts behind differences (B, M) at commands (B, 2N) or (2N,), and misfits (B,).

        Raises:
            EstimateError: see its docstring.
        """
        balance, residual = self.balance_batch(tension_differences_n, joint_commands_rad)
        found = locate(balance, self.reach_m, self.surface)
        return found, _misfit(found.chi2, residual, 1)

    def balance_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> tuple[TorqueBalance, Array]:
        """The balance of torques of differences (B, M), and the residuals (B, M) of lengths.

        Raises:
            EstimateError: see its docstring.
        """
        *balance, residual = self._batch(tension_differences_n, joint_commands_rad)
        return TorqueBalance(*balance), residual

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> Estimates:
        """See the base class: the normal force of one contact each, wherever it acts."""
        found, _ = self.locate_batch(tension_differences_n, joint_commands_rad)
        y, z = found.force_n[:, 1:].T
        magnitude_n, angle_std_deg = _polar(found)
        angle_deg = np.rad2deg(np.arctan2(y, z)) % 360.0
        low_n, high_n = found.magnitude_ci95_n.T
        std_n = (high_n - low_n) / (2.0 * NORMAL_95)
        stated = (angle_deg, magnitude_n, std_n, angle_std_deg, low_n, high_n)
        return Estimates(found.probability, found.segment, *stated)

    def prepare(self) -> None:
        """Compile now what the first contact would wait for, for many seconds once a machine."""
        arm = self.metadata.arm
        self.estimate(np.zeros(arm.cable_count), np.zeros(arm.joint_count))
        self.two()

    def two(self) -> tuple[ContactPair, float]:
        """Two contacts behind the sample that was estimated last, and their misfit."""
        pair = locate_two(self._balance, self.reach_m, surface=self.surface)
        return pair, float(_misfit(pair.chi2, self._single.outputs[-1][None], 2)[0])

    def _region_m(self, found: Location) -> list[float]:
        """Ends of the region of one contact along the arm, from its segment's joint centre."""
        segment = 1 + int(found.probability[0, 1:].argmax())
        joint_m = self._joint_m[found.region_segment[0] - 1] - self._joint_m[segment - 1]
        return (joint_m + found.region_m[0]).tolist()

    def _of_one(self, outputs: list[Array]) -> Estimate:
        self._locate()
        found = self._found
        _, force_y, force_z = force = found.force_n[0].tolist()
        low_m, high_m = self._region_m(found)
        low_n, high_n = found.magnitude_ci95_n[0].tolist()
        size_n = max(math.hypot(force_y, force_z), 1e-9)
        covariance = found.covariance[0].copy()
        (yy, yz), (_, zz) = covariance[2:, 2:].tolist()
        across = force_z**2 * yy + force_y**2 * zz - 2.0 * force_y * force_z * yz
        chi2, residual = max(found.chi2.item(), 0.0), outputs[-1]
        free = max(len(residual) - _NUMBERS, 1)
        return Estimate(
            probabilities=found.probability[0].copy(),
            segment=found.segment.item(),
            angle_deg=math.degrees(math.atan2(force_y, force_z)) % 360.0,
            magnitude_n=size_n,
            magnitude_std_n=(high_n - low_n) / (2.0 * NORMAL_95),
            angle_std_deg=math.degrees(math.atan(math.sqrt(max(across, 0.0)) / size_n**2)),
            low_n=low_n,
            high_n=high_n,
            place=ContactPlace(
                place_m=found.place_m.item(),
                low_m=low_m,
                high_m=high_m,
                along_n=force[0],
                covariance=covariance,
                moment_n_m=math.hypot(*found.moment_n_m[0].tolist()),
                force_known=is_known(high_n - low_n, size_n),
                misfit=math.sqrt((chi2 + float(residual.dot(residual))) / free),
                log_evidence=found.log_evidence.item(),
                chi2=chi2,
            ),
        )


def _misfit(chi2: Array, residual: Array, contacts: int) -> Array:
    """(B,) root mean square of all residuals, by chi² of torques (B,) and residuals (B, M)."""
    free = max(residual.shape[1] - _NUMBERS * contacts, 1)
    squared = np.maximum(chi2, 0.0) + (residual * residual).sum(axis=1)
    return np.asarray(np.sqrt(squared / free))


def _polar(found: Location) -> tuple[Array, Array]:
    """Mean normal force (B,), N, and standard deviation of its angle (B,), deg."""
    (y, z), lateral = found.force_n[:, 1:].T, found.covariance[:, 2:, 2:]
    size = np.maximum(np.hypot(y, z), 1e-9)
    beside = np.stack([z, -y], axis=1) / size[:, None]
    variance = np.einsum("bi,bij,bj->b", beside, lateral, beside)
    return size, np.rad2deg(np.arctan(np.sqrt(np.maximum(variance, 0.0)) / size))
