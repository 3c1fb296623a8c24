"""How a model is asked for the contact behind a sample: at rest only, or along the course.

Whether what a model says of a sample is a contact, and which one.

What the estimator says to one sample of tensions.

The arm and the model that fits it, as the estimator node loads them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from cablesense_base.arrays import Array
from cablesense_msgs_py.journal import JournalEntry
from cablesense_msgs_py.wrenches import NO_CONTACT, Contact
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.tare import Tare, TareModel
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.joint_motion import JointMotion
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import TemporalEstimator, open_estimator

PREDICTED_EVERY_RAD = 2e-3
"""How far a joint turns before the unloaded tensions on the way are predicted anew.

On the arm `cdsm` they change by less than 0.1 N over this.
"""


class Estimate(Protocol):
    """What is read of `cablesense_training.inference.estimator.Estimate`."""

    @property
    def probabilities(self) -> Array:
        """(N+1,) of no contact, segment 1, …."""

    @property
    def angle_deg(self) -> float:
        """Contact angle."""

    @property
    def magnitude_n(self) -> float:
        """Of the force."""


class EstimatesAtRest(Protocol):
    """What is used of `cablesense_training.inference.estimator.Estimator`."""

    @property
    def pose_aware(self) -> bool:
        """Whether `estimate` takes the joint command."""

    def estimate(self, tension_difference_n: Array, joint_command_rad: Array | None) -> Estimate:
        """The contact that explains a tension difference (M,)."""


@runtime_checkable
class EstimatesAlongCourse(Protocol):
    """What is used of `cablesense_training.inference.temporal_estimator.TemporalEstimator`."""

    def estimate(
        self,
        tension_difference_n: Array,
        joint_command_rad: Array,
        joint_speed_rad_s: Array,
        joint_acceleration_rad_s2: Array,
        time_s: float,
    ) -> Estimate:
        """The contact that explains a tension difference (M,) at a set-point, and the past."""

    def forget(self) -> None:
        """Begin without a past."""

    def tare(self) -> None:
        """Tension differences count from now on."""


class Answers(Protocol):
    """What `Estimation` asks."""

    in_motion: bool

    def command(self, command_rad: Array) -> None:
        """Commanded angles (2N,) that count from the next sample."""

    def begin(self) -> None:
        """A tare counts from the next sample on, or another one again."""

    def restore(self, command_rad: Array) -> None:
        """Be at rest at a command (2N,), without a past."""

    def estimate(self, tensions_n: Sequence[float], stamp_ns: int) -> Estimate | None:
        """The contact behind tensions (M,); none without a tare.

        Raises:
            CableSenseError: the model cannot take this sample.
        """


class AnswersAtRest:
    """Asks a model that knows rests alone; whoever asks makes sure that the arm rests."""

    in_motion = False

    def __init__(self, estimator: EstimatesAtRest, tare: TareModel, command_rad: Array) -> None:
        self._estimator, self._tare = estimator, tare
        self._command_rad: Array | None = command_rad if estimator.pose_aware else None

    def command(self, command_rad: Array) -> None:
        """See `Answers`."""
        if self._estimator.pose_aware:
            self._command_rad = command_rad

    def begin(self) -> None:
        """Nothing is remembered anyway."""

    def restore(self, command_rad: Array) -> None:
        """See `Answers`."""
        self.command(command_rad)

    def estimate(self, tensions_n: Sequence[float], stamp_ns: int) -> Estimate | None:
        """See `Answers`."""
        unloaded = self._tare.unloaded_n
        if unloaded is None:
            return None
        return self._estimator.estimate(tensions_n - unloaded, self._command_rad)


class AnswersAlongCourse:
    """Asks a model with memory at the set-points that lie between the commands.

    Joints are taken to go to a command as the sim node lets them: on minimum-jerk curves with the
    peak speed that both have for a parameter. A command counts from the sample before it.
    """

    in_motion = True

    def __init__(
        self,
        estimator: EstimatesAlongCourse,
        tare: TareModel,
        predict_n: Callable[[Array], Array],
        command_rad: Array,
        joint_speed_rad_s: float,
    ) -> None:
        self._estimator, self._tare, self._predict_n = estimator, tare, predict_n
        self._speed_rad_s = joint_speed_rad_s
        self.restore(command_rad)

    def command(self, command_rad: Array) -> None:
        """See `Answers`."""
        self._motion.go_to(command_rad)

    def begin(self) -> None:
        """The model hears of tensions since the tare, as in training."""
        self._estimator.tare()

    def restore(self, command_rad: Array) -> None:
        """See `Answers`."""
        self._motion = JointMotion(command_rad, self._speed_rad_s)
        self._last_ns: int | None = None
        self._predicted_at_rad: Array | None = None
        self._predicted_n = np.zeros(0)
        self._estimator.forget()

    def estimate(self, tensions_n: Sequence[float], stamp_ns: int) -> Estimate | None:
        """See `Answers`."""
        passed_s = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        self._motion.advance(max(0.0, passed_s))
        angle, speed, acceleration = self._motion.state
        unloaded = self._unloaded_n(angle)
        difference = np.zeros(len(tensions_n)) if unloaded is None else tensions_n - unloaded
        estimate = self._estimator.estimate(
            difference, angle, speed, acceleration, stamp_ns * 1e-9
        )
        return None if unloaded is None else estimate

    def _unloaded_n(self, angle_rad: Array) -> Array | None:
        if not self._motion.moving:
            self._predicted_at_rad = None
            return self._tare.unloaded_n
        at = self._predicted_at_rad
        if at is None or np.abs(angle_rad - at).max() > PREDICTED_EVERY_RAD:
            self._predicted_at_rad = angle_rad
            self._predicted_n = self._predict_n(angle_rad)
        return self._tare.unloaded_where(self._predicted_n)


def answers_of(
    estimator: EstimatesAtRest | EstimatesAlongCourse,
    tare: TareModel,
    predict_n: Callable[[Array], Array],
    command_rad: Array,
    joint_speed_rad_s: float,
) -> Answers:
    """The way of asking that an estimator needs, for an arm that rests at a command (2N,)."""
    if isinstance(estimator, EstimatesAlongCourse):
        return AnswersAlongCourse(estimator, tare, predict_n, command_rad, joint_speed_rad_s)
    return AnswersAtRest(estimator, tare, command_rad)


class ContactDecision:
    """Takes the likeliest segment, once a contact anywhere is likely enough.

    Attributes:
        threshold: probability of a contact anywhere from which on there is one.
    """

    def __init__(self, contact_m: Sequence[float], threshold: float) -> None:
        """`contact_m` (N,) says where on its axis each segment is touched, from its joint on."""
        self._contact_m = contact_m
        self.threshold = threshold

    def decide(
        self, probabilities: Sequence[float], angle_deg: float, magnitude_n: float
    ) -> Contact:
        """The contact, or `NO_CONTACT`.

        Args:
            probabilities: (N+1,) of no contact, segment 1, ….
            angle_deg: contact angle.
            magnitude_n: of the force; one that does not push is no contact.

        Raises:
            SampleError: a number is not finite.
        """
        if not (isfinite(sum(probabilities)) and isfinite(angle_deg) and isfinite(magnitude_n)):
            raise SampleError(
                ProblemKind.ESTIMATE, "the model gave a number that is not finite for this sample"
            )
        if 1.0 - probabilities[0] < self.threshold or magnitude_n <= 0.0:
            return NO_CONTACT
        segment = max(range(1, len(probabilities)), key=probabilities.__getitem__)
        return Contact(segment, angle_deg, magnitude_n, self._contact_m[segment - 1])


class Outcome(NamedTuple):
    """The answer to one sample.

    Attributes:
        contact: `NO_CONTACT` also when the sample was of no use.
        probabilities: (N+1,) of no contact, segment 1, …; empty when nothing was estimated.
        stamp_ns: time of the sample; 0 when it has none, or cannot be trusted.
        problem: why the sample was of no use.
        new_tare: the tare that was taken by itself; it counts from the next sample on.
        entry: what the answers rest on from this sample on, where that has changed.
    """

    contact: Contact = NO_CONTACT
    probabilities: Sequence[float] = ()
    stamp_ns: int = 0
    problem: SampleError | None = None
    new_tare: Tare | None = None
    entry: JournalEntry | None = None


@dataclass(frozen=True)
class LoadedModel:
    """An estimator, the arm that it believes in, and the file that this came from."""

    arm: Arm
    estimator: Estimator | TemporalEstimator
    model: str

    @property
    def described(self) -> dict[str, str]:
        """The file and the SHA-256 of its content, for who must know which model answered."""
        with Path(self.model).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return {"model": self.model, "model SHA-256": digest}


def load_model(arm: str, model: str) -> LoadedModel:
    """Load by name or path; an empty `model` takes the bundled one of the arm's name.

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    path = find_model(model or description.name)
    estimator = open_estimator(path, description)
    return LoadedModel(estimator.metadata.arm, estimator, str(path))
