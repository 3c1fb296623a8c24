"""From a reading of an arm at one pose to the contacts that are stated of it.

`LawContacts` asks the law of a calibrated arm; `NetworkContacts` a network of the paper, in its
plain form, about the difference to the tared readings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95, ContactPlace, Estimate
from cablesense_contact.felt import FeltMachine, torque_covariance_at_rest
from cablesense_contact.inference.estimator import Estimator, MultiEstimator
from cablesense_contact.judgement import ContactState, Judge, Judgement
from cablesense_contact.law import Law, LawOutput
from cablesense_contact.slides import Belief
from cablesense_msgs_py.messages import Contact, ForceState
from cablesense_online.answer import decide
from cablesense_online.asked_together import AskedTogether
from cablesense_online.calibrated_arm import CalibratedArm, CalibratedState
from cablesense_online.motion import Unrest
from cablesense_online.tare import UnloadedArm
from cablesense_online.tared_arm import TaredArm, TaredState
from cablesense_sim.arm import Arm, of_each_segment

_STATES = {
    ContactState.FREE: ForceState.FREE,
    ContactState.CONTACT: ForceState.CONTACT,
    ContactState.MOMENT: ForceState.MOMENT,
    ContactState.UNCONFIRMED: ForceState.UNCONFIRMED,
    ContactState.IMPLAUSIBLE: ForceState.IMPLAUSIBLE,
}


@dataclass(frozen=True)
class Situation:
    """What beside a reading decides how it is answered: pose, time, motion, and friction.

    Attributes:
        pose_rad: (2N,) where the joints are commanded.
        stamp_ns: time of the sample since the epoch.
        unrest: how the joints move; None at rest.
        freed: whether a breath has taken friction out of the readings.
    """

    pose_rad: Array
    stamp_ns: int
    unrest: Unrest | None = None
    freed: bool = False


@dataclass(frozen=True)
class FoundContacts:
    """The contacts in a reading, the strongest first.

    Attributes:
        force: what is stated of the force.
        probabilities: (N + 1,) that nothing touches, and of each segment that it is touched.
        estimate: the one behind a single contact, or none; None if the model states none.
        doubt: what else would explain the reading; empty without doubt.
        pose_rad: pose in whose frames the contacts are; None where that is the command.
    """

    force: ForceState
    probabilities: list[float]
    contacts: tuple[Contact, ...]
    estimate: Estimate | None = None
    doubt: str = ""
    pose_rad: Array | None = None


class ContactFinder(Protocol):
    """Finds contacts in readings of one arm."""

    @property
    def unloaded(self) -> UnloadedArm[Any]:
        """How what is known of the unloaded arm goes on."""
        ...

    @property
    def on_each_segment(self) -> bool:
        """Whether the force on each segment is stated."""
        ...

    @property
    def most_together(self) -> int:
        """As many readings are best asked of together where several wait."""
        ...

    def with_threshold(self, contact_threshold: float) -> ContactFinder:
        """The same, that states contacts from this probability on."""
        ...

    def asked_together(
        self, state: Any, reading_n: Array, situation: Situation
    ) -> tuple[AskedTogether, ...]:
        """What will be asked of readings (K, M) that came together, as far as can be told."""
        ...

    def find(
        self,
        state: Any,
        reading_n: Array,
        situation: Situation,
        asked: Sequence[AskedTogether] = (),
    ) -> tuple[Any, FoundContacts | None]:
        """The contacts behind readings (M,), and what is known of the unloaded arm after them.

        None while the unloaded state is unknown. What was asked already is not asked again.
        """
        ...


class LawContacts:
    """Contacts by the law of a calibrated arm."""

    on_each_segment = True

    def __init__(
        self,
        machine: FeltMachine,
        law: Law,
        unloaded: CalibratedArm,
        contact_threshold: float,
        hidden_above_n: float,
    ) -> None:
        self.unloaded = unloaded
        self._law = law
        self._machine = machine
        self._hidden_above_n = hidden_above_n
        self._judge = Judge(machine, contact_threshold)
        self._middle_m = machine.middle_m
        self._joint_m = machine.joint_m
        self._covariance_at_rest = torque_covariance_at_rest(machine)

    @property
    def most_together(self) -> int:
        """As of the law."""
        return self._law.most_together

    def with_threshold(self, contact_threshold: float) -> LawContacts:
        """The same with another probability from which on a contact is stated."""
        return LawContacts(
            self._machine, self._law, self.unloaded, contact_threshold, self._hidden_above_n
        )

    def asked_together(
        self, state: CalibratedState, reading_n: Array, situation: Situation
    ) -> tuple[AskedTogether, ...]:
        """What the law says of readings (K, M) that came together, as `find` will ask it.

        By what is known at the first of them. That seldom changes from one to the next; where it
        does, `find` asks again.
        """
        if not state.known:
            return ()
        torques_n2_m2 = self._torques_of(situation.unrest)
        commands_rad = np.tile(situation.pose_rad, (len(reading_n), 1))
        questions = [False]  # as if untouched so far; else also as if touched on its way
        if not self.unloaded.seen_untouched(state):
            questions.append(True)
        asked = []
        for touched in questions:
            _, belief = self._belief(state, reading_n[0], situation, touched=touched)
            seen = self._law(
                reading_n, commands_rad, belief.mean, belief.covariance, torques_n2_m2
            )
            asked.append(AskedTogether(reading_n, situation.pose_rad, belief, torques_n2_m2, seen))
        return tuple(asked)

    def find(
        self,
        state: CalibratedState,
        reading_n: Array,
        situation: Situation,
        asked: Sequence[AskedTogether] = (),
    ) -> tuple[CalibratedState, FoundContacts | None]:
        """The contacts in a reading (M,), N, and the state after it; None while untared.

        Where the arm has not been seen untouched at this pose, the law is asked twice: first as if
        the arm came here untouched, so that its cables have slid as that motion makes them. If
        that shows a contact, the arm may have been touched on its way, and its cables may have
        slid anyhow; the second answer, which allows for that, is the one that counts.
        """
        if not state.known:
            return state, None
        state, seen = self._seen(state, reading_n, situation, asked)
        judgement = self._judge(seen, reading_n)
        if judgement.state is not ContactState.FREE and not self.unloaded.seen_untouched(state):
            state, seen = self._seen(state, reading_n, situation, asked, touched=True)
            judgement = self._judge(seen, reading_n)
        force = _STATES[judgement.state]
        if force is ForceState.FREE and situation.unrest is None:
            state = self.unloaded.with_untouched(state, reading_n)
        if force is not ForceState.FREE or situation.freed:
            state = state.touched
        if force is ForceState.FREE and self._unseen_n(seen) > self._hidden_above_n:
            force = ForceState.HIDDEN
        touched = judgement.state not in (ContactState.FREE, ContactState.IMPLAUSIBLE)
        contacts = (self._contact(seen, judgement),) if touched else ()
        return state, FoundContacts(
            force,
            judgement.probabilities.tolist(),
            contacts,
            self._estimate(seen, judgement),
            judgement.doubt,
            self._machine.frame_pose(situation.pose_rad, seen.pose_rad[0]),
        )

    def _seen(
        self,
        state: CalibratedState,
        reading_n: Array,
        situation: Situation,
        asked: Sequence[AskedTogether],
        *,
        touched: bool = False,
    ) -> tuple[CalibratedState, LawOutput]:
        """What the law says of a reading (M,), by what is known of the arm then."""
        state, belief = self._belief(state, reading_n, situation, touched=touched)
        pose_rad = situation.pose_rad
        torques_n2_m2 = self._torques_of(situation.unrest)
        for together in asked:
            seen = together.answer(reading_n, pose_rad, belief, torques_n2_m2)
            if seen is not None:
                return state, seen
        seen = self._law(
            reading_n[None], pose_rad[None], belief.mean, belief.covariance, torques_n2_m2
        )
        return state, seen

    def _belief(
        self, state: CalibratedState, reading_n: Array, situation: Situation, *, touched: bool
    ) -> tuple[CalibratedState, Belief]:
        """What is known of the arm at a reading (M,)."""
        return self.unloaded.belief(
            state, reading_n, situation.stamp_ns, freed=situation.freed, touched=touched
        )

    def _torques_of(self, unrest: Unrest | None) -> Array:
        """(T, T) covariance of the torques of a motion."""
        if unrest is None:
            return self._covariance_at_rest
        return self._machine.unrest(unrest.speed_rad_s, unrest.swing_rad_s2)

    def _unseen_n(self, seen: LawOutput) -> float:
        """The force in the middle of where the last segment is touched that would not show, N.

        With 95 % confidence, and in directions across it that are felt at all.
        """
        by_torque = seen.by_torque[0]
        precision = by_torque.T @ seen.information_n2[0] @ by_torque
        lever = seen.at_joint_m[0, -1, 1:] + self._middle_m[-1] * seen.by_place[0, -1, 1:]
        information = lever @ precision @ lever.T
        unfelt = np.eye(2) - self._machine.felt_across[-1]
        (yy, yz), (_, zz) = information + np.trace(information) * unfelt
        least = 0.5 * (yy + zz) - math.hypot(0.5 * (yy - zz), yz)
        return NORMAL_95 / math.sqrt(max(least, 1e-12))

    def _contact(self, seen: LawOutput, judgement: Judgement) -> Contact:
        along_n, y, z = seen.force_n[0].tolist()
        known = judgement.state is not ContactState.MOMENT
        around_y, around_z = seen.moment_n_m[0].tolist()
        moment_n_m = math.hypot(around_y, around_z)
        if not known:
            # the direction of the force, by its moment: around_z = s f_y, around_y = -s f_z
            y = around_z
            z = -around_y
        along_std_n = float(seen.contact_covariance[0, 1, 1]) ** 0.5
        is_along_known = along_std_n < self._machine.known_n
        return Contact(
            judgement.segment,
            math.degrees(math.atan2(y, z)) % 360.0,
            math.hypot(y, z) if known else 0.0,
            float(seen.place_m[0]),
            along_n if is_along_known else 0.0,
            moment_n_m,
        )

    def _estimate(self, seen: LawOutput, judgement: Judgement) -> Estimate:
        along_n, y, z = seen.force_n[0].tolist()
        size_n = max(math.hypot(y, z), 1e-9)
        covariance = seen.contact_covariance[0]
        (yy, yz), (_, zz) = covariance[2:, 2:].tolist()
        across_n2 = z**2 * yy + y**2 * zz - 2.0 * y * z * yz
        low_n, high_n = seen.magnitude_ci95_n[0].tolist()
        low_m, high_m = (seen.region_m[0] - self._joint_m[judgement.segment - 1]).tolist()
        touched = judgement.state is not ContactState.FREE
        return Estimate(
            probabilities=judgement.probabilities,
            segment=judgement.segment if touched else 0,
            angle_deg=math.degrees(math.atan2(y, z)) % 360.0,
            magnitude_n=size_n,
            magnitude_std_n=(high_n - low_n) / (2.0 * NORMAL_95),
            angle_std_deg=math.degrees(math.atan(math.sqrt(max(across_n2, 0.0)) / size_n**2)),
            low_n=low_n,
            high_n=high_n,
            place=ContactPlace(
                place_m=float(seen.place_m[0]),
                low_m=low_m,
                high_m=high_m,
                along_n=along_n,
                covariance=covariance,
                moment_n_m=float(np.hypot(*seen.moment_n_m[0])),
                force_known=judgement.state is not ContactState.MOMENT,
            ),
        )


class NetworkContacts:
    """Contacts by a network of the paper, at the contact points of the arm file, at rest."""

    most_together = 1

    def __init__(
        self,
        arm: Arm,
        network: Estimator | MultiEstimator,
        unloaded: TaredArm,
        contact_threshold: float,
        hidden_above_n: float,
    ) -> None:
        self.unloaded = unloaded
        self._file = arm
        self._threshold = contact_threshold
        self._hidden_above_n = hidden_above_n
        self.on_each_segment = isinstance(network, MultiEstimator)
        self._network = network
        self._contact_m = of_each_segment(arm.segments.contact_m, arm.segment_count)

    def with_threshold(self, contact_threshold: float) -> NetworkContacts:
        """The same with another probability from which on a contact is stated."""
        return NetworkContacts(
            self._file, self._network, self.unloaded, contact_threshold, self._hidden_above_n
        )

    def asked_together(
        self, state: TaredState, reading_n: Array, situation: Situation
    ) -> tuple[AskedTogether, ...]:
        """Nothing: each reading is asked of when its turn comes."""
        del state, reading_n, situation
        return ()

    def find(
        self,
        state: TaredState,
        reading_n: Array,
        situation: Situation,
        asked: Sequence[AskedTogether] = (),
    ) -> tuple[TaredState, FoundContacts | None]:
        """The contacts in a reading (M,), N, and the state after it; None while untared."""
        del asked
        if not state.known:
            return state, None
        state = self.unloaded.predicted(state)
        unloaded_n = self.unloaded.unloaded_n(state)
        if unloaded_n is None:
            return state, None
        difference_n = reading_n - unloaded_n
        pose_rad = situation.pose_rad if self._network.pose_aware else None
        if isinstance(self._network, MultiEstimator):
            return state, self._several(self._network, difference_n, pose_rad)
        return state, self._single(self._network, difference_n, pose_rad)

    def _single(
        self, network: Estimator, difference_n: Array, pose_rad: Array | None
    ) -> FoundContacts:
        estimate = network.estimate(difference_n, pose_rad)
        probabilities = estimate.probabilities.tolist()
        if not estimate.plausible:
            doubt = _fits_no_force(estimate.misfit_n)
            return FoundContacts(ForceState.IMPLAUSIBLE, probabilities, (), estimate, doubt)
        angle_deg = float(estimate.angle_deg)
        size_n = float(estimate.magnitude_n)
        contact = decide(probabilities, angle_deg, size_n, self._threshold, self._contact_m)
        if not contact.segment:
            hidden = estimate.high_n > self._hidden_above_n
            force = ForceState.HIDDEN if hidden else ForceState.FREE
            return FoundContacts(force, probabilities, (), estimate)
        return FoundContacts(ForceState.CONTACT, probabilities, (contact,), estimate)

    def _several(
        self, network: MultiEstimator, difference_n: Array, pose_rad: Array | None
    ) -> FoundContacts:
        """Sizes of the forces; the network gives no directions, so they are unconfirmed."""
        answer = network.estimate_batch(difference_n, pose_rad)
        touching = answer.probabilities[0]
        sizes_n = answer.magnitude_n[0].tolist()
        probabilities = [float(np.prod(1.0 - touching)), *touching.tolist()]
        if not answer.plausible[0]:
            doubt = _fits_no_force(float(answer.misfit_n[0]))
            return FoundContacts(ForceState.IMPLAUSIBLE, probabilities, (), doubt=doubt)
        contacts = [
            Contact(n, 0.0, size_n, self._contact_m[n - 1])
            for n, size_n in enumerate(sizes_n, start=1)
            if probabilities[n] >= self._threshold and size_n > 0.0
        ]
        contacts.sort(key=lambda contact: -contact.magnitude_n)
        doubt = "the network of several contacts gives no directions" if contacts else ""
        force = ForceState.UNCONFIRMED if contacts else ForceState.FREE
        return FoundContacts(force, probabilities, tuple(contacts), doubt=doubt)


def _fits_no_force(misfit_n: float) -> str:
    return f"{misfit_n:.1f} N (RMS) of the readings fit no force on the arm"
