"""Estimators of the paper's networks, in model files: one contact, or several, from each sample.

They take tension differences against the unloaded arm, N; pose-aware models also the commanded
joint angles, rad. An `EstimateError` refuses inputs of a wrong shape or that are not finite, a
command that is missing, and answers that are not finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_contact.commands import require_commands
from cablesense_contact.errors import EstimateError
from cablesense_contact.estimate import NORMAL_95, Estimate
from cablesense_contact.inference.plausibility import ContactSubspace
from cablesense_contact.inference.session import COMMAND, TENSION, OpenedModel

OUTPUTS = ("contact_probability", "direction", "magnitude_n", "magnitude_std_n", "angle_std_deg")
MULTI_OUTPUTS = ("contact_probability", "magnitude_n", "magnitude_std_n")


class Estimates(NamedTuple):
    """B estimates: the fields of `Estimate` but its place, with a leading axis."""

    probabilities: Array
    segment: NDArray[np.int64]
    angle_deg: Array
    magnitude_n: Array
    magnitude_std_n: Array
    angle_std_deg: Array
    low_n: Array
    high_n: Array
    misfit_n: Array
    plausible: NDArray[np.bool_]

    @classmethod
    def of_outputs(
        cls,
        outputs: Sequence[Array],
        misfit_n: Array | None = None,
        plausible: NDArray[np.bool_] | None = None,
    ) -> Estimates:
        """Estimates from a model's `OUTPUTS`; without a misfit (B,) all are plausible."""
        probability, direction, magnitude_n, std_n, angle_std_deg = outputs
        # twice, as the remainder of a tiny negative angle rounds to 360
        angle_deg = np.rad2deg(np.arctan2(direction[:, 0], direction[:, 1])) % 360.0 % 360.0
        half_n = NORMAL_95 * std_n
        return cls(
            probabilities=probability,
            segment=probability.argmax(axis=1),
            angle_deg=angle_deg,
            magnitude_n=magnitude_n,
            magnitude_std_n=std_n,
            angle_std_deg=angle_std_deg,
            low_n=np.maximum(0.0, magnitude_n - half_n),
            high_n=magnitude_n + half_n,
            misfit_n=np.zeros(len(magnitude_n)) if misfit_n is None else misfit_n,
            plausible=np.ones(len(magnitude_n), bool) if plausible is None else plausible,
        )

    def first(self) -> Estimate:
        """The first of them."""
        numbers = self._fields[1:]
        stated: dict[str, Any] = {name: getattr(self, name)[0].item() for name in numbers}
        return Estimate(probabilities=self.probabilities[0].copy(), **stated)


def finite_table(values: ArrayLike, columns: int, what: str, rows: int | None = None) -> Array:
    """Finite numbers (B, columns) from (B, columns) or (columns,), of `rows` or any number."""
    try:
        table = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise EstimateError(f"{what} must be numbers, equally many a sample ({error})") from error
    if table.ndim == 1:
        table = table[None]
    if table.ndim != 2 or not len(table):
        raise EstimateError(f"{what} of shape {table.shape}; needed is at least one row")
    if table.shape[1] != columns or (rows is not None and len(table) != rows):
        raise EstimateError(f"{what} of shape {np.shape(values)}; this model needs {columns}")
    if not np.isfinite(table).all():
        raise EstimateError(f"{what} must be finite; one is NaN or infinite")
    return table


class NetworkEstimator(OpenedModel):
    """The common base of estimators."""

    def _outputs(
        self, tensions_n: ArrayLike, commands_rad: ArrayLike | None, rows: int | None = None
    ) -> list[Array]:
        """The outputs for tension differences (B, M) or (M,) and commands (B, 2N) or (2N,)."""
        cables = self.metadata.arm.cable_count
        inputs = {TENSION: finite_table(tensions_n, cables, "tension differences", rows)}
        if self.pose_aware:
            inputs[COMMAND] = self._commands(commands_rad, len(inputs[TENSION]))
        outputs = self.run(inputs)
        if not all(np.isfinite(output).all() for output in outputs):
            raise EstimateError(
                "the answer is not finite: tension differences or commands beyond what can be "
                "weighed"
            )
        return outputs

    def _commands(self, values: ArrayLike | None, rows: int) -> Array:
        """(B, 2N), one command for all where only one is given."""
        count = self.metadata.arm.joint_count
        if values is None:
            raise EstimateError(f"this model needs the {count} commanded joint angles")
        command = finite_table(values, count, "commanded joint angles")
        if len(command) not in (1, rows):
            raise EstimateError(
                f"{len(command)} commands for {rows} samples; this model needs {count} joint "
                "angles, once or for each sample"
            )
        require_commands(command)
        return np.ascontiguousarray(np.broadcast_to(command, (rows, count)))

    def _plausibility(
        self, tensions_n: ArrayLike, commands_rad: ArrayLike | None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """(B,) RMS of differences that no force makes, and whether each is little enough.

        A network that is not pose-aware is one of the straight arm.
        """
        arm = self.metadata.arm
        differences_n = finite_table(tensions_n, arm.cable_count, "tension differences")
        poses_rad = np.zeros((len(differences_n), arm.joint_count))
        if commands_rad is not None:
            poses_rad = self._commands(commands_rad, len(differences_n))
        subspace = ContactSubspace(arm, self.metadata.tare_samples)
        return subspace.judged(differences_n, poses_rad)


class Estimator(NetworkEstimator):
    """A single-contact model, opened; not for use from several threads at once.

    An `EstimateError` refuses inputs that it cannot take, and answers that are not finite.
    """

    outputs: ClassVar[Sequence[str]] = OUTPUTS

    def estimate(
        self, tension_difference_n: ArrayLike, joint_command_rad: ArrayLike | None = None
    ) -> Estimate:
        """The contact behind tension differences (M,) at commanded joint angles (2N,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        outputs = self._outputs(tension_difference_n, joint_command_rad, rows=1)
        plausibility = self._plausibility(tension_difference_n, joint_command_rad)
        return Estimates.of_outputs(outputs, *plausibility).first()

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> Estimates:
        """The contacts behind tension differences (B, M) at commanded angles (B, 2N) or (2N,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        outputs = self._outputs(tension_differences_n, joint_commands_rad)
        plausibility = self._plausibility(tension_differences_n, joint_commands_rad)
        return Estimates.of_outputs(outputs, *plausibility)


class MultiEstimates(NamedTuple):
    """B estimates, (B, N): of each segment that it is touched, and if so, its force.

    Attributes:
        misfit_n, plausible: (B,) as of `Estimate`.
    """

    probabilities: Array
    magnitude_n: Array
    magnitude_std_n: Array
    misfit_n: Array
    plausible: NDArray[np.bool_]


class MultiEstimator(NetworkEstimator):
    """A multi-contact model, opened; an `EstimateError` refuses inputs that it cannot take."""

    outputs: ClassVar[Sequence[str]] = MULTI_OUTPUTS

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> MultiEstimates:
        """The contacts behind tension differences (B, M) at commanded angles (B, 2N) or (2N,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        outputs = self._outputs(tension_differences_n, joint_commands_rad)
        plausibility = self._plausibility(tension_differences_n, joint_commands_rad)
        probabilities, magnitude_n, magnitude_std_n = outputs
        return MultiEstimates(probabilities, magnitude_n, magnitude_std_n, *plausibility)
