"""The road of a sample, from its bytes to what is stated of contacts: the estimator without ROS.

    state, answer = estimator.answer(state, sample)

The message is read, and its stamp and readings are checked; the arm is moving or at a pose;
friction is taken out where the arm breathes; contacts are found by what is known of the arm; what
is stated of them is an `Answer`. All that one sample leaves for the next is in the state, which is
a value: the same state and sample give the same answer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import Calibration
from cablesense_contact.felt import FeltMachine
from cablesense_msgs_py.messages import (
    BREATH_END,
    ForceState,
    NamedOrder,
    breath_turn,
    cable_offsets_m,
    joint_command_rad,
)
from cablesense_msgs_py.serialized import EffortReader, Efforts
from cablesense_msgs_py.topics import ContractError
from cablesense_online.answer import Answer
from cablesense_online.asked_together import AskedTogether
from cablesense_online.breath_readings import BreathState, Mark, after_reading
from cablesense_online.calibrated_arm import CalibratedArm, CalibratedState
from cablesense_online.contacts import ContactFinder, FoundContacts, Situation
from cablesense_online.motion import CommandedMotion, MotionGate
from cablesense_online.samples import ProblemKind, ReadingLimits, SampleError, Stamps, slack_cables
from cablesense_online.settings import EstimationSettings
from cablesense_online.tare import TareError, UnloadedState, refusal, with_reading
from cablesense_online.transients import RecentTorques, with_torque

_REFUSED = {ProblemKind.CLOCK: ForceState.STALE, ProblemKind.MISFIT: ForceState.IMPLAUSIBLE}
_ASSUMED_POSE_RAD = 0.01
"""A first command within this of the assumed pose confirms it: joints' zeros are as far off."""
_TRANSIENT = "the force has just changed: the arm may swing"


@dataclass(frozen=True)
class Sample:
    """One sample as it came.

    Attributes:
        raw: a serialized `JointState` of tensions.
        now_ns: when, by the clock that sets the stamps.
        now_s: when, by the monotonic clock.
    """

    raw: bytes
    now_ns: int
    now_s: float


class EstimationState(NamedTuple):
    """All that one sample, command or tare leaves for the next.

    Attributes:
        motion: the command in force, and whether the arm moves.
        unloaded: what is known of the unloaded arm: tares, or a calibration.
        stamps: of the samples so far.
        breath: what readings would be without friction.
        breath_rad: (2N,) where a breath has moved the arm, with joint commands; else None.
        torques: of the last contacts about the first joint.
        is_commanded: whether any joint command has come; until then the arm is assumed to be
            straight.
        tare_problem: why the last automatic tare was not taken; empty where it was.
    """

    motion: CommandedMotion
    unloaded: UnloadedState[Any]
    stamps: Stamps = Stamps()
    breath: BreathState = BreathState()
    breath_rad: Array | None = None
    torques: RecentTorques = RecentTorques()
    is_commanded: bool = False
    tare_problem: str = ""

    @property
    def anew(self) -> EstimationState:
        """The same with samples that begin again: earlier ones do not count any more."""
        return self._replace(
            unloaded=self.unloaded.without_readings, torques=RecentTorques(), tare_problem=""
        )

    @property
    def of_another_publisher(self) -> EstimationState:
        """The same before the first sample of another publisher."""
        return self._replace(
            motion=self.motion.waiting_anew,
            breath=self.breath.moved,
            unloaded=self.unloaded.without_readings,
        )


class ContactEstimator:
    """Answers samples of one arm; gives no force from what cannot be trusted.

    Attributes:
        settings: in force.
        contacts: finds contacts by what is known of the arm.
        gate: says whether the arm moves.
    """

    def __init__(
        self, machine: FeltMachine, contacts: ContactFinder, settings: EstimationSettings
    ) -> None:
        self.settings = settings
        self.contacts = contacts
        self.gate = MotionGate(settings, machine.per_radian)
        self._machine = machine
        self._reader = EffortReader()
        self._cable_order = NamedOrder(
            machine.channels.names, "cables", among_others=machine.reads_joints
        )
        self._joint_order = NamedOrder(machine.command_names, "joints")
        self._limits = ReadingLimits(machine.channels)
        self._units = machine.channels.units
        self._joint_m = machine.joint_m
        self._contact_m = machine.contact_m
        self._settle_ns = settings.settle_ns

    def adjusted(self, settings: EstimationSettings) -> ContactEstimator:
        """The same with settings of which only those that may change while running differ."""
        contacts = self.contacts.with_threshold(settings.contact_threshold)
        return ContactEstimator(self._machine, contacts, settings)

    def begin(self, calibration: Calibration | None = None) -> EstimationState:
        """The state before any sample: straight, at rest, as well known as a calibration says.

        Raises:
            TareError: a calibration is given with a network, which takes none.
        """
        unloaded = self.contacts.unloaded.begin(calibration)
        return EstimationState(self.gate.at_rest(self._machine.first_command), unloaded)

    def answers(
        self, state: EstimationState, samples: Sequence[Sample]
    ) -> Iterator[tuple[EstimationState, Answer]]:
        """The answers to samples that came together, in turn, each with the state after it.

        They are those of `answer`, in less time.
        """
        asked = self._asked_together(state, samples) if len(samples) > 1 else ()
        for sample in samples:
            state, answer = self.answer(state, sample, asked)
            yield state, answer

    def _asked_together(
        self, state: EstimationState, samples: Sequence[Sample]
    ) -> tuple[AskedTogether, ...]:
        """What contacts are asked for by the samples, where the arm rests and does not breathe."""
        motion = state.motion
        breath = state.breath
        if motion.shut or self.gate.unrest(motion) or breath.breathing or breath.known:
            return ()
        readings_n = []
        stamps_ns = []
        for sample in samples:
            try:
                message = self._reader.read(sample.raw)
                readings_n.append(self._checked(message))
            except CableSenseError:
                continue  # it is refused in its turn
            stamps_ns.append(message.stamp_ns or sample.now_ns)
        if not readings_n:
            return ()
        situation = Situation(motion.pose_rad, stamps_ns[0])
        try:
            return self.contacts.asked_together(state.unloaded, np.array(readings_n), situation)
        except CableSenseError:
            return ()  # one of them cannot be weighed, and is refused in its turn

    def _checked(self, message: Efforts) -> Sequence[float]:
        """(M,) the readings in a message, in the order of the channels.

        Raises:
            CableSenseError: a name or a value is not as it must be.
        """
        readings_n = self._cable_order.pick(message.names, message.values, "effort")
        self._limits.check(readings_n)
        return readings_n

    def answer(
        self, state: EstimationState, sample: Sample, asked: Sequence[AskedTogether] = ()
    ) -> tuple[EstimationState, Answer]:
        """The answer to one sample, and the state after it.

        `asked` is what the law was asked already, of samples that came together.
        """
        try:
            message = self._reader.read(sample.raw)
        except CableSenseError as error:
            return state, refused(_as_problem(error, ProblemKind.MALFORMED))
        try:
            stale_after_s = self.settings.stale_after_s
            stamps = state.stamps.accepted(message.stamp_ns, sample.now_ns, stale_after_s)
        except SampleError as problem:
            return state, refused(problem)
        stamp_ns = message.stamp_ns or sample.now_ns
        state = self._moved(state, stamps, stamp_ns, sample)
        try:
            readings_n = self._checked(message)
        except CableSenseError as error:
            return state, refused(_as_problem(error, ProblemKind.NAMES), stamp_ns)
        slack = slack_cables(readings_n, self._units, self.settings.slack_below_n)
        if state.motion.shut:
            state = state._replace(torques=RecentTorques())
            return state, Answer(force=ForceState.MOVING, stamp_ns=stamp_ns, slack_cables=slack)
        state, answer = self._answered(state, readings_n, stamp_ns, asked)
        return state, replace(answer, slack_cables=slack)

    def _moved(
        self, state: EstimationState, stamps: Stamps, stamp_ns: int, sample: Sample
    ) -> EstimationState:
        """The state where the arm is at the sample's stamp."""
        motion = self.gate.at_sample(state.motion, stamp_ns, sample.now_ns, sample.now_s)
        unloaded = state.unloaded
        if not motion.shut:
            unloaded = self.contacts.unloaded.at(unloaded, motion.pose_rad)
        turning = not motion.shut and self.gate.turning(motion)
        breath = state.breath.moved if motion.stepped or turning else state.breath
        return state._replace(stamps=stamps, motion=motion, unloaded=unloaded, breath=breath)

    def _answered(
        self,
        state: EstimationState,
        readings_n: Sequence[float],
        stamp_ns: int,
        asked: Sequence[AskedTogether],
    ) -> tuple[EstimationState, Answer]:
        """Find contacts in checked readings (M,), and say what can be stated of them."""
        breath, freed_n = after_reading(state.breath, readings_n, stamp_ns, self._settle_ns)
        state = state._replace(breath=breath)
        if freed_n is None:
            return state, Answer(force=ForceState.MOVING, stamp_ns=stamp_ns)
        if breath.known or not self.settings.await_breath:
            most = self.settings.tare_samples
            state = state._replace(unloaded=with_reading(state.unloaded, freed_n, most))
        channels = self._machine.channels
        if state.unloaded.automatic and not refusal(state.unloaded, self.settings, channels):
            return self._tared_by_itself(state, stamp_ns)
        motion = state.motion
        unrest = self.gate.unrest(motion)
        situation = Situation(motion.pose_rad, stamp_ns, unrest, breath.known)
        try:
            unloaded, finding = self.contacts.find(
                state.unloaded, np.array(freed_n), situation, asked
            )
        except CableSenseError as error:
            return state, refused(_as_problem(error, ProblemKind.ESTIMATE), stamp_ns)
        state = state._replace(unloaded=unloaded)
        if finding is None:
            return state, Answer(force=ForceState.UNTARED, stamp_ns=stamp_ns)
        state, force, doubt = self._stated(state, finding, stamp_ns)
        if force is ForceState.IMPLAUSIBLE:
            if self.gate.settling(motion):
                return state, Answer(force=ForceState.MOVING, stamp_ns=stamp_ns)
            problem = SampleError(ProblemKind.MISFIT, f"readings fit no contact: {doubt}")
            return state, refused(problem, stamp_ns)
        return state, Answer(
            force=force,
            contacts=finding.contacts,
            estimate=finding.estimate,
            contact_m=self._contact_m,
            probabilities=finding.probabilities,
            stamp_ns=stamp_ns,
            doubt=doubt,
            pose_rad=motion.pose_rad if finding.pose_rad is None else finding.pose_rad,
        )

    def _tared_by_itself(
        self, state: EstimationState, stamp_ns: int
    ) -> tuple[EstimationState, Answer]:
        """With the automatic tare, unless the readings are not those of an untouched arm."""
        untared = Answer(force=ForceState.UNTARED, stamp_ns=stamp_ns)
        try:
            unloaded = self.contacts.unloaded.taken(state.unloaded, stamp_ns, by_itself=True)
        except TareError as error:
            unloaded = state.unloaded.without_readings
            return state._replace(unloaded=unloaded, tare_problem=str(error)), untared
        tared = state._replace(unloaded=unloaded, tare_problem="")
        return tared, replace(untared, new_tare=unloaded.tares[-1])

    def _stated(
        self, state: EstimationState, finding: FoundContacts, stamp_ns: int
    ) -> tuple[EstimationState, ForceState, str]:
        """What is stated of the contacts, and why they are doubted."""
        estimate = finding.estimate
        if estimate is None or estimate.place is None:
            return state, finding.force, finding.doubt
        segment = 1 + int(np.argmax(estimate.probabilities[1:]))
        lever_m = float(self._joint_m[segment - 1]) + estimate.place.place_m
        torques, has_changed = with_torque(state.torques, estimate, lever_m, stamp_ns)
        state = state._replace(torques=torques)
        is_vouched_for = finding.force in (ForceState.CONTACT, ForceState.MOMENT)
        if has_changed and is_vouched_for:
            return state, ForceState.UNCONFIRMED, _TRANSIENT
        if has_changed and finding.force is ForceState.IMPLAUSIBLE:
            return state, ForceState.UNCONFIRMED, f"{_TRANSIENT}; or {finding.doubt}"
        return state, finding.force, finding.doubt

    def commanded(self, state: EstimationState, message: Any) -> EstimationState:
        """The state after a `JointState` of commanded angles.

        A tare that was taken by itself is dropped where the first command shows that the arm was
        not where it was assumed to be.

        Raises:
            CableSenseError: the message breaks the contract; the previous command stays in force.
        """
        command_rad = joint_command_rad(
            message, self._joint_order, state.motion.command_rad, self._machine.largest_command
        )
        turn = breath_turn(message)
        if turn is None:
            return self.sent_to(state, command_rad)
        breath_rad = None if turn == BREATH_END else command_rad
        marked = state.breath.marked(_mark(turn, message))
        return state._replace(breath=marked, breath_rad=breath_rad)

    def sent_to(self, state: EstimationState, command_rad: Array) -> EstimationState:
        """The state after a command (2N,)."""
        motion = state.motion
        if np.array_equal(command_rad, motion.command_rad):
            return state._replace(is_commanded=True)
        unloaded = state.unloaded
        breath = state.breath
        if not self.gate.follows(motion, command_rad):
            off_rad = float(np.abs(command_rad - motion.command_rad).max())
            if not state.is_commanded and off_rad > _ASSUMED_POSE_RAD * self._machine.per_radian:
                unloaded = self._without_own_tare(unloaded)
            unloaded = unloaded.without_readings
            breath = breath.moved
        return state._replace(
            motion=self.gate.commanded(motion, command_rad),
            unloaded=unloaded,
            breath=breath,
            is_commanded=True,
        )

    def offset(self, state: EstimationState, message: Any) -> EstimationState:
        """The state after a `JointState` of lengths that are added to the cables' commanded ones.

        Those of a breath's whole turns average out; while others last, there is no estimate.

        Raises:
            ContractError: the message breaks the contract.
        """
        offsets_m = cable_offsets_m(message, self._cable_order)
        turn = breath_turn(message)
        breath = state.breath
        if turn is not None:
            breath = breath.marked(_mark(turn, message))
        elif offsets_m.any() or breath.breathing:
            turn = 0 if offsets_m.any() else BREATH_END
            breath = breath.marked(_mark(turn, message, unstamped=True))
        return state._replace(breath=breath)

    def without_breather(self, state: EstimationState, problem: str) -> EstimationState:
        """The state after the breather has gone in mid-breath; its last command counts."""
        state = state._replace(breath=state.breath.given_up(problem))
        return state if state.breath_rad is None else self.sent_to(state, state.breath_rad)

    def tared(self, state: EstimationState, now_ns: int, *, forced: bool) -> EstimationState:
        """With the latest readings as the unloaded state, at `now_ns` since the epoch.

        Raises:
            TareError: too few readings yet, they are not steady, or, unless `forced`, they are not
                those of the untouched arm.
        """
        unloaded = self.contacts.unloaded.taken(state.unloaded, now_ns, forced=forced)
        return state._replace(unloaded=unloaded, tare_problem="")

    def tare_undone(self, state: EstimationState, now_ns: int) -> EstimationState:
        """The state before the last tare; without any, one of the latest readings takes its place.

        So a force is known after it as before. `now_ns` is the time since the epoch.

        Raises:
            TareError: there is nothing to undo, or the last readings are no tare in its place.
        """
        arm = self.contacts.unloaded
        undone: UnloadedState[Any] = arm.undone(state.unloaded)
        if state.unloaded.known and not undone.known:
            try:
                undone = arm.taken(undone, now_ns)
            except TareError as problem:
                raise TareError(
                    "the tare in force is the only one, and is kept, as without it no force is "
                    f"known; another in its place was refused: {problem}"
                ) from None
        return state._replace(unloaded=undone)

    def with_calibration(
        self, state: EstimationState, calibration: Calibration
    ) -> EstimationState:
        """With another calibration.

        Raises:
            TareError: the model is a network, which takes none.
        """
        arm, unloaded = self._calibrated(state)
        return state._replace(unloaded=arm.loaded(unloaded, calibration))

    def restored(
        self, state: EstimationState, calibration: Calibration, command_rad: Array, *, known: bool
    ) -> EstimationState:
        """As a recorded estimator from the moment that it used a calibration.

        Raises:
            TareError: the model is a network, which takes none.
        """
        arm, unloaded = self._calibrated(state)
        motion = state.motion if state.is_commanded else self.gate.at_rest(command_rad)
        restored = arm.restored(unloaded, calibration, known=known)
        return state._replace(motion=motion, unloaded=restored)

    def _calibrated(self, state: EstimationState) -> tuple[CalibratedArm, CalibratedState]:
        arm = self.contacts.unloaded
        unloaded = state.unloaded
        if not (isinstance(arm, CalibratedArm) and isinstance(unloaded, CalibratedState)):
            raise TareError("this model takes tension differences; a calibration needs a law")
        return arm, unloaded

    def _without_own_tare(self, unloaded: UnloadedState[Any]) -> UnloadedState[Any]:
        """Without the last tare if it was taken by itself; another one is then awaited."""
        if not (unloaded.tares and unloaded.tares[-1].by_itself):
            return unloaded
        undone: UnloadedState[Any] = self.contacts.unloaded.undone(unloaded)
        return replace(undone, automatic=True)


def refused(problem: SampleError, stamp_ns: int = 0) -> Answer:
    """The answer to a sample that cannot be used."""
    force = _REFUSED.get(problem.kind, ForceState.REFUSED)
    return Answer(force=force, problem=problem, stamp_ns=stamp_ns)


def _as_problem(error: CableSenseError, kind: ProblemKind) -> SampleError:
    return error if isinstance(error, SampleError) else SampleError(kind, str(error))


def _mark(turn: int, message: Any, *, unstamped: bool = False) -> Mark:
    """The mark in a breath's message; only `unstamped` ones need no stamp."""
    stamp = message.header.stamp
    stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
    if not (stamp_ns or unstamped):
        raise ContractError("header.stamp is 0; a breath's messages state their times")
    return Mark(turn, max(stamp_ns, 1))
