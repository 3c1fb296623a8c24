"""Estimation of contacts from serialized tension samples: the estimator node without ROS.

A sample's way is `Estimation.sample`: the message is read and its stamp and values are checked;
the arm is moving or at a pose; contacts are found by what is known of the arm; what is stated of
them is an `Answer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import Calibration
from cablesense_msgs_py.messages import (
    BREATH_END,
    ForceState,
    NamedOrder,
    breath_turn,
    cable_offsets_m,
    joint_command_rad,
)
from cablesense_msgs_py.serialized import EffortReader
from cablesense_msgs_py.topics import ContractError
from cablesense_online.answer import Answer, ContactStatics
from cablesense_online.breathing import BreathReadings
from cablesense_online.contacts import (
    FoundContacts,
    LawContacts,
    NetworkContacts,
    Situation,
    Unrest,
)
from cablesense_online.motion_gate import MotionGate
from cablesense_online.samples import (
    FollowedPublisher,
    InputHealth,
    ProblemKind,
    SampleCheck,
    SampleClock,
    SampleError,
)
from cablesense_online.settings import LIVE_SETTINGS, EstimationSettings
from cablesense_online.tare import CalibratedArm, Tare, TareError
from cablesense_online.transients import Transients
from cablesense_sim.arm import Arm, per_segment
from cablesense_sim.build import mechanism_of

_REFUSED = {ProblemKind.CLOCK: ForceState.STALE, ProblemKind.MISFIT: ForceState.IMPLAUSIBLE}
_ASSUMED_POSE_RAD = 0.01
"""A first command within this of the assumed pose confirms it: joints' zeros are as far off."""
_TRANSIENT = "the force has just changed: the arm may swing"


class Estimation:
    """Takes samples and commands as they come; gives no force from what cannot be trusted.

    Attributes:
        settings: those in force; `adjust` changes some.
        publisher, clock, check, health: checks of the input.
        gate: the command in force, and whether the arm moves.
        breathing: what readings would be without friction.
        contacts: finds contacts by what is known of the arm.
        unloaded: the unloaded state: tares, or a calibration.
        largest_force_n: since the reporter last set it to zero.
        command_received: whether any joint command has come; until then the arm is assumed to be
            straight.
    """

    def __init__(
        self,
        arm: Arm,
        contacts: LawContacts | NetworkContacts,
        settings: EstimationSettings,
        now_s: float,
    ) -> None:
        self.settings = settings
        self._reader = EffortReader()
        self._cable_order = NamedOrder(arm.cable_names, "cables")
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        count = arm.segment_count
        length_m = np.array(per_segment(arm.segments.length_m, count))
        self._joint_m = np.concatenate([[0.0], np.cumsum(length_m)[:-1]])
        self._contact_m = per_segment(arm.segments.contact_m, count)
        self._statics = ContactStatics(mechanism_of(arm))
        self.clock = SampleClock(settings.stale_after_s)
        self.check = SampleCheck(arm.sensors.range_n, settings.slack_below_n)
        self.gate = MotionGate(np.zeros(arm.joint_count), settings)
        self.breathing = BreathReadings(settings.settle_s)
        self.contacts = contacts
        self.unloaded = contacts.arm
        self._transients = Transients()
        self._breath_rad: Array | None = None
        self.command_received = False
        self.largest_force_n = 0.0
        self.start(now_s)

    def follow(self, number: int, now_s: float) -> bool:
        """Whether another publisher is followed from the sample with this publication number on.

        To be called before `sample`, where several may publish, at monotonic time `now_s`.

        Raises:
            SampleError: it is not a sample of the followed publisher, so there is no answer to it.
        """
        try:
            another = self.publisher.accept(number, now_s)
        except SampleError as problem:
            self.health.refused(problem)
            raise
        if another:
            self.gate.wait_anew()
            self.breathing.moved()
            self.unloaded.forget_readings()
        return another

    def sample(self, raw: bytes, now_ns: int, now_s: float) -> Answer:
        """The answer to one serialized `JointState` of tensions.

        `now_ns` is of the clock that sets the stamps, `now_s` monotonic.
        """
        self.health.arrived(now_s)
        stamp_ns = 0
        stage = ProblemKind.MALFORMED
        try:
            message = self._reader.read(raw)
            self.clock.accept(message.stamp_ns, now_ns)
            stamp_ns = message.stamp_ns or now_ns
            moving = self._moving(stamp_ns, now_ns, now_s)
            stage = ProblemKind.NAMES
            readings_n = self._cable_order.pick(message.names, message.values, "effort")
            self.check.check(readings_n)
            if moving:
                self.gate.estimated(known=False)
                self._transients.forget()
                answer = Answer(force=ForceState.MOVING)
            else:
                stage = ProblemKind.ESTIMATE
                answer = self._answered(readings_n, stamp_ns)
        except SampleError as problem:
            answer = self._refused(problem)
        except CableSenseError as error:
            answer = self._refused(SampleError(stage, str(error)))
        answer.stamp_ns = stamp_ns
        return answer

    def _moving(self, stamp_ns: int, now_ns: int, now_s: float) -> bool:
        """Whether the arm may be moving; where it is at rest, its set-points are followed."""
        gate = self.gate
        moving = gate.moving(stamp_ns, now_ns, now_s)
        if gate.step:
            self.breathing.moved()
        if not moving:
            self.unloaded.at(gate.pose_rad)
            if gate.turning:
                self.breathing.moved()
        return moving

    def _answered(self, readings_n: Sequence[float], stamp_ns: int) -> Answer:
        """Find contacts in checked readings (M,), and say what can be stated of them."""
        freed_n = self.breathing.without_friction(readings_n, stamp_ns)
        if freed_n is None:
            return Answer(force=ForceState.MOVING)
        freed = self.breathing.known
        if freed or not self.settings.await_breath:
            self.unloaded.add(freed_n)
        if self.unloaded.automatic and not self.unloaded.refusal():
            tare = self._tared_by_itself(stamp_ns)
            return Answer(force=ForceState.UNTARED, new_tare=tare)
        situation = Situation(self.gate.pose_rad, stamp_ns, self._unrest(), freed)
        finding = self.contacts.find(np.array(freed_n), situation)
        if finding is None:
            return Answer(force=ForceState.UNTARED)
        self.gate.estimated(known=True)
        force, doubt = self._stated(finding, stamp_ns)
        if force is ForceState.IMPLAUSIBLE:
            raise SampleError(ProblemKind.MISFIT, f"readings fit no contact: {doubt}")
        if finding.contacts:
            self.largest_force_n = max(self.largest_force_n, finding.contacts[0].magnitude_n)
        return Answer(
            force,
            finding.contacts,
            finding.estimate,
            self._contact_m,
            finding.probabilities,
            doubt=doubt,
        )

    def _tared_by_itself(self, stamp_ns: int) -> Tare | None:
        """The automatic tare; None where the readings are not those of an untouched arm."""
        try:
            return self.unloaded.take(stamp_ns, by_itself=True)
        except TareError as error:
            self.unloaded.forget_readings()
            self.auto_tare_problem = str(error)
            return None

    def _unrest(self) -> Unrest | None:
        """How the joints move on a followed motion; under noisy commands they rest."""
        unrest = self.gate.unrest
        if unrest is None or self.gate.noisy:
            return None
        return Unrest(*unrest)

    def _stated(self, found: FoundContacts, stamp_ns: int) -> tuple[ForceState, str]:
        """What is stated of the contacts, and why they are doubted."""
        estimate = found.estimate
        if estimate is None or estimate.place is None:
            return found.force, found.doubt
        segment = 1 + int(np.argmax(estimate.probabilities[1:]))
        lever_m = float(self._joint_m[segment - 1]) + estimate.place.place_m
        changing = self._transients.changing(estimate, lever_m, stamp_ns)
        vouched = found.force in (ForceState.CONTACT, ForceState.MOMENT)
        if changing and vouched:
            return ForceState.UNCONFIRMED, _TRANSIENT
        if changing and found.force is ForceState.IMPLAUSIBLE:
            return ForceState.UNCONFIRMED, f"{_TRANSIENT}; or {found.doubt}"
        return found.force, found.doubt

    def _refused(self, problem: SampleError) -> Answer:
        if problem.kind is ProblemKind.MISFIT and self.gate.settling:
            self.gate.estimated(known=False)
            return Answer(force=ForceState.MOVING)
        self.health.refused(problem)
        return Answer(force=_REFUSED.get(problem.kind, ForceState.REFUSED), problem=problem)

    def stale(self, now_s: float) -> bool:
        """Whether the last message is too old for its answer to be valid."""
        return self.health.silence_s(now_s) > self.clock.stale_after_s

    def command(self, message: Any) -> bool:
        """Take over a `JointState` of commanded angles; gives whether the tare was dropped.

        Raises:
            CableSenseError: the message breaks the contract; the previous command stays in force.
        """
        command = joint_command_rad(message, self._joint_order, self.gate.command_rad)
        turn = breath_turn(message)
        if turn is None:
            return self._go_to(command)
        self._breath_rad = None if turn == BREATH_END else command
        self._mark(turn, message)
        return False

    def offset(self, message: Any) -> None:
        """Take over a `JointState` of lengths that are added to the cables' commanded ones.

        Those of a breath's whole turns average out; while others last, there is no estimate.

        Raises:
            ContractError: the message breaks the contract.
        """
        offsets_m = cable_offsets_m(message, self._cable_order)
        turn = breath_turn(message)
        if turn is not None:
            self._mark(turn, message)
        elif offsets_m.any() or self.breathing.breathing:
            self._mark(0 if offsets_m.any() else BREATH_END, message, lasting=True)

    def miss_breather(self, now_s: float) -> bool:
        """Whether the breather has gone in mid-breath; its last command counts then.

        To be called again and again, at monotonic times `now_s`.
        """
        if not self.breathing.silent(now_s):
            return False
        self.breathing.give_up("the breather fell silent in mid-breath")
        if self._breath_rad is not None:
            self._go_to(self._breath_rad)
        return True

    def take_tare(self, now_ns: int, *, forced: bool = False) -> Tare:
        """Take the latest readings as the unloaded state, at `now_ns` since the epoch.

        Raises:
            TareError: too few readings yet, they are not steady, or, unless `forced`, they are not
                those of the untouched arm.
        """
        return self.unloaded.take(now_ns, forced=forced)

    def undo_tare(self) -> Tare | None:
        """Return to the state before the last tare and give the one then in force, if any.

        Raises:
            TareError: there is nothing to undo.
        """
        return self.unloaded.undo()

    def calibrate(self, calibration: Calibration) -> None:
        """Take over a calibration.

        Raises:
            TareError: the model is a network, which takes none.
        """
        if not isinstance(self.unloaded, CalibratedArm):
            raise TareError("this model takes tension differences; a calibration needs a law")
        self.unloaded.load(calibration)

    def restore(self, calibration: Calibration, command_rad: Array, *, known: bool) -> None:
        """Answer as a recorded estimator from the moment that it used a calibration.

        Raises:
            TareError: the model is a network, which takes none.
        """
        if not isinstance(self.unloaded, CalibratedArm):
            raise TareError("this model takes tension differences; a calibration needs a law")
        if not self.command_received:
            self.gate.rest_at(command_rad)
        self.unloaded.restore(calibration, known=known)

    def adjust(self, contact_threshold: float, stale_after_s: float, slack_below_n: float) -> None:
        """Take over the settings that may change while running."""
        values = (contact_threshold, stale_after_s, slack_below_n)
        update = dict(zip(LIVE_SETTINGS, values, strict=True))
        self.settings = self.settings.model_copy(update=update)
        self.contacts.threshold(contact_threshold)
        self.clock.stale_after_s = stale_after_s
        self.publisher.stale_after_s = self.clock.stale_after_s
        self.check.slack_below_n = slack_below_n

    def start(self, now_s: float) -> None:
        """Samples begin, or begin again, now; earlier ones do not count any more."""
        self.publisher = FollowedPublisher(self.clock.stale_after_s)
        self.health = InputHealth(self.clock, self.publisher, now_s)
        self.unloaded.forget_readings()
        self._transients.forget()
        self.auto_tare_problem = ""

    @property
    def at_pose(self) -> ContactStatics:
        """Contacts in base axes and at the joints, at the pose of the last estimate."""
        return self._statics.at(self.gate.pose_rad)

    def _go_to(self, command_rad: Array) -> bool:
        """As `command`, with angles (2N,)."""
        dropped = False
        if not np.array_equal(command_rad, self.gate.command_rad):
            if not self.gate.follows(command_rad):
                off_rad = float(np.abs(command_rad - self.gate.command_rad).max())
                if not self.command_received and off_rad > _ASSUMED_POSE_RAD:
                    dropped = self.unloaded.drop_own()
                self.unloaded.forget_readings()
                self.breathing.moved()
            self.gate.command(command_rad)
        self.command_received = True
        return dropped

    def _mark(self, turn: int, message: Any, *, lasting: bool = False) -> None:
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        if not (stamp_ns or lasting):
            raise ContractError("header.stamp is 0; a breath's messages state their times")
        self.breathing.mark(turn, max(stamp_ns, 1), lasting=lasting)
