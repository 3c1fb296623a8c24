"""A model as the online estimator uses it: loaded, asked for a contact, its estimate decided on.

A memoryless estimator takes samples of an arm at rest, with one contact or several. A
history-dependent one takes every sample along the trajectory of the joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.answer import decide
from cablesense_online.motion_gate import MotionGate
from cablesense_online.plausibility import LARGEST_MISFIT, noise_limit, numbers_of
from cablesense_online.state import EstimationSettings
from cablesense_online.stated_contacts import FORCE_OFF_N, RestingArm
from cablesense_online.tare import Tares
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.contact_location import ContactPair
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.kinematics import contact_torques
from cablesense_sim.mechanism import Mechanism
from cablesense_training.errors import ModelFileError
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import (
    NORMAL_95,
    Estimate,
    Estimator,
    MultiEstimator,
    SequenceEstimator,
)
from cablesense_training.inference.metadata import find_model_of
from cablesense_training.inference.model_file import model_sha256, read_model
from cablesense_training.inference.temporal_estimator import open_estimator

_PREDICTED_EVERY_RAD = 2e-3
"""How far a joint turns before the unloaded tensions on the way are predicted anew: on the arm
`cdsm` they change by less than 0.1 N over this."""

_ALONG_KNOWN_N = 1.0
"""An axial force is stated if its standard deviation is below this: the arm is then so bent that a
small error of the pose does not make one."""

_FRICTION = 0.5
"""Axial over normal force that friction at a contact may make, unless the arm file states more. A
contact on segment 1 beside one on segment 2 reads like one there with another axial force."""

_UNKNOWN_PLACE = 0.2
"""Share of a segment's reach: at a larger standard deviation of the place the force is not known.
A uniform distribution has 0.29."""

_ONE_UP_TO_CHI2 = 20.0
"""Two contacts are tried if one leaves more of the torques: with four residuals that happens once
in 2,000 samples by noise."""

_AT_REST_CHI2 = 9.49
"""The torques of an arm at rest leave less in 95 % of the samples, with four residuals."""

_SWING = 2.0
"""A sudden acceleration swings an undamped arm by twice what a steady one bends it."""

_ONE_SEGMENT = 0.99
"""In motion a contact whose segment is less probable is doubted."""

_TWO_BEYOND = 10.0
"""Log evidence by which two contacts must be likelier than one: sensors also err by steps."""

MOST_OF_NOISE = 2.0
"""A limit is at most this multiple of that of noise: beyond it, the model's own errors decide."""

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
        """The limit `wanted`; if that is negative the file's, or else `LARGEST_MISFIT`.

        Raises:
            ModelFileError: the file states one that would check nothing.
        """
        stated = self.estimator.metadata.misfit_limit
        if wanted >= 0.0:
            return wanted
        if stated is None:
            return LARGEST_MISFIT
        most = MOST_OF_NOISE * noise_limit(self.free)
        if stated.largest_misfit > most:
            raise ModelFileError(
                f"{self.model}: states a largest misfit of {stated.largest_misfit:g}; noise of "
                f"{self.arm.cable_count} readings allows {most:.2f} at most, so train it again"
            )
        return stated.largest_misfit

    @property
    def free(self) -> int:
        """Readings that are left over by one contact."""
        return max(self.arm.cable_count - numbers_of(self.estimator.metadata.kind), 1)

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
    """Load by name or path; an empty `model` takes the arm's bundled one (`find_model_of`).

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    return LoadedModel.open(find_model_of(description, arm, model), description)


class FoundContacts(NamedTuple):
    """The contacts that a model finds in a sample, the strongest first.

    Attributes:
        probabilities: (N + 1,) that nothing touches, and of each segment that it is touched.
        estimate: the one behind the contacts, if the model states one.
        doubt: why readings do not determine the contacts; empty where they do.
        misfit: root mean square of the readings' residuals, if the model states it.
    """

    probabilities: list[float]
    contacts: tuple[Contact, ...]
    estimate: Estimate | None = None
    doubt: str = ""
    misfit: float | None = None


class ContactModel:
    """A memoryless estimator, asked at the gate's pose; the caller ensures that the arm rests.

    Others estimate `in_motion`, or `several` contacts at once.
    """

    in_motion = several = False

    def __init__(
        self,
        estimator: Any,
        tares: Tares,
        gate: MotionGate,
        arm: RestingArm,
        joint_speed_rad_s: float,
    ) -> None:
        self._estimator, self._tares, self._gate, self._arm = estimator, tares, gate, arm
        self._speed_rad_s = joint_speed_rad_s
        self._contact_m = arm.mechanism.contact_m.tolist()
        self._prepare()

    def _prepare(self) -> None:
        """Compile or load now what the first contact would wait for."""
        self._arm.prepare(self._gate.pose_rad, anywhere=False)

    def find(self, tensions_n: Array, stamp_ns: int, threshold: float) -> FoundContacts | None:
        """The contacts behind tensions (M,), of a probability `threshold`; None without a tare.

        Raises:
            CableSenseError: the model cannot take this sample.
        """
        unloaded = self._tares.unloaded_n
        return None if unloaded is None else self._found(tensions_n - unloaded, threshold)

    def _found(self, difference_n: Array, threshold: float) -> FoundContacts:
        """As `find`, behind tensions less unloaded ones (M,)."""
        pose_rad = self._gate.pose_rad if self._estimator.pose_aware else None
        return self._decided(self._estimator.estimate(difference_n, pose_rad), threshold)

    def _decided(self, estimate: Estimate, threshold: float) -> FoundContacts:
        probabilities = estimate.probabilities.tolist()
        angle_deg, size_n = float(estimate.angle_deg), float(estimate.magnitude_n)
        contact = decide(probabilities, angle_deg, size_n, threshold, self._contact_m)
        return FoundContacts(probabilities, (contact,) if contact.segment else (), estimate)

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

    def _prepare(self) -> None:
        self._last_ns: int | None = None
        self._predicted: tuple[Array, Array] | None = None
        self.restart(self._gate.command_rad)

    def find(self, tensions_n: Array, stamp_ns: int, threshold: float) -> FoundContacts | None:
        """See `ContactModel`; the trajectory is followed without a tare too."""
        passed_s = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        self._motion.advance(max(0.0, passed_s))
        set_point = self._motion.state
        unloaded = self._unloaded_n(set_point[0])
        if unloaded is None:
            self._estimator.tare()
        difference = np.zeros(len(tensions_n)) if unloaded is None else tensions_n - unloaded
        estimate = self._estimator.estimate(difference, *set_point, stamp_ns * 1e-9)
        return None if unloaded is None else self._decided(estimate, threshold)

    def _decided(self, estimate: Estimate, threshold: float) -> FoundContacts:
        found = super()._decided(estimate, threshold)
        return found if estimate.segment else found._replace(contacts=())

    def command(self, command_rad: Array) -> None:
        """See `ContactModel`."""
        self._motion.go_to(command_rad)

    def tared(self) -> None:
        """The estimator gets tensions since the tare, as in training."""
        self._estimator.tare()

    def restart(self, command_rad: Array) -> None:
        """See `ContactModel`."""
        self._motion = JointMotion(command_rad, self._speed_rad_s)
        self._last_ns = self._predicted = None
        self._estimator.forget()

    def _unloaded_n(self, angle_rad: Array) -> Array | None:
        if not self._motion.moving:
            self._predicted = None
            return self._tares.unloaded_n
        at = self._predicted
        if at is None or np.abs(angle_rad - at[0]).max() > _PREDICTED_EVERY_RAD:
            self._predicted = at = angle_rad, self._arm.predict_n(angle_rad)
        tare = self._tares.present
        return None if tare is None else tare.unloaded_n(at[1])


class MultiContactModel(ContactModel):
    """A memoryless estimator of several contacts; statics gives their directions.

    No estimate is stated: the model has the uncertainty of each force, not of its direction.
    """

    several = True

    def _found(self, difference_n: Array, threshold: float) -> FoundContacts:
        pose_rad = self._gate.pose_rad
        estimates = self._estimator.estimate_batch(difference_n, pose_rad)
        touching, force_n = estimates.probabilities[0], estimates.magnitude_n[0].tolist()
        probabilities = [float(np.prod(1.0 - touching)), *touching.tolist()]
        touched = [
            Contact(n, 0.0, force, self._contact_m[n - 1])
            for n, force in enumerate(force_n, start=1)
            if probabilities[n] >= threshold and force > 0.0
        ]
        if not touched:
            return FoundContacts(probabilities, ())
        self._arm.command(pose_rad)
        directed, _ = self._arm.explained(difference_n, touched)
        contacts = [
            contact._replace(angle_deg=best.angle_deg)
            for contact, best in zip(touched, directed, strict=True)
        ]
        contacts.sort(key=lambda contact: -contact.magnitude_n)
        return FoundContacts(probabilities, tuple(contacts))


class AnywhereModel(ContactModel):
    """A memoryless estimator of contacts anywhere: of one, or of two where that is likelier."""

    several = True

    def _prepare(self) -> None:
        self._estimator.prepare()
        self._arm.prepare(self._gate.pose_rad, anywhere=True)
        mechanism = self._arm.mechanism
        self._damping_n_m_s = mechanism.joint_damping_n_m_s
        self._inertia_kg_m2 = _inertia_kg_m2(mechanism)

    def _found(self, difference_n: Array, threshold: float) -> FoundContacts:
        """Damping and inertia count as noise that is as large as their torques.

        Under noisy commands they count only if the readings are not those of an arm at rest.
        """
        self._estimator.torque_covariance_n2_m2 = None
        if (unrest := self._gate.unrest) is None:
            return super()._found(difference_n, threshold)
        if self._gate.noisy:
            estimate = self._estimator.estimate(difference_n, self._gate.pose_rad)
            assert estimate.place is not None
            if estimate.place.chi2 <= _AT_REST_CHI2:
                return self._decided(estimate, threshold)
        speed_rad_s, swing_rad_s2 = unrest
        swing_n_m = _SWING * self._inertia_kg_m2 * swing_rad_s2
        damping_n_m = self._damping_n_m_s * speed_rad_s
        covariance_n2_m2 = swing_n_m @ swing_n_m.T + np.diag(damping_n_m**2)
        self._estimator.torque_covariance_n2_m2 = covariance_n2_m2
        found = super()._found(difference_n, threshold)
        if found.contacts and max(found.probabilities[1:]) < _ONE_SEGMENT:
            return found._replace(doubt="in motion the contact may be on another segment")
        return found

    def _decided(self, estimate: Estimate, threshold: float) -> FoundContacts:
        place, probabilities = estimate.place, estimate.probabilities.tolist()
        assert place is not None
        if place.chi2 > _ONE_UP_TO_CHI2:
            pair, misfit = self._estimator.two()
            if pair.log_evidence[0] > max(place.log_evidence, 0.0) + _TWO_BEYOND:
                return FoundContacts(
                    probabilities, *_two(pair, self._estimator.reach_m), misfit=misfit
                )
        if 1.0 - probabilities[0] < threshold:
            return FoundContacts(probabilities, (), estimate)
        contact = Contact(
            1 + int(estimate.probabilities[1:].argmax()),
            estimate.angle_deg,
            estimate.magnitude_n if place.force_known else 0.0,
            place.place_m,
            place.along_n if place.along_std_n < _ALONG_KNOWN_N else 0.0,
            place.moment_n_m,
        )
        doubt, surface = "", self._estimator.surface
        most = max(_FRICTION, surface.friction if surface else 0.0) * estimate.magnitude_n
        if abs(contact.along_n) > most + NORMAL_95 * place.along_std_n:
            doubt = (
                f"an axial force of {place.along_n:.0f} N with a normal one of "
                f"{estimate.magnitude_n:.0f} N is more than friction makes: there may be "
                "two contacts, one of them on segment 1"
            )
        return FoundContacts(probabilities, (contact,), estimate, doubt, place.misfit)


def _inertia_kg_m2(mechanism: Mechanism) -> Array:
    """(2N, 2N) of the straight arm, its segments' masses in their centres."""
    at_joint, slope = contact_torques(mechanism, np.zeros(mechanism.joint_count), np.eye(3))
    by_force_m = at_joint + mechanism.centre_of_mass_m[:, None, None] * slope
    return np.asarray(np.einsum("n,nxi,nxj->ij", mechanism.mass_kg, by_force_m, by_force_m))


def _two(pair: ContactPair, reach: Array) -> tuple[tuple[Contact, ...], None, str]:
    """The contacts of a pair within a reach (N, 2), the strongest first; why they are doubted."""
    contacts, unknown_n = [], 0.0
    for k, (along_n, y, z) in enumerate(pair.force_n[0].tolist()):
        number, place_m = int(pair.segments[0, k]), float(pair.place_m[0, k])
        along_std_n, *std_n = pair.force_std_n[0, k].tolist()
        low_m, high_m = reach[number - 1].tolist()
        anywhere = bool(pair.place_std_m[0, k] > _UNKNOWN_PLACE * (high_m - low_m))
        if not anywhere:
            unknown_n = max(unknown_n, *std_n)
        force_n = (along_n if along_std_n < _ALONG_KNOWN_N else 0.0, y, z)
        contacts.append(Contact.of_force(number, force_n, place_m, known=not anywhere))
    contacts.sort(key=lambda contact: -contact.magnitude_n)
    doubt = ""
    if not contacts[-1].magnitude_n:
        doubt = "only the moment of one contact is known: other pairs explain the readings too"
    elif NORMAL_95 * unknown_n > FORCE_OFF_N:
        doubt = f"two forces here are known to {NORMAL_95 * unknown_n:.0f} N only"
    return tuple(contacts), None, doubt


def contact_model(
    estimator: AnyEstimator,
    tares: Tares,
    gate: MotionGate,
    arm: RestingArm,
    settings: EstimationSettings,
) -> ContactModel:
    """The model of an estimator's kind."""
    kind = ContactModel
    if isinstance(estimator, SequenceEstimator):
        kind = HistoryDependentModel
    elif isinstance(estimator, MultiEstimator):
        kind = MultiContactModel
    elif isinstance(estimator, AnywhereEstimator):
        kind = AnywhereModel
    return kind(estimator, tares, gate, arm, settings.joint_speed_rad_s)
