"""The estimator: twelve tension differences in, one contact out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_sim.arm import Arm
from cablesense_training.inference.metadata import ModelFileError, ModelMetadata
from cablesense_training.inference.session import ModelSession

Array = NDArray[np.float64]

OUTPUTS = ("contact_probability", "direction", "magnitude_n", "magnitude_std_n", "angle_std_deg")


class EstimateError(ModelFileError):
    """Inputs that the model cannot take: wrong shape, not finite, or a command that is missing."""


@dataclass(frozen=True)
class Estimate:
    """One contact, or none.

    Attributes:
        probabilities: (N + 1,) of no contact and of segment 1 … N.
        segment: the likeliest of them; 0 is no contact.
        angle_deg: contact angle in [0, 360), in the normal plane of the segment at the commanded angles, +z towards +y.
        magnitude_n: force; what it would be where `segment` is 0 and the caller thinks otherwise.
        magnitude_std_n, angle_std_deg: stated standard deviations.
    """

    probabilities: Array
    segment: int
    angle_deg: float
    magnitude_n: float
    magnitude_std_n: float
    angle_std_deg: float


@dataclass(frozen=True)
class Estimates:
    """B estimates: the fields of `Estimate`, with a leading axis."""

    probabilities: Array
    segment: NDArray[np.int64]
    angle_deg: Array
    magnitude_n: Array
    magnitude_std_n: Array
    angle_std_deg: Array


class Estimator:
    """A single-contact model, opened; not for use from several threads at once.

    Attributes:
        metadata: what the model file says about itself.
    """

    def __init__(self, session: ModelSession) -> None:
        self.metadata: ModelMetadata = session.metadata
        self._session = session
        self._command = np.full((1, session.metadata.arm.joint_count), np.nan)
        self._steady: dict[str, Array] = {}

    @classmethod
    def load(cls, path: str | Path, arm: Arm | None = None) -> Estimator:
        """Open a model file, for a certain arm where one is given.

        Raises:
            ModelFileError: the file is no single-contact model, or not one for this arm.
        """
        return cls(ModelSession.open(path, OUTPUTS, arm))

    @property
    def arm_identity(self) -> str:
        """Of the arm that the model was made for."""
        return self.metadata.arm_identity

    @property
    def pose_aware(self) -> bool:
        """Whether the model needs the commanded joint angles."""
        return self.metadata.pose_aware

    @property
    def cable_names(self) -> tuple[str, ...]:
        """Order of the tension differences."""
        return self.metadata.cable_names

    def estimate(
        self, tension_difference_n: ArrayLike, joint_command_rad: ArrayLike | None = None
    ) -> Estimate:
        """The contact behind tension differences (M,) at commanded joint angles (2N,).

        What depends on the command alone is computed when it changes.

        Raises:
            EstimateError: see its docstring.
        """
        tension = self._tensions(tension_difference_n, (1, self.metadata.arm.cable_count))
        if self.pose_aware:
            command = self._commands(joint_command_rad, 1)
            if not np.array_equal(command, self._command):
                self._steady = self._session.steady_inputs(command)
                self._command = command.copy()
        probability, direction, magnitude, std, angle_std = self._session.run(tension, self._steady)
        row = probability[0]
        return Estimate(
            probabilities=row,
            segment=int(row.argmax()),
            angle_deg=float(np.rad2deg(np.arctan2(direction[0, 0], direction[0, 1])) % 360.0),
            magnitude_n=float(magnitude[0]),
            magnitude_std_n=float(std[0]),
            angle_std_deg=float(angle_std[0]),
        )

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> Estimates:
        """The contacts behind tension differences (B, M) at commanded joint angles (B, 2N) or (2N,).

        Raises:
            EstimateError: see its docstring.
        """
        rows = np.shape(tension_differences_n)[0] if np.ndim(tension_differences_n) == 2 else 1
        tension = self._tensions(
            tension_differences_n, (rows, self.metadata.arm.cable_count)
        )
        steady: dict[str, Array] = {}
        if self.pose_aware:
            steady = self._session.steady_inputs(self._commands(joint_commands_rad, rows))
        probability, direction, magnitude, std, angle_std = self._session.run(tension, steady)
        return Estimates(
            probabilities=probability,
            segment=probability.argmax(axis=1),
            angle_deg=np.rad2deg(np.arctan2(direction[:, 0], direction[:, 1])) % 360.0,
            magnitude_n=magnitude,
            magnitude_std_n=std,
            angle_std_deg=angle_std,
        )

    def _tensions(self, values: ArrayLike, shape: tuple[int, int]) -> Array:
        tension = np.asarray(values, dtype=np.float64)
        if tension.size != shape[0] * shape[1] or tension.shape[-1:] != shape[1:]:
            raise EstimateError(
                f"tension differences of shape {tension.shape}; this model needs {shape[1]}, "
                f"in the order {self.cable_names[0]} … {self.cable_names[-1]}"
            )
        if not np.isfinite(tension).all():
            raise EstimateError("tension differences must be finite; one is NaN or infinite")
        return np.ascontiguousarray(tension.reshape(shape))

    def _commands(self, values: ArrayLike | None, rows: int) -> Array:
        count = self.metadata.arm.joint_count
        if values is None:
            raise EstimateError(f"this model needs the {count} commanded joint angles")
        command = np.asarray(values, dtype=np.float64)
        if command.shape[-1:] != (count,) or command.size not in (count, rows * count):
            raise EstimateError(
                f"commanded joint angles of shape {command.shape}; this model needs {count} a sample"
            )
        if not np.isfinite(command).all():
            raise EstimateError("commanded joint angles must be finite; one is NaN or infinite")
        return np.ascontiguousarray(np.broadcast_to(command, (rows, count)))
