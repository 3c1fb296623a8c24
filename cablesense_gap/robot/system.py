"""A robot as a `System`: its diagnosis, and what a model predicts of a recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_gap.diagnosis.discrepancy import Conditions, ConditionUnits
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.earlier import judged
from cablesense_gap.kept_simulations import KeptSimulations
from cablesense_gap.pipeline import diagnose_system
from cablesense_gap.reference import Reference
from cablesense_gap.robot import doubts, friction_forms, loads
from cablesense_gap.robot.amending import changed, known_robot_effects
from cablesense_gap.robot.effects import RobotEffect
from cablesense_gap.robot.efforts import effort_interpretations, looks_reversed
from cablesense_gap.robot.forward import ForwardComparison
from cablesense_gap.robot.inverse import InverseComparison, ServoComparison
from cablesense_gap.robot.model import OF_POSITION, Robot, RobotError
from cablesense_gap.robot.motion import Motion, MotionComparison
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.protocol import next_experiment
from cablesense_gap.robot.recording import RobotRecording
from cablesense_gap.robot.signs import is_reversed
from cablesense_gap.simulator import Assignment, Candidate, Term, parameters_of
from cablesense_gap.system import FOLDS, Altered, System, Unlisted, problem_of
from cablesense_gap.verdict import (
    ChannelGap,
    Earlier,
    FittedNumber,
    FrictionForm,
    Gap,
    Verdict,
    Where,
)
from cablesense_recording.csv_file import write_table
from cablesense_recording.recording import RecordingError
from cablesense_recording.robot_recording import TrialLabel

UNIT = "floors"
"""Each channel is given in units of its floor."""
_JUDGED_SHARE = 0.1
"""A channel is judged if at least this share of the model's torque is left beyond an offset and
friction."""
_FOLLOWING_CORRELATION = 0.8
"""Least correlation of a channel with the model's for its unit to be judged."""
_OTHER_UNIT_RATIO = 5.0
"""Ratio of a channel and the model's from which on its unit is doubtful."""
_NO_TORQUE_SHARE = 0.01
"""Share of the largest torque at a joint of the model below which a joint has none to compare."""
_PROBED_ZERO = 0.01
"""Error of a zero by which its influence is found, rad or m."""
_USUAL_ZERO = 0.1
"""Error of a zero that is usual in a trial, rad or m."""

_FITTING_FLOORS = 2.0
"""Floors that a hypothesis leaves at most at a joint where the model is exact."""
_MODEL_ERROR_SHARE = 0.1
"""Share of the torque that models of real machines leave: the middle of the usual 5 to 15 %."""

_Zeros = tuple[NDArray[np.bool_], Array, Array]


class RobotSystem(System):
    """A robot with its motion as it was measured; all rows count.

    Channels are in units of their floors.

    Attributes:
        robot: the nominal one.
        listed: effects that the nominal robot has.
        motion: as it was measured.
        comparison: the channels in rad, N·m and so on; `readings` are in units of their noise.
    """

    unit = UNIT
    floor = 1.0
    far_off = 3.0
    """A robot has dozens of tolerances."""

    def __init__(
        self,
        robot: Robot,
        motion: Motion,
        listed: Assignment,
        recording_name: str = "",
        recorded_row_count: int | None = None,
    ) -> None:
        """`motion` is the measured one, `listed` are effects that the nominal robot has.

        `recorded_row_count` is that of the whole recording, by default of the rows compared.
        """
        self.robot = robot
        self.name = robot.name
        self.recording_name = recording_name
        self.listed = dict(listed)
        self.motion = motion
        self.comparison = _comparison_of(robot, motion)
        by_servos = motion.external or (motion.forward and motion.by_command)
        offered = [
            effect
            for effect in known_robot_effects().values()
            if not (motion.zeroed and effect.of_zeros)
            and not (motion.external and effect.of_torques)
            and (by_servos or not effect.of_servos)
        ]
        named = [self._candidate(e, motion) for e in offered if not e.tolerance]
        signed = (part for each in named for part in loads.with_sign(each, self.listed))
        self.candidates = tuple(candidate for candidate in signed if candidate.places)
        fitted = [self._candidate(e, motion) for e in offered if e.tolerance]
        self.tolerances = tuple(candidate for candidate in fitted if candidate.places)
        self.readings = self.comparison.readings / self.comparison.noise
        self.scale = self.comparison.noise
        self.trial = self.comparison.trial
        self.compared = self.comparison.description
        self.recorded_row_count = recorded_row_count or len(self.trial)
        trial_count = int(self.trial.max()) + 1
        self.fold = np.arange(trial_count) % min(FOLDS, trial_count)
        self.counted = np.ones(len(self.trial), dtype=bool)
        self._zeros: tuple[_Zeros, ...] = ()
        if motion.zeroed:
            self._zeros = self._of_zeros()

    def _candidate(self, effect: RobotEffect, motion: Motion) -> Candidate:
        """An effect with its places and numbers.

        Forward in time most friction is MuJoCo's, which gives no way.
        """
        parameters = effect.parameters(self.robot, motion.scale)
        if motion.forward and not effect.presliding_forward:
            parameters = tuple(p for p in parameters if p.role == "size")
        richer = () if motion.forward else effect.richer(self.robot, motion.scale)
        return Candidate(
            effect.name,
            _places(effect, self.robot, motion),
            parameters,
            against_motion=effect.against_motion,
            richer=richer,
        )

    def borne(self, problem: Problem, without_effects: Hypothesis) -> Hypothesis | None:
        """A payload of the body where it leaves least, if that is clear."""
        return loads.borne(problem, self.candidates, without_effects)

    def numbers(
        self, hypothesis: Hypothesis, values: Mapping[Term, float]
    ) -> dict[str, FittedNumber]:
        """The values, and the places of payloads."""
        fitted = super().numbers(hypothesis, values)
        return loads.with_places(fitted, hypothesis, self.candidates)

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, Q, C) of P variants, in floors."""
        return np.array([self._predicted(variant) for variant in variants])

    def _predicted(self, variant: Assignment) -> Array:
        try:
            change = changed(self.robot, [self.listed, variant])
            predicted = self.comparison.predicted(change) / self.comparison.noise
        except RobotError:
            return np.full(self.readings.shape, np.nan)
        for rows, by_zeros, fitting in self._zeros:
            zeros = fitting @ (self.readings - predicted)[rows].ravel()
            predicted[rows] += (by_zeros @ zeros).reshape(-1, predicted.shape[1])
        return predicted

    @cached_property
    def nominal(self) -> Array:
        """(Q, C) channels in their own units, as the nominal robot has them."""
        return np.asarray(self.predict([{}])[0] * self.comparison.noise)

    def gaps(self) -> list[tuple[str, str, float, float]]:
        """Name, unit, RMS of measured less `nominal`, and RMS of measured, of each channel."""
        compared = self.comparison
        gap_and_readings = compared.readings - self.nominal, compared.readings
        sizes = [np.sqrt((each**2).mean(0)).tolist() for each in gap_and_readings]
        return list(zip(compared.names, compared.units, *sizes, strict=True))

    def _of_zeros(self) -> tuple[_Zeros, ...]:
        """By trial its rows, what zeros (J,) make of them, and the zeros that fit a residual."""
        trial = self.comparison.trial
        joints = self.robot.joints

        def read(joint: int, off: float) -> Array:
            change = changed(self.robot, [self.listed])
            change.zero[joint] += off
            return self.comparison.predicted(change) / self.comparison.noise

        ends = [
            [read(k, off) for k in range(len(joints))] for off in (_PROBED_ZERO, -_PROBED_ZERO)
        ]
        by_zero = (np.array(ends[0]) - np.array(ends[1])) / (2.0 * _PROBED_ZERO)
        zeros_by_trial: list[_Zeros] = []
        for rows in (trial == number for number in np.unique(trial)):
            trial_columns = by_zero[:, rows].reshape(len(joints), -1).T
            known = trial_columns.T @ trial_columns + np.eye(len(joints)) / _USUAL_ZERO**2
            zeros_by_trial.append(
                (rows, trial_columns, np.asarray(np.linalg.solve(known, trial_columns.T)))
            )
        return tuple(zeros_by_trial)

    def with_listed(self, values: Assignment) -> RobotSystem:
        """The same robot with these values added to those that it lists, and known gains."""
        known = replace(self.motion, unknown_gain=np.zeros(len(self.robot.joints), dtype=bool))
        listed = added(self.listed, values)
        return RobotSystem(self.robot, known, listed, self.recording_name, self.recorded_row_count)

    def conditions(self) -> Conditions:
        """Those of the channels' joints, with the nominal robot's load."""
        return self._conditions

    @cached_property
    def _conditions(self) -> Conditions:
        return self.comparison.conditions(changed(self.robot, [self.listed]))

    def condition_units(self) -> list[ConditionUnits]:
        """Of each channel's joint; loads are in the channel's unit where it is no position."""
        joint_names = [name.rpartition(".")[2] for name in self.comparison.names]
        joint_indices = [self.robot.joints.index(name) for name in joint_names]
        load_units = self.comparison.units
        if self.motion.external:
            load_units = tuple(self.robot.torque_units[j] for j in joint_indices)
        return [
            ConditionUnits(name, position, f"{position}/s", load, f"{position}/s²")
            for name, j, load in zip(self.comparison.names, joint_indices, load_units, strict=True)
            for position in (self.robot.position_units[j],)
        ]

    def compared_columns(self, column: Array) -> Array:
        """A function (R, C) of the conditions as the comparison takes it, (Q, C) in floors."""
        return self.comparison.compared(column)

    def altered(self, variant: Assignment) -> Altered | None:
        """Zeros and encoder scales move an unmodelled torque, torque scales multiply it."""
        comparison = self.comparison
        usual = self._conditions
        if not isinstance(comparison, InverseComparison):
            return None
        change, nominal_change = (changed(self.robot, [self.listed, v]) for v in (variant, {}))
        gain = comparison.of_channels(
            (1.0 + change.torque_scale) / (1.0 + nominal_change.torque_scale)
        )
        if change.key(*OF_POSITION) != nominal_change.key(*OF_POSITION):
            moved_pairs = zip(
                comparison.moved(change), comparison.moved(nominal_change), strict=True
            )
            position, speed = (altered - nominal for altered, nominal in moved_pairs)
            usual = usual._replace(position=usual.position + position, speed=usual.speed + speed)
        elif (gain == 1.0).all():
            return None
        return Altered(usual, gain)

    def model_error(self, problem: Problem, found: Sequence[Hypothesis]) -> Array | None:
        """A tenth of the torque, if the best hypothesis is far from every joint's floor."""
        best = min(found, key=lambda each: each.held_out_rmse)
        residual_rms = np.sqrt(((problem.readings - best.held_out) ** 2).mean(0))
        if (
            not isinstance(self.comparison, InverseComparison)
            or residual_rms.min() < _FITTING_FLOORS
        ):
            return None
        return np.asarray(_MODEL_ERROR_SHARE * np.sqrt((self.readings**2).mean(0)))

    def completed(self, problem: Problem, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """With richer forms of friction; far tolerances, implausible sizes and places count."""
        richer = friction_forms.enriched(problem, found)
        whole = friction_forms.with_imitators(problem, richer)
        return [doubts.weighed(problem, each) for each in whole]

    def forms(self, problem: Problem, hypothesis: Hypothesis) -> dict[str, FrictionForm]:
        """Those of the joints with most friction."""
        return friction_forms.forms(problem, hypothesis)

    def where(self, values: Mapping[Term, float], residual: Array) -> Where:
        """Joints, bodies and tendons of the effects; of a coupling the joint of its drive."""
        places = {term.place.split("_into_")[0] for term in values}
        return Where(
            joints=tuple(joint for joint in self.robot.joints if joint in places),
            bodies=tuple(body for body in self.robot.bodies if body in places),
            tendons=tuple(tendon for tendon in self.robot.tendons if tendon in places),
        )

    def next_experiment(self, rivals: Sequence[Assignment], question: str) -> str:
        """The block of the robot's protocol that shows how the rivals differ, as text."""
        text = next_experiment(self.robot, rivals, self.motion.floor)
        return f"To find out {question}: {text}" if text and question else text

    def unlisted(self, problem: Problem, residual: Array) -> Unlisted:
        """The channel and the trial with the largest residual."""
        residual_rms = np.sqrt((residual**2).mean(0))
        worst = int(residual_rms.argmax())
        by_trial = np.bincount(self.trial, (residual**2).mean(1))
        size = np.sqrt(by_trial / np.bincount(self.trial))
        most = f"Most is left at {self.comparison.names[worst]}: {residual_rms[worst]:.3g} floors."
        label = self.comparison.trial_labels[int(size.argmax())]
        again = (
            f"Repeat trial {label}, which has the largest residual ({size.max():.3g} "
            "floors), then at half the speed and with one joint at a time. A residual that "
            "depends on position is a spring, a stop or a ripple. One that depends on the "
            "direction is friction, and one that grows with time is heat or drift."
        )
        return Unlisted((most,), again, 0.0)

    def doubts(self, values: Mapping[Term, float], gap: Gap) -> tuple[str, ...]:
        """Numbers that end at their bounds or far beyond the model's own; a gap that stays."""
        change = changed(self.robot, [self.listed, values])
        ranges = parameters_of(self.candidates)
        inertia = self.motion.inertia
        return tuple(doubts.of_verdict(self.robot, change, inertia, ranges, values, gap))

    def channel_groupings(self) -> Sequence[NDArray[np.int64]]:
        """Position and speed of a joint have their causes together."""
        joints = [self.robot.joints.index(name.split(".")[-1]) for name in self.comparison.names]
        return (np.unique(joints, return_inverse=True)[1].astype(np.int64),)

    def trial_labels(self, parts: Sequence[int]) -> tuple[TrialLabel, ...]:
        """Those of the recording's files, in the order of its rows."""
        labels = self.comparison.trial_labels
        return tuple(dict.fromkeys(labels[part] for part in parts))

    def channels(self, before: Array, after: Array, floor: Array) -> dict[str, ChannelGap]:
        """The gap at each joint."""
        compared = self.comparison
        sizes = [np.sqrt((each**2).mean(0)) * compared.floor for each in (before, after)]
        columns = zip(compared.names, compared.units, *sizes, floor * compared.floor, strict=True)
        return {
            name: ChannelGap(unit=unit, before=float(b), after=float(a), floor=float(floor))
            for name, unit, b, a, floor in columns
        }

    def left_shares(self) -> dict[str, float]:
        """By channel, the nominal model's residual as a share of the measured values, RMS."""
        residual = self.readings - self.predict([{}])[0]
        size, whole = (np.linalg.norm(each, axis=0) for each in (residual, self.readings))
        shares = np.divide(size, whole, out=np.zeros_like(size), where=whole > 0.0)
        return dict(zip(self.comparison.names, shares.tolist(), strict=True))

    def reversed_channels(self) -> list[str]:
        """Channels that have the opposite sign of the model's.

        Offset and friction are fitted to both first: they may dominate a torque, and the model
        need not have them.
        """
        motion = self.motion
        predicted = self.predict([{}])[0]
        nuisances = np.ones_like(motion.speed), motion.speed, motion.direction
        of_joints = np.stack([motion.compared(each) for each in nuisances], axis=-1)
        accelerations = motion.compared(motion.acceleration)
        complaints = []
        for c, name in enumerate(self.comparison.names):
            joint = self.robot.joints.index(name)
            joint_nuisances = of_joints[:, joint]
            columns = np.column_stack(
                [self.readings[:, c], predicted[:, c], accelerations[:, joint]]
            )
            columns -= joint_nuisances @ np.linalg.lstsq(joint_nuisances, columns, rcond=None)[0]
            measured, modelled, acceleration = columns.T
            is_judged = np.linalg.norm(modelled) > _JUDGED_SHARE * np.linalg.norm(predicted[:, c])
            if is_judged and is_reversed(measured, modelled, acceleration):
                complaints.append(looks_reversed(self.comparison.columns[c]))
        return complaints

    def doubtful(self) -> list[str]:
        """Channels that follow the model's, but in another unit."""
        return [
            f"{column} is {ratio:.2g} times the model's value: check its unit."
            for column, ratio in self._ratios().items()
            if not 1.0 / _OTHER_UNIT_RATIO < ratio < _OTHER_UNIT_RATIO
        ]

    def _ratios(self) -> dict[str, float]:
        """By column, the size of a channel that follows the model's, by that of the model's.

        Without channels in which the model has about no torque: what it follows there is chance.
        """
        predicted = self.predict([{}])[0]
        measured, modelled = (np.linalg.norm(each, axis=0) for each in (self.readings, predicted))
        torque = np.linalg.norm(predicted * self.comparison.noise, axis=0)
        units = np.array(self.comparison.units)
        largest = np.array([torque[units == unit].max() for unit in units])
        ratios = {}
        for c in np.flatnonzero(measured * modelled * (torque >= _NO_TORQUE_SHARE * largest)):
            if (
                self.readings[:, c] @ predicted[:, c]
                > _FOLLOWING_CORRELATION * measured[c] * modelled[c]
            ):
                ratios[self.comparison.columns[c]] = float(measured[c] / modelled[c])
        return ratios


def _comparison_of(robot: Robot, motion: Motion) -> MotionComparison:
    """By the commands of servos, forward in time, or by the torques that a motion needs."""
    if motion.external:
        return ServoComparison(robot, motion)
    if motion.forward:
        return ForwardComparison(robot, motion)
    return InverseComparison(robot, motion)


def _places(effect: RobotEffect, robot: Robot, motion: Motion) -> tuple[str, ...]:
    """Where an effect can be: torque constants that are unknown are no cause of a gap."""
    places = effect.places(robot)
    unknown = {robot.joints[j] for j in np.flatnonzero(motion.unknown_gain)}
    if effect.of_currents:
        return tuple(place for place in places if place in unknown)
    if effect.of_gains and unknown:
        return tuple(place for place in robot.joints if place not in unknown)
    return places


@dataclass(frozen=True)
class RobotDiagnosis:
    """A verdict, and the channels behind it as measured and predicted.

    Attributes:
        system: the nominal robot, its motion and how it is compared.
        amended: effects of the verdict and tolerances, as fitted.
        before, after: (Q, C) predicted, in the channels' units; after by fits that have not seen
            the trial.
        notes: what was read and changed, and how it is compared, as sentences.
        warnings: what looks wrong with recording and model, as sentences.
        beside: effects of the nominal model that its JSON file lists.
    """

    system: RobotSystem
    verdict: Verdict
    amended: dict[Term, float]
    before: Array
    after: Array
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    beside: Assignment


def wrong_columns(
    recording: RobotRecording,
    robot: Robot,
    beside: Assignment = MappingProxyType({}),
    bandwidth_hz: float | None = None,
    zeroed: bool = False,
) -> list[str]:
    """Columns that look exchanged, reversed or of another unit to the nominal model, as sentences.

    The arguments are as of `diagnose`.

    Raises:
        RecordingError: the recording cannot be compared.
    """

    def by_torque(recorded: RobotRecording) -> RobotSystem:
        compared = prepared(recorded, robot, bandwidth_hz, forward=False, zeroed=zeroed)
        return RobotSystem(robot, compared, beside)

    if np.isfinite(recording.torque).any():
        compared = prepared(recording, robot, bandwidth_hz, forward=False, zeroed=zeroed)
        suspect = effort_interpretations(robot, compared, recording.stated_efforts).suspect
        if suspect:
            return list(suspect)
    exchanged = doubts.exchanged(recording, robot, lambda each: by_torque(each).left_shares())
    return exchanged or by_torque(recording).reversed_channels()


def diagnose(
    recording: RobotRecording,
    robot: Robot,
    beside: Assignment = MappingProxyType({}),
    bandwidth_hz: float | None = None,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
    forward: bool | None = None,
    *,
    zeroed: bool = False,
    external: bool = False,
    force: bool = False,
    reference: RobotRecording | None = None,
    announce: Callable[[float], None] = lambda _: None,
    kept: KeptSimulations | None = None,
) -> RobotDiagnosis:
    """Find what makes the recorded robot differ from its nominal model.

    `beside` are effects that an amended model lists in addition to its MJCF. How they are compared
    (`bandwidth_hz`, `forward`, `zeroed`, `external`) is as of `prepared`. `progress` receives the
    present step and the share of the whole that is done, `announce` the seconds that the search
    will take, before it begins; `workers` processes share it.
    With `force` it continues if columns look exchanged, reversed, wrapped or in another unit; the
    warnings then say so.
    A `reference` is of the same robot when it was healthy; the verdict says what changed since.
    From the files `kept` a diagnosis goes on that was interrupted.

    Raises:
        RecordingError: the recording or the reference cannot be compared, or columns look
            exchanged, wrapped or in another unit.
    """
    began_s = time.monotonic()
    progress("smoothing", 0.0)

    suspect = doubts.wrapped(recording, robot)
    _refuse(recording, [] if force else suspect)
    motion = prepared(recording, robot, bandwidth_hz, forward, zeroed=zeroed, external=external)

    system = RobotSystem(robot, motion, beside, recording.name, len(recording))
    if not external:
        suspect += wrong_columns(recording, robot, beside, bandwidth_hz, zeroed)
    _refuse(recording, [] if force else suspect)
    earlier = _judged_earlier(robot, motion, beside)
    healthy = None
    if reference is not None:
        progress("fitting the reference", 0.0)
        healthy = _healthy(reference, system)
        system = system.with_listed(healthy.known)
    diagnosis = diagnose_system(system, progress, workers, began_s, healthy, announce, kept)
    known = {} if healthy is None else healthy.known
    return RobotDiagnosis(
        system=system,
        verdict=diagnosis.verdict.model_copy(update={"earlier": earlier}),
        amended=added(added(diagnosis.values, diagnosis.tolerances), known),
        before=diagnosis.nominal * system.comparison.noise,
        after=diagnosis.held_out * system.comparison.noise,
        notes=(
            *recording.notes,
            *(() if motion.forward else robot.left_out),
            *doubts.servos_read(robot, motion),
            *_fitted_gains(robot, motion),
            system.compared,
        ),
        warnings=(
            *recording.warnings,
            *(f"{column[0].upper()}{column[1:]}." for column in suspect),
            *doubts.beyond_range(recording, robot),
            *(() if zeroed else doubts.starts_at_zero(recording)),
            *_doubtful_units(recording, system),
        ),
        beside=beside,
    )


def _doubtful_units(recording: RobotRecording, system: RobotSystem) -> Sequence[str]:
    """What is odd about the units of channels, as sentences."""
    motion = system.motion
    if motion.by_command or motion.external or motion.forward:
        return system.doubtful()
    return effort_interpretations(system.robot, motion, recording.stated_efforts).doubts


def _fitted_gains(robot: Robot, motion: Motion) -> Iterator[str]:
    """Torque constants that nobody stated and that are therefore fitted, as sentences."""
    for joint in np.flatnonzero(motion.unknown_gain).tolist():
        yield (
            f"1 A at {robot.joints[joint]} is taken for {motion.gain[joint]:.3g} "
            f"{robot.torque_units[joint]}, and how much more or less it is, is fitted."
        )


def _judged_earlier(robot: Robot, motion: Motion, beside: Assignment) -> tuple[Earlier, ...]:
    """What still stands of the effects that an amended model lists beside its MJCF.

    Numbers of an effect whose size is in the MJCF are left out: they say nothing alone.
    """
    tolerances = {t: v for t, v in beside.items() if known_robot_effects()[t.effect].tolerance}
    system = RobotSystem(robot, motion, tolerances)
    ranges = parameters_of(system.candidates)
    sized = {t[:2] for t in beside if t in ranges and ranges[t].role == "size"}
    listed = {t: value for t, value in beside.items() if t in ranges and t[:2] in sized}
    return judged(problem_of(system), listed)[1] if listed else ()


def _refuse(recording: RobotRecording, suspect: Sequence[str]) -> None:
    """Raise if anything is suspect.

    Raises:
        RecordingError: names it.
    """
    if suspect:
        raise RecordingError(
            f"{recording.name}: {', '.join(suspect)}: correct the recording, or continue with "
            "--force"
        )


def _healthy(reference: RobotRecording, system: RobotSystem) -> Reference:
    """The reference, compared as the recording is.

    Raises:
        RecordingError: other channels are measured in it, or it cannot be compared.
    """
    motion = system.motion
    alike = {"zeroed": motion.zeroed, "external": motion.external}
    reference_motion = prepared(
        reference, system.robot, motion.compared_hz, motion.forward, **alike, gain=motion.gain
    )
    known = RobotSystem(system.robot, reference_motion, system.listed, reference.name)
    columns, others = (set(each.comparison.columns) for each in (system, known))
    if columns != others:
        raise RecordingError(
            f"{reference.name}: has not the channels of the recording: "
            f"{some_of(sorted(columns ^ others))} in one of them alone; record both alike"
        )
    return Reference(known)


def added(values: Assignment, others: Assignment) -> dict[Term, float]:
    """Values, and those of others on top."""
    return dict(values) | {t: values.get(t, 0.0) + value for t, value in others.items()}


def write_prediction(path: Path, system: RobotSystem) -> None:
    """Write channels as measured, and as the nominal robot has them, into a CSV file.

    It appears whole or not at all.

    Raises:
        RecordingError: the place cannot be written to.
    """
    compared = system.comparison
    predicted = system.nominal
    labels = [compared.trial_labels[number] for number in compared.trial]
    columns: dict[str, Any] = {"time_s": compared.time_s, "trial": labels}
    for c, (name, column) in enumerate(zip(compared.names, compared.columns, strict=True)):
        columns[column] = compared.readings[:, c]
        columns[f"predicted.{name}"] = predicted[:, c]
    write_table(path, columns, "%.6g")
