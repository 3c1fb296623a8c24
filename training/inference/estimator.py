"""Estimators in model files: one contact or several, from each sample by itself or one by one.

They take tension differences against the unloaded arm, N; pose-aware models also the commanded
joint angles, rad. An `EstimateError` refuses inputs of a wrong shape or that are not finite, a
command that is missing, and answers that are not finite.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_training.errors import EstimateError
from cablesense_training.inference.session import (
    ACCELERATION,
    COMMAND,
    SPEED,
    TENSION,
    OpenedModel,
    SingleRun,
)

if TYPE_CHECKING:
    from pathlib import Path

    from cablesense_training.data.sequences import Sequences

OUTPUTS = ("contact_probability", "direction", "magnitude_n", "magnitude_std_n", "angle_std_deg")
MULTI_OUTPUTS = ("contact_probability", "magnitude_n", "magnitude_std_n")

NORMAL_95 = 1.959964
"""Standard deviations on either side of the mean that hold 95 % of a Gaussian."""

_NO_ANSWER = "the answer is not finite: tension differences or commands beyond what can be weighed"


class ContactPlace(NamedTuple):
    """The place of a contact on its segment, with its axial force and its moment.

    Attributes:
        place_m: distance from the segment's joint centre.
        low_m, high_m: between which it lies with 95 %; beyond the segment's ends, along the arm,
            where the neighbour may be touched.
        along_n: force along the segment, towards its end.
        covariance: (4, 4) of the place, m, and the force along the segment's axes, N.
        moment_n_m: of the normal force about the joint centre.
        force_known: whether the tensions determine the normal force; else only its moment.
        misfit: root mean square of the readings' residuals, in their standard deviations.
        log_evidence: of one contact against none.
        chi2: misfit of the torques alone.
    """

    place_m: float
    low_m: float
    high_m: float
    along_n: float
    covariance: Array
    moment_n_m: float
    force_known: bool
    misfit: float
    log_evidence: float
    chi2: float

    @property
    def along_std_n(self) -> float:
        """Standard deviation of `along_n`."""
        return float(self.covariance[1, 1]) ** 0.5


class Estimate(NamedTuple):
    """One contact, or none.

    Attributes:
        probabilities: (N + 1,) of no contact and of segment 1 … N.
        segment: the likeliest of them; 0 is no contact.
        angle_deg: contact angle in [0, 360), in the normal plane of the segment at the commanded
            angles, from +z towards +y.
        magnitude_n: force; without a contact, that of the likeliest segment.
        low_n, high_n: between which the force lies with 95 %, where there is a contact. A
            recurrent model answers one only where this does not begin at 0.
        place: of a contact anywhere; None from a model of contacts at the arm file's points.
    """

    probabilities: Array
    segment: int
    angle_deg: float
    magnitude_n: float
    magnitude_std_n: float
    angle_std_deg: float
    low_n: float
    high_n: float
    place: ContactPlace | None = None


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

    @classmethod
    def of_outputs(cls, outputs: Sequence[Array]) -> Estimates:
        """Estimates from a model's `OUTPUTS` with any leading axes, and its `INTERVAL` if any."""
        probability, direction, magnitude_n, std_n, angle_std_deg, *interval_n = outputs
        angle_deg = np.rad2deg(np.arctan2(direction[..., 0], direction[..., 1])) % 360.0 % 360.0
        segment = probability.argmax(axis=-1)
        if interval_n:
            low_n, high_n = interval_n[0][..., 0], interval_n[0][..., 1]
            segment = np.where(low_n > 0.0, 1 + probability[..., 1:].argmax(axis=-1), 0)
        else:
            half_n = NORMAL_95 * std_n
            low_n, high_n = np.maximum(0.0, magnitude_n - half_n), magnitude_n + half_n
        stated = (angle_deg, magnitude_n, std_n, angle_std_deg, low_n, high_n)
        return cls(probability, segment, *stated)

    @classmethod
    def one(cls, outputs: Sequence[Array]) -> Estimate:
        """The estimate from outputs for one sample, without a leading axis."""
        probabilities, *numbers = cls.of_outputs(outputs)
        stated: list[Any] = [number.item() for number in numbers]
        return Estimate(probabilities.copy(), *stated)


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


class ContactEstimator(OpenedModel):
    """The common base of estimators."""

    def _finite_outputs(
        self, inputs: dict[str, Array], names: Sequence[str] | None = None
    ) -> list[Array]:
        """What `run` gives, if it is finite."""
        outputs = self.run(inputs, names)
        if not all(np.isfinite(output).all() for output in outputs):
            raise EstimateError(_NO_ANSWER)
        return outputs

    def _batch(self, tensions_n: ArrayLike, commands_rad: ArrayLike | None) -> list[Array]:
        """The outputs for tension differences (B, M) or (M,) and commands (B, 2N) or (2N,)."""
        inputs = {TENSION: self._tensions(tensions_n)}
        if self.pose_aware:
            inputs[COMMAND] = self._commands(commands_rad, len(inputs[TENSION]))
        return self._finite_outputs(inputs)

    def _tensions(self, values: ArrayLike, rows: int | None = None) -> Array:
        count = self.metadata.arm.cable_count
        return finite_table(values, count, "tension differences", rows)

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
        return np.ascontiguousarray(np.broadcast_to(command, (rows, count)))


class Estimator(ContactEstimator):
    """A single-contact model, opened; not for use from several threads at once.

    An `EstimateError` refuses inputs that it cannot take, and answers that are not finite.
    """

    outputs: ClassVar[Sequence[str]] = OUTPUTS

    def __init__(self, path: str | Path, arm: Arm | None = None) -> None:
        super().__init__(path, arm)
        self._single = SingleRun(self.model, self.metadata.arm, self.outputs, self._source)
        self._command = b""

    def estimate(
        self, tension_difference_n: ArrayLike, joint_command_rad: ArrayLike | None = None
    ) -> Estimate:
        """The contact behind tension differences (M,) at commanded joint angles (2N,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        estimate = self._of_one(self._outputs(tension_difference_n, joint_command_rad))
        if not math.isfinite(sum(estimate.probabilities.tolist()) + sum(estimate[2:8])):
            self._tensions(tension_difference_n, 1)
            raise EstimateError(_NO_ANSWER)
        return estimate

    def _of_one(self, outputs: list[Array]) -> Estimate:
        """The estimate from the graph's outputs for one sample."""
        return Estimates.one(outputs)

    def _outputs(
        self, tension_difference_n: ArrayLike, joint_command_rad: ArrayLike | None
    ) -> list[Array]:
        """The graph's outputs for one sample, overwritten by the next."""
        single = self._single
        if not (
            isinstance(tension_difference_n, np.ndarray)
            and tension_difference_n.dtype == np.float64
            and tension_difference_n.shape == single.tension_difference_n.shape
        ):  # what is not finite shows in the answer
            tension_difference_n = self._tensions(tension_difference_n, 1)[0]
        if self.pose_aware:
            self._set_command(joint_command_rad)
        single.tension_difference_n[:] = tension_difference_n
        single.run()
        return single.outputs

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> Estimates:
        """The contacts behind tension differences (B, M) at commanded angles (B, 2N) or (2N,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        return Estimates.of_outputs(self._batch(tension_differences_n, joint_commands_rad))

    def estimate_sequences(self, sequences: Sequences) -> Estimates:
        """Estimates (S · T,) of sequences, each tick by itself at its set-point."""
        tension_n, command_rad, *_ = sequences.inputs
        flat_n = tension_n.reshape(-1, tension_n.shape[-1])
        return self.estimate_batch(flat_n, command_rad.reshape(len(flat_n), -1))

    def _set_command(self, joint_command_rad: ArrayLike | None) -> None:
        """Compute what depends on the command alone, if it is not the one before."""
        if (
            isinstance(joint_command_rad, np.ndarray)
            and joint_command_rad.dtype == np.float64
            and joint_command_rad.tobytes() == self._command
        ):
            return
        command = self._commands(joint_command_rad, 1)
        self._command = b""  # none, should this fail
        self._single.set_command(command)
        self._command = command.tobytes()


class SequenceEstimator(ContactEstimator, ABC):
    """A single-contact model that takes samples one after another; for one thread at a time.

    The samples given since `forget`, their times and their set-points determine its answers. An
    `EstimateError` refuses those that it cannot take.
    """

    @abstractmethod
    def forget(self) -> None:
        """Begin without a past."""

    @abstractmethod
    def tare(self) -> None:
        """Tension differences count from the next sample on."""

    @abstractmethod
    def _answer(self, inputs: dict[str, Array], time_s: float) -> Estimate:
        """The contact by checked inputs (1, …) at a time."""

    def estimate(
        self,
        tension_difference_n: ArrayLike,
        joint_command_rad: ArrayLike,
        joint_speed_rad_s: ArrayLike,
        joint_acceleration_rad_s2: ArrayLike,
        time_s: float,
    ) -> Estimate:
        """The contact behind tension differences (M,) at a set-point (2N,) in motion or at rest.

        Raises:
            EquilibriumError: a simulated arm has no rest where it is set to be.
        """
        joints = self.metadata.arm.joint_count
        inputs = {
            TENSION: self._tensions(tension_difference_n, 1),
            COMMAND: finite_table(joint_command_rad, joints, "set-point angles", 1),
            SPEED: finite_table(joint_speed_rad_s, joints, "set-point speeds", 1),
            ACCELERATION: finite_table(joint_acceleration_rad_s2, joints, "accelerations", 1),
        }
        return self._answer(inputs, time_s)

    def estimate_sequences(self, sequences: Sequences) -> Estimates:
        """Estimates (S, T) of sequences, the tare being that of the first tick of each."""
        tick_s, found = sequences.protocol.tick_s, []
        for number in range(len(sequences)):
            self.forget()
            before_rad, none = sequences.before_rad[number], np.zeros(sequences.arm.cable_count)
            still = np.zeros_like(before_rad[0])
            for tick, set_point in enumerate(before_rad, start=-len(before_rad)):
                self.tare()
                self.estimate(none, set_point, still, still, tick * tick_s)
            self.tare()
            tension_n, *set_points = (values[number] for values in sequences.inputs)
            ticks = zip(tension_n, *set_points, np.arange(len(tension_n)) * tick_s, strict=True)
            found.append([self.estimate(*now) for now in ticks])
        return Estimates(*(np.array([[e[k] for e in row] for row in found]) for k in range(8)))


class MultiEstimates(NamedTuple):
    """B estimates, all (B, N): of each segment that it is touched, and if so, its force."""

    probabilities: Array
    magnitude_n: Array
    magnitude_std_n: Array


class MultiEstimator(ContactEstimator):
    """A multi-contact model, opened; an `EstimateError` refuses inputs that it cannot take."""

    outputs = MULTI_OUTPUTS

    def estimate_batch(
        self, tension_differences_n: ArrayLike, joint_commands_rad: ArrayLike | None = None
    ) -> MultiEstimates:
        """The contacts behind tension differences (B, M) at commanded angles (B, 2N) or (2N,).

        Raises:
            EstimateError: inputs of a wrong shape or not finite, or an answer that is not.
        """
        return MultiEstimates(*self._batch(tension_differences_n, joint_commands_rad))
