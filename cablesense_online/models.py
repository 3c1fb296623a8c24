"""A model as the online estimator uses it: loaded, asked for a contact, its estimate decided on.

A model file holds one of two kinds of estimator. A memoryless one takes samples of an arm at rest,
with one contact or several. A history-dependent one takes every sample along the trajectory of the
joints. `ContactModel` is their common interface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.answer import decide
from cablesense_online.force_fit import LARGEST_MISFIT, ForceFits
from cablesense_online.motion_gate import MotionGate
from cablesense_online.tare import Tares
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.joint_motion import JointMotion
from cablesense_training.inference.estimator import (
    Estimate,
    Estimator,
    MultiEstimator,
    SequenceEstimator,
)
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.session import model_sha256, read_model
from cablesense_training.inference.temporal_estimator import open_estimator

PREDICTED_EVERY_RAD = 2e-3
"""How far a joint turns before the unloaded tensions on the way are predicted anew.

On the arm `cdsm` they change by less than 0.1 N over this.
"""


AnyEstimator = Estimator | MultiEstimator | SequenceEstimator


@dataclass(frozen=True)
class LoadedModel:
    """An estimator, the arm that it was made for, and the file that both came from."""

    arm: Arm
    estimator: AnyEstimator
    model: str

    @classmethod
    def open(cls, path: Path, arm: Arm | None = None) -> LoadedModel:
        """Open a model file, for a certain arm where one is given.

        Raises:
            ModelFileError: it is no model, or one for another arm.
        """
        several = read_model(path)[1].kind == "multi-contact"
        estimator = MultiEstimator.load(path, arm) if several else open_estimator(path, arm)
        return cls(estimator.metadata.arm, estimator, str(path))

    @property
    def origin(self) -> dict[str, str]:
        """The file and the SHA-256 of the model in it, which identify it in a recording."""
        return {"model": self.model, "model SHA-256": model_sha256(self.model)}

    def largest_misfit(self, wanted: float) -> float:
        """The limit `wanted`; if that is negative the file's, or else `LARGEST_MISFIT`."""
        stated = self.estimator.metadata.misfit_limit
        if wanted >= 0.0:
            return wanted
        return LARGEST_MISFIT if stated is None else stated.largest_misfit

    def status(self, largest_force_n: float, active: bool) -> Status:
        """Which model and arm, and whether the latest forces were within its training."""
        metadata = self.estimator.metadata
        values = {
            "model": self.model,
            "network": metadata.network,
            "arm": self.arm.identity,
            "trained up to (N)": f"{metadata.force_range_n:g}",
            "largest force (N)": f"{largest_force_n:.1f}",
        }
        if not active:
            return Status("model", Level.WARN, "configured, not active", values)
        if largest_force_n > metadata.force_range_n:
            return Status("model", Level.WARN, "forces beyond those it was trained on", values)
        return Status("model", Level.OK, "active", values)


def load_model(arm: str, model: str) -> LoadedModel:
    """Load by name or path; an empty `model` takes the bundled one of the arm's name.

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    return LoadedModel.open(find_model(model or description.name), description)


class ContactModel:
    """A memoryless estimator, asked at the gate's pose; the caller ensures that the arm rests.

    Attributes:
        in_motion: whether it estimates while the arm moves.
        several: whether it estimates several contacts at once.
        unchecked: why its answers cannot be checked against readings; empty where they can.
    """

    in_motion = several = False
    unchecked = ""

    def __init__(self, estimator: Estimator, tares: Tares, gate: MotionGate) -> None:
        self._estimator, self._tares, self._gate = estimator, tares, gate
        self._pose_aware = estimator.pose_aware

    def estimate(self, tensions_n: Array, stamp_ns: int) -> Any:
        """The contact behind tensions (M,), as `decide` takes it; None without a tare.

        Raises:
            CableSenseError: the model cannot take this sample.
        """
        unloaded = self._tares.unloaded_n
        if unloaded is None:
            return None
        pose = self._gate.pose_rad if self._pose_aware else None
        return self._estimator.estimate(tensions_n - unloaded, pose)

    def decide(
        self, estimate: Any, threshold: float, contact_m: Sequence[float]
    ) -> tuple[Contact, ...]:
        """The contacts in an estimate of this model, the strongest first.

        See the function `decide` for the other arguments and for errors.
        """
        contact = decide(
            estimate.probabilities.tolist(),
            float(estimate.angle_deg),
            float(estimate.magnitude_n),
            threshold,
            contact_m,
        )
        return (contact,) if contact.segment else ()

    def command(self, command_rad: Array) -> None:
        """Commanded angles (2N,) count from the next sample on."""

    def tared(self) -> None:
        """Another tare counts from the next sample on."""

    def restart(self, command_rad: Array) -> None:
        """The arm rests at a command (2N,), without a past."""


class HistoryDependentModel(ContactModel):
    """A history-dependent estimator, asked at the set-points between the commands.

    Joints are assumed to approach a command as the sim node lets them: on minimum-jerk curves with
    the same peak speed. A command counts from the sample before it.
    """

    in_motion = True
    unchecked = "the model is history-dependent"

    def __init__(
        self,
        estimator: SequenceEstimator,
        tares: Tares,
        predict_n: Callable[[Array], Array],
        command_rad: Array,
        joint_speed_rad_s: float,
    ) -> None:
        self._sequence, self._tares, self._predict_n = estimator, tares, predict_n
        self._speed_rad_s = joint_speed_rad_s
        self._last_ns: int | None = None
        self._predicted_at_rad: Array | None = None
        self.restart(command_rad)

    def estimate(self, tensions_n: Array, stamp_ns: int) -> Estimate | None:
        """See `ContactModel`; the trajectory is followed without a tare too."""
        passed_s = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        self._motion.advance(max(0.0, passed_s))
        angle, speed, acceleration = self._motion.state
        unloaded = self._unloaded_n(angle)
        if unloaded is None:
            self._sequence.tare()
        difference = np.zeros(len(tensions_n)) if unloaded is None else tensions_n - unloaded
        estimate = self._sequence.estimate(difference, angle, speed, acceleration, stamp_ns * 1e-9)
        return None if unloaded is None else estimate

    def command(self, command_rad: Array) -> None:
        """See `ContactModel`."""
        self._motion.go_to(command_rad)

    def decide(
        self, estimate: Any, threshold: float, contact_m: Sequence[float]
    ) -> tuple[Contact, ...]:
        """See `ContactModel`; there is none where the estimator answers none."""
        contacts = super().decide(estimate, threshold, contact_m)
        return contacts if estimate.segment else ()

    def tared(self) -> None:
        """The estimator gets tensions since the tare, as in training."""
        self._sequence.tare()

    def restart(self, command_rad: Array) -> None:
        """See `ContactModel`."""
        self._motion = JointMotion(command_rad, self._speed_rad_s)
        self._last_ns = self._predicted_at_rad = None
        self._predicted_n = np.zeros(0)
        self._sequence.forget()

    def _unloaded_n(self, angle_rad: Array) -> Array | None:
        if not self._motion.moving:
            self._predicted_at_rad = None
            return self._tares.unloaded_n
        at = self._predicted_at_rad
        if at is None or np.abs(angle_rad - at).max() > PREDICTED_EVERY_RAD:
            self._predicted_at_rad = angle_rad
            self._predicted_n = self._predict_n(angle_rad)
        tare = self._tares.present
        return None if tare is None else tare.unloaded_n(self._predicted_n)


class Several(NamedTuple):
    """Contacts on several segments at once.

    Attributes:
        probabilities: (N + 1,) that nothing touches, and of each segment that it is touched.
        magnitude_n: (N,) force on each segment, if it is touched.
        difference_n: (M,) tensions minus the unloaded ones.
    """

    probabilities: Array
    magnitude_n: Array
    difference_n: Array


class MultiContactModel(ContactModel):
    """A memoryless estimator of several contacts; a force fit gives their directions.

    No bounds are given: the model states the uncertainty of each force, not of its direction.
    """

    several = True

    def __init__(
        self, estimator: MultiEstimator, tares: Tares, gate: MotionGate, fits: ForceFits
    ) -> None:
        self._several, self._tares, self._gate, self._fits = estimator, tares, gate, fits

    def estimate(self, tensions_n: Array, stamp_ns: int) -> Several | None:
        """See `ContactModel`."""
        unloaded = self._tares.unloaded_n
        if unloaded is None:
            return None
        difference_n = tensions_n - unloaded
        found = self._several.estimate_batch(difference_n, self._gate.pose_rad)
        touched, magnitude_n = found.probabilities[0], found.magnitude_n[0]
        free = np.prod(1.0 - touched)
        return Several(np.concatenate([[free], touched]), magnitude_n, difference_n)

    def decide(
        self, estimate: Several, threshold: float, contact_m: Sequence[float]
    ) -> tuple[Contact, ...]:
        """See `ContactModel`."""
        probability = estimate.probabilities.tolist()
        force_n = [0.0, *estimate.magnitude_n.tolist()]
        numbers = range(1, len(force_n))
        touched = tuple(n for n in numbers if probability[n] >= threshold and force_n[n] > 0.0)
        if not touched:
            return ()
        self._fits.command(self._gate.pose_rad)
        angles = self._fits.angles_deg(estimate.difference_n, touched)
        contacts = [
            Contact(n, angle_deg, force_n[n], contact_m[n - 1])
            for n, angle_deg in zip(touched, angles, strict=True)
        ]
        return tuple(sorted(contacts, key=lambda contact: -contact.magnitude_n))
