"""Estimation of contacts from serialized tension samples: the estimator node without ROS.

A sample's way is `Estimation.sample`: the message is read and its stamp and values are checked;
the unloaded state is subtracted; the model estimates; a contact is decided on and checked against
the readings; an `Answer` is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cablesense_base import Array, CableSenseError
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
from cablesense_online.models import AnyEstimator, FoundContacts, contact_model
from cablesense_online.motion_gate import MotionGate
from cablesense_online.plausibility import PlausibilityCheck
from cablesense_online.samples import (
    FollowedPublisher,
    InputHealth,
    ProblemKind,
    SampleCheck,
    SampleClock,
    SampleError,
)
from cablesense_online.state import (
    LIVE_SETTINGS,
    EstimationSettings,
    EstimatorState,
    Event,
    EventKind,
    EventLog,
    Tare,
)
from cablesense_online.stated_contacts import RestingArm
from cablesense_online.tare import DriftWatch, Tares
from cablesense_sim.arm import Arm
from cablesense_training.inference.estimator import SequenceEstimator

_STEPS = {-1: EventKind.CLOCK, 1: EventKind.CLOCK_AHEAD}
_REFUSED = {ProblemKind.CLOCK: ForceState.STALE, ProblemKind.MISFIT: ForceState.IMPLAUSIBLE}
_TARE_EVENTS = frozenset({EventKind.TARE, EventKind.AUTO_TARE, EventKind.TARE_UNDO})


class Estimation:
    """Takes samples and commands as they come; gives no force from what cannot be trusted.

    An answer follows from the samples in order and from the changes between them, not from their
    time of arrival. The latter decides only whether a sample is accepted at all, and whether its
    clock was set, which is a change. Changes count from the next accepted sample, whose answer
    carries the new state; `restore` makes another object give the same answers from there on.

    Attributes:
        publisher, clock, check, health: checks of the input.
        gate: the command in force, and whether the arm moves.
        breathing: what readings would be without friction.
        tares, drift: the unloaded state, and its drift over the time without contact.
        plausibility: whether readings fit the estimates.
        model: finds the contacts.
        largest_force_n: since the reporter last set it to zero.
        command_received: whether any joint command has come; until then the arm is assumed to be
            straight.
        reproducible: whether the answers after `restore` are those of the object that made the
            states; those of a history-dependent model are, once a start has been repeated.
    """

    def __init__(
        self,
        arm: Arm,
        estimator: AnyEstimator,
        settings: EstimationSettings,
        now_s: float,
        origin: Mapping[str, str] | None = None,
    ) -> None:
        """`origin` is stored in each state, next to the settings."""
        self._arm, self._settings = arm, settings
        self._origin = {**(origin or {}), "joints": " ".join(arm.joint_names)}
        self._reader = EffortReader()
        self._cable_order = NamedOrder(arm.cable_names, "cables")
        self._joint_order = NamedOrder(arm.joint_names, "joints")
        straight, resting = np.zeros(arm.joint_count), RestingArm(arm, settings.tare_samples)
        self._contact_m = resting.mechanism.contact_m.tolist()
        self._statics = ContactStatics(resting.mechanism)
        self.clock = SampleClock(settings.stale_after_s)
        self.check = SampleCheck(arm.sensors.range_n, settings.slack_below_n)
        self.gate = MotionGate(straight, settings)
        self.tares = Tares(resting, settings, straight)
        self.drift = DriftWatch(resting, settings)
        in_motion = isinstance(estimator, SequenceEstimator)
        self.plausibility = PlausibilityCheck(
            resting,
            settings.largest_misfit,
            # without a limit the estimator may be any object that answers
            estimator.metadata if settings.largest_misfit else None,
            "the model is history-dependent" if in_motion else "",
        )
        self.model = contact_model(estimator, self.tares, self.gate, resting, settings)
        self.reproducible = not in_motion
        self.breathing = BreathReadings(settings.settle_s)
        self._breath_rad: Array | None = None
        self._angles_rad = self.gate.angles_rad
        self.command_received = False
        self.largest_force_n = 0.0
        self._events = EventLog()
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
            self.tares.forget_readings()
            self._events.note(EventKind.PUBLISHER)
        return another

    def sample(self, raw: bytes, now_ns: int, now_s: float) -> Answer:
        """The answer to one serialized `JointState` of tensions.

        `now_ns` is of the clock that sets the stamps, `now_s` monotonic.
        """
        self.health.arrived(now_s)
        stamp_ns, state, stage = 0, None, ProblemKind.MALFORMED
        try:
            message = self._reader.read(raw)
            self.clock.accept(message.stamp_ns, now_ns)
            stamp_ns = message.stamp_ns or now_ns
            moving = self._moving(stamp_ns, now_ns, now_s)
            if self._events:
                state = self._changed_state(stamp_ns)
            stage = ProblemKind.NAMES
            readings_n = self._cable_order.pick(message.names, message.values, "effort")
            self.check.check(readings_n)
            if moving and not self.model.in_motion:
                self.gate.estimated(known=False)
                answer = Answer(force=ForceState.MOVING)
            else:
                stage = ProblemKind.ESTIMATE
                answer = self._answered(readings_n, stamp_ns, moving)
        except CableSenseError as error:
            answer = self._refused(
                error if isinstance(error, SampleError) else SampleError(stage, str(error))
            )
        answer.stamp_ns, answer.state = stamp_ns, state
        return answer

    def _moving(self, stamp_ns: int, now_ns: int, now_s: float) -> bool:
        """Whether the arm may be moving; where it is at rest, its set-points are followed."""
        gate, tares = self.gate, self.tares
        pose_rad, linear_at_rad = gate.pose_rad, tares.state.linear_at_rad
        moving = gate.moving(stamp_ns, now_ns, now_s)
        if gate.step:
            self.breathing.moved()
            self._events.note(_STEPS[gate.step])
        if moving:
            self.drift.interrupt()
        elif gate.angles_rad is not self._angles_rad:
            self._angles_rad = gate.angles_rad
            tares.follow(gate.angles_rad)
            followed = gate.pose_rad is not pose_rad and gate.pose_rad is not gate.command_rad
            if followed or tares.state.linear_at_rad is not linear_at_rad:
                self._events.note(EventKind.FOLLOWED)
            if gate.turning:
                self.breathing.moved()
                self.drift.interrupt()
        return moving

    def _answered(self, readings_n: Sequence[float], stamp_ns: int, moving: bool) -> Answer:
        """Estimate and decide on checked readings (M,), without stamp and state."""
        freed_n = self.breathing.without_friction(readings_n, stamp_ns)
        if self.breathing.learnt:
            self._events.note(EventKind.BREATH)
        if freed_n is None:
            return Answer(force=ForceState.MOVING)
        tensions_n = np.array(freed_n)
        if not moving and (self.breathing.known or not self._settings.await_breath):
            self.tares.add(freed_n)
        found = self.model.find(tensions_n, stamp_ns, self._settings.contact_threshold)
        if self.tares.automatic and not moving and not self.tares.refusal():
            tare = self.take_tare(stamp_ns, EventKind.AUTO_TARE)
            return Answer(force=ForceState.UNTARED, new_tare=tare)
        if found is None:
            return Answer(force=ForceState.UNTARED)
        probabilities, contacts, estimate, *_ = found
        doubt = "" if moving else self._doubt(tensions_n, found, stamp_ns)
        self.gate.estimated(known=True)
        force = ForceState.FREE
        if contacts:
            self.tares.touched(contacts[0])
            self.largest_force_n = max(self.largest_force_n, contacts[0].magnitude_n)
            force = ForceState.CONTACT if contacts[0].magnitude_n else ForceState.MOMENT
            if doubt:
                force = ForceState.UNCONFIRMED
        elif (
            estimate is not None
            and estimate.place is None  # near joint 1 any force is hidden, and the place says so
            and estimate.high_n > self._settings.hidden_above_n
        ):
            force = ForceState.HIDDEN
        return Answer(force, contacts, estimate, self._contact_m, probabilities)

    def _doubt(self, tensions_n: Array, found: FoundContacts, stamp_ns: int) -> str:
        """Watch an arm at rest for drift, and require that its readings fit the contacts.

        Gives the reason why they are doubted nevertheless; empty where they are not.
        """
        check, unloaded_n = self.plausibility, self.tares.unloaded_n
        assert unloaded_n is not None  # or there would be no estimate
        difference_n = tensions_n - unloaded_n
        self.drift.add(difference_n, stamp_ns, touched=bool(found.contacts))
        stated_doubt = found.doubt
        if self.gate.settling and found.misfit is not None and len(found.contacts) > 1:
            stated_doubt = "a second contact may be the motion of the arm"
        if check.unchecked or self.breathing.known:
            return stated_doubt
        before_ns = check.state.withheld_until_ns
        try:
            check.check(
                difference_n,
                self.gate.pose_rad,
                found.contacts,
                stamp_ns,
                found.misfit,
                stated_doubt,
                settling=self.gate.settling,
            )
        finally:
            if check.state.withheld_until_ns != before_ns:
                self._events.note(EventKind.MISFIT)
        return check.doubt

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
            CableSenseError: the message breaks the contract, or the arm has no static equilibrium
                at this command; the previous command stays in force.
        """
        command = joint_command_rad(message, self._joint_order, self.gate.command_rad)
        turn = None if self.model.in_motion else breath_turn(message)
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
        offsets_m, turn = cable_offsets_m(message, self._cable_order), breath_turn(message)
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
        self._events.note(EventKind.BREATH)
        if self._breath_rad is not None:
            self._go_to(self._breath_rad)
        return True

    def take_tare(
        self, now_ns: int, how: EventKind = EventKind.TARE, *, forced: bool = False
    ) -> Tare:
        """Take the latest readings as the unloaded state, at `now_ns` since the epoch.

        Raises:
            TareError: too few readings yet, they are not steady, or, unless `forced`, they do not
                seem to be those of the unloaded arm.
        """
        by_itself = how is EventKind.AUTO_TARE
        angles = self.gate.angles_rad
        tare = self.tares.take(angles, now_ns, by_itself=by_itself, forced=forced)
        self._tared(how)
        return tare

    def undo_tare(self) -> Tare | None:
        """Return to the previous tare and give it; None when the last was the first.

        Raises:
            TareError: there is nothing to undo.
        """
        earlier = self.tares.undo()
        self._tared(EventKind.TARE_UNDO)
        return earlier

    def adjust(self, contact_threshold: float, stale_after_s: float, slack_below_n: float) -> None:
        """Take over the settings that may change while running."""
        values = (contact_threshold, stale_after_s, slack_below_n)
        update = dict(zip(LIVE_SETTINGS, values, strict=True))
        self._settings = self._settings.model_copy(update=update)
        self.clock.stale_after_s = self.publisher.stale_after_s = stale_after_s
        self.check.slack_below_n = slack_below_n
        self._events.note(EventKind.SETTINGS)

    def start(self, now_s: float) -> None:
        """Samples begin, or begin again, now; earlier ones do not count any more."""
        self.publisher = FollowedPublisher(self.clock.stale_after_s)
        self.health = InputHealth(self.clock, self.publisher, now_s)
        self.tares.forget_readings()
        self.model.restart(self.gate.command_rad)
        self._events.note(EventKind.START, self.gate.command_rad)

    def restore(self, state: EstimatorState) -> None:
        """Answer from the next sample on as the object that made the state did.

        With another arm than that object's, unloaded tensions follow from the tare and this arm.

        Raises:
            CableSenseError: the state is of an arm with other joints or cables, or of a pose that
                this arm cannot take.
        """
        state.require_fitting(self._arm)
        same_arm = state.arm == self._arm.identity
        self.tares.restore(state.tare, state.gate.pose_rad, same_arm=same_arm)
        self.gate.restore(state.gate)
        self.plausibility.state = state.misfit.model_copy()
        self.breathing.state = state.breath.model_copy()
        self.command_received = state.command_received
        self._angles_rad = self.gate.angles_rad
        self.drift.tared()
        self._repeat(state.events, state.gate.command_rad)
        self._events = EventLog()

    @property
    def at_pose(self) -> ContactStatics:
        """Contacts in base axes and at the joints, at the pose of the last estimate."""
        return self._statics.at(self.gate.pose_rad)

    def _go_to(self, command_rad: Array) -> bool:
        """As `command`, with angles (2N,)."""
        dropped = False
        if np.array_equal(command_rad, self.gate.command_rad):
            tare = self.tares.present
            if tare is not None and tare.by_itself and not self.command_received:
                self._events.note(EventKind.POSE_CONFIRMED, command_rad)
        else:
            if not self.gate.follows(command_rad):
                dropped = self.tares.command(command_rad, first=not self.command_received)
                if dropped:
                    self.drift.tared()
                self.breathing.moved()
            self.gate.command(command_rad)
            self.model.command(command_rad)
            self._events.note(EventKind.COMMAND, command_rad)
        self.command_received = True
        return dropped

    def _mark(self, turn: int, message: Any, *, lasting: bool = False) -> None:
        stamp = message.header.stamp
        stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        if not (stamp_ns or lasting):
            raise ContractError("header.stamp is 0; a breath's messages state their times")
        if self.breathing.mark(turn, max(stamp_ns, 1), lasting=lasting):
            self._events.note(EventKind.BREATH)

    def _tared(self, how: EventKind) -> None:
        self.model.tared()
        self.drift.tared()
        self._events.note(how)

    def _repeat(self, events: Sequence[Event], command_rad: Array) -> None:
        """Bring the model to where the events brought it when the state was made."""
        model = self.model
        if model.in_motion and not self.reproducible:
            model.restart(command_rad)
        for event in events:
            if event.kind is EventKind.START and event.command_rad:
                model.restart(np.array(event.command_rad))
            elif event.kind is EventKind.COMMAND:
                model.command(np.array(event.command_rad))
            elif event.kind in _TARE_EVENTS:
                model.tared()
            self.reproducible |= event.kind is EventKind.START

    def _changed_state(self, stamp_ns: int) -> EstimatorState:
        return EstimatorState(
            before_ns=stamp_ns,
            events=self._events.taken(),
            arm=self._arm.identity,
            settings=self._settings,
            origin=self._origin,
            command_received=self.command_received,
            gate=self.gate.snapshot(),
            tare=self.tares.state.model_copy(),
            misfit=self.plausibility.state.model_copy(),
            breath=self.breathing.state.model_copy(),
        )
