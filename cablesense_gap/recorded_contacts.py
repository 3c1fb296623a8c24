"""Known loads of a recording as contacts, and an estimator's errors on them.

The law of a machine knows it by a calibration from unloaded rows. It answers a reading as the
estimator node does, but at commands that are known to have settled. A network of the paper gets
differences to a tare. Rows are judged whose readings have settled: the node does not vouch for a
force that has just changed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.calibration import Calibration, Calibrator, Unloaded
from cablesense_contact.chi_squared import probability_above
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.felt import FeltMachine, alike, torque_covariance_at_rest
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.estimator import Estimator
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.law import Law, LawOutput
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_contact.slides import Belief, Slides
from cablesense_recording.recording import SAME_PLACE_M, Recording, RecordingError
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended, loadings
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    mean_or_nan,
    single_contact_metrics,
)

_STEADY_N = 1.0
"""Standard deviation of a cable's readings above which the estimator node takes no tare."""
_FEWEST_UNLOADED = 2
"""Rows that show an unloaded arm at rest."""
_SETTLED_ABOVE = 0.01
"""Probability of a change of readings by noise alone, below which they have not settled."""
_SETTLED_S = 0.2
"""Time in which they change; rows may be that far apart, or much closer."""
_FEWEST_SETTLED = 20
"""Loaded rows; with fewer, those that change least count, too."""
_SAME_TIME_S = 1e-6
"""Times that differ by less are the same."""
_LEAST_N = 1e-9
"""Force that counts as zero, so that none is divided by."""

Rows = NDArray[np.bool_]


class ArmLaw(Law, Protocol):
    """A law that states whose it is."""

    @property
    def arm(self) -> Arm:
        """The arm that the law was made for."""
        ...


KnownLaw: TypeAlias = ArmLaw | MachineLaw
"""The law of an arm, or of a machine that MuJoCo describes."""


def arm_of(estimator: ArmLaw | Estimator) -> Arm:
    """The arm that an estimator was made for."""
    return estimator.metadata.arm if isinstance(estimator, Estimator) else estimator.arm


def felt_of(estimator: KnownLaw | Estimator) -> FeltMachine:
    """The machine that an estimator was made for."""
    if isinstance(estimator, MachineLaw):
        return FeltModel(estimator.machine)
    return FeltArm(arm_of(estimator))


@dataclass(frozen=True)
class Tares:
    """The unloaded states of a recording that loads follow.

    Attributes:
        unloaded: each a mean of rows, in their order, without a time.
        of_row: (R,) the number of that which a row is loaded or released from; -1 for none.
    """

    unloaded: list[Unloaded]
    of_row: NDArray[np.int64]


def tares_of(recording: Recording) -> Tares:
    """A tare is the mean of the unloaded rows of one trial just before a load, at its command.

    If these are not steady, as with sensors that lag, the earlier tare at this command is used.
    """
    loaded = recording.load_segment > 0
    trial = recording.trial
    moved = _moved(recording)
    unloaded: list[Unloaded] = []
    of_row = np.full(len(recording), -1)
    latest: dict[bytes, int] = {}
    first: int | None = None  # of the latest unloaded rows at the present command
    last = 0
    for row in range(len(recording)):
        if moved[row]:
            first = None
        if not loaded[row]:
            if first is None or loaded[row - 1] or trial[row] != trial[row - 1]:
                first = row
            last = row
            if not moved[row]:  # a released row keeps the tare of its load
                of_row[row] = of_row[row - 1]
        elif loaded[row - 1] and not moved[row]:
            of_row[row] = of_row[row - 1]
        else:
            command_rad = recording.command_rad[row]
            if first is not None:
                before_n = recording.tensions_n[first : last + 1]
                if before_n.std(axis=0).max() <= _STEADY_N:
                    latest[command_rad.tobytes()] = len(unloaded)
                    unloaded.append(Unloaded(before_n.mean(axis=0), command_rad, len(before_n)))
            of_row[row] = latest.get(command_rad.tobytes(), -1)
    return Tares(unloaded, of_row)


def tares_n(recording: Recording) -> Array:
    """(R, M) tare of every row that is loaded or released from a load; NaN where there is none."""
    tares = tares_of(recording)
    nothing = np.full(recording.tensions_n.shape[1], np.nan)
    return np.array([*(each.reading_n for each in tares.unloaded), nothing])[tares.of_row]


def unloaded_poses(recording: Recording, trials: Collection[int] | None = None) -> list[Unloaded]:
    """The unloaded arm at rest at a command, of some trials or all: each the mean of its rows.

    Rows after a load of the same trial do not count, which friction or a lag may still show, nor
    do readings that are not steady. Times are those of the recording.
    """
    loaded = recording.load_segment > 0
    begins = _moved(recording)
    begins[1:] |= np.diff(recording.trial) != 0
    begins[1:] |= np.diff(loaded.astype(int)) != 0
    starts = np.flatnonzero(begins)
    poses = []
    for first, end in zip(starts, np.append(starts[1:], len(recording)), strict=True):
        if loaded[first] or (trials is not None and recording.trial[first] not in trials):
            continue
        released = first > 0 and loaded[first - 1]
        if released and recording.trial[first] == recording.trial[first - 1]:
            continue
        read_n = recording.tensions_n[first:end]
        if len(read_n) >= _FEWEST_UNLOADED and read_n.std(axis=0).max() <= _STEADY_N:
            # zero would be an unknown time
            taken_ns = 1 + int(1e9 * recording.time_s[end - 1])
            command_rad = recording.command_rad[first]
            poses.append(Unloaded(read_n.mean(axis=0), command_rad, len(read_n), taken_ns))
    return poses


def _moved(recording: Recording) -> Rows:
    """(R,) whether a row's command differs from that before it; the first one's does."""
    return (np.diff(recording.command_rad, axis=0, prepend=np.nan) != 0.0).any(axis=1)


def settled(recording: Recording, machine: FeltMachine) -> Rows:
    """(R,) rows whose readings have changed by the sensors' noise alone since 0.2 s before.

    Of the others, sensors that lag still show an earlier load. The first ones of a trial have not
    settled.
    """
    channels = recording.tensions_n.shape[1]
    by_noise = [
        probability_above(float(row), channels) for row in _change_chi2(recording, machine)
    ]
    return np.asarray(np.array(by_noise) > _SETTLED_ABOVE)


def _change_chi2(recording: Recording, machine: FeltMachine) -> Array:
    """(R,) χ² of how readings have changed since 0.2 s before, by noise; infinite at first."""
    time_s = recording.time_s
    before = np.searchsorted(time_s, time_s - _SETTLED_S + _SAME_TIME_S, side="right") - 1
    earlier = np.maximum(before, 0)
    change_n = recording.tensions_n - recording.tensions_n[earlier]
    variance_n2 = 2.0 * machine.mean_variance(1)
    chi2 = (change_n**2 / variance_n2).sum(axis=1)
    of_same_trial = (before >= 0) & (recording.trial[earlier] == recording.trial)
    return np.where(of_same_trial, chi2, np.inf)


def those_settled(recording: Recording, machine: FeltMachine, rows: Rows) -> Rows:
    """(R,) of some rows those whose readings have settled.

    Where of few loaded ones they have, as noisy sensors or long lags make it, those that change
    least take their place; all rows, where there is none but the first of its trial.
    """
    settled_rows = rows & settled(recording, machine)
    loaded_rows = rows & (recording.load_segment > 0)
    if (settled_rows & loaded_rows).sum() >= _FEWEST_SETTLED:
        return settled_rows
    chi2 = _change_chi2(recording, machine)
    least = np.sort(chi2[loaded_rows & np.isfinite(chi2)])[:_FEWEST_SETTLED]
    if not least.size:
        return rows
    return settled_rows | (rows & (chi2 <= least[-1]))


def at_contact_points(recording: Recording, arm: Arm) -> Rows:
    """(R,) rows without a load, or with it at the arm's contact point, as networks assume."""
    if recording.load_at_m is None:
        return np.ones(len(recording), dtype=bool)
    contact_m = mechanism_of(arm).contact_m[np.maximum(recording.load_segment, 1) - 1]
    elsewhere = np.abs(recording.load_at_m - contact_m) > SAME_PLACE_M
    return ~elsewhere | (recording.load_segment == 0)


def loads_at_m(recording: Recording, arm: Arm) -> Array:
    """(R,) where each load acts on its segment, from the joint centre; the arm file's by default.

    Effects that move contact points move the loads by as much. Rows without a load have the
    contact point of segment 1.
    """
    segment = np.maximum(recording.load_segment, 1) - 1
    nominal_m = mechanism_of(arm).contact_m
    moved_m = amended(mechanism_of(arm), entries_of(arm)).contact_m - nominal_m
    at_m = nominal_m[segment]
    if recording.load_at_m is not None:
        stated = np.isfinite(recording.load_at_m)
        at_m = np.where(stated, recording.load_at_m, at_m)
    return np.asarray(at_m + moved_m[segment])


def _places_m(recording: Recording, machine: FeltMachine) -> Array:
    """(R,) where each load acts on its link, along its axis; the machine file's place by default.

    Of an arm, effects that move contact points move the loads.
    """
    if isinstance(machine, FeltArm):
        return loads_at_m(recording, machine.arm)
    at_m = np.asarray(machine.contact_m)[np.maximum(recording.load_segment, 1) - 1]
    if recording.load_at_m is None:
        return at_m
    return np.where(np.isfinite(recording.load_at_m), recording.load_at_m, at_m)


def with_acting_loads(recording: Recording, arm: Arm) -> Recording:
    """The recording with the loads that acted, given the errors that an arm lists of its cell."""
    load_n = recording.load_n
    for matrix in loadings([entries_of(arm)]):
        load_n = load_n @ matrix[0].T
    return replace(recording, load_n=load_n)


class RecordedErrors(NamedTuple):
    """An estimator's answers on the contacts of a recording, and their errors.

    Attributes:
        truth: the parts of the loads that cables can feel; released rows are no contact.
        answer: the estimator's answers.
        whole: errors over all rows.
        by_segment: errors over the rows with a load on each segment, by its number.
        false_n: mean force estimated in rows without a load; NaN without such rows.
        links: names of the machine's links.
        confirmed: share of the loaded rows answered with a contact that is vouched for; NaN of a
            network, which vouches for none.
    """

    truth: ContactTruth
    answer: ContactAnswer
    whole: SingleContactMetrics
    by_segment: dict[int, SingleContactMetrics]
    false_n: float
    links: tuple[str, ...]
    confirmed: float = float("nan")

    @property
    def wrong_n(self) -> float:
        """Force that is stated wrongly, N, mean over all rows.

        On the right segment it is the error; of a load that is stated on none or on another one
        all of it, and of a released arm all that is stated.
        """
        stated_n = np.where(self.answer.segment > 0, self.answer.force_n, 0.0)
        error_n = np.abs(stated_n - self.truth.force_n)
        misplaced = self.answer.segment != self.truth.segment
        missed_n = np.maximum(error_n, self.truth.force_n)
        return mean_or_nan(np.where(misplaced, missed_n, error_n))

    def as_json(self) -> dict[str, Any]:
        """Errors as plain values."""
        return {
            "all": asdict(self.whole),
            "by_segment": {str(n): asdict(each) for n, each in self.by_segment.items()},
            "false_force_n": self.false_n,
            "confirmed": self.confirmed,
        }


def recorded_errors(
    recording: Recording,
    estimator: KnownLaw | Estimator,
    trials: Collection[int] | None = None,
    anywhere: bool | None = None,
    calibration: Calibration | None = None,
) -> RecordedErrors:
    """The errors of an estimator on the contacts of a recording of its machine, or of some trials.

    Rows count whose readings have settled (`settled`), or all, if few loaded ones have.
    Loads elsewhere than at the arm file's contact points count if they may be `anywhere`, by
    default for a law. A law is calibrated by the tolerances of its arm and the unloaded rows of
    these trials; with a `calibration` it starts from that, and takes a tare before each load.

    Raises:
        RecordingError: no load at a contact point follows unloaded rows at its command, so there
            is no tare.
    """
    machine = felt_of(estimator)
    if anywhere is None:
        anywhere = not isinstance(estimator, Estimator)
    tares = tares_of(recording)
    usable = np.asarray(tares.of_row >= 0)
    if not anywhere and not isinstance(estimator, MachineLaw):
        usable &= at_contact_points(recording, arm_of(estimator))
    rows = those_settled(recording, machine, _judged_rows(recording, usable, trials))
    confirmed = None
    if isinstance(estimator, Estimator):
        command_rad = recording.command_rad[rows]
        difference_n = (recording.tensions_n - tares_n(recording))[rows]
        answer = ContactAnswer.of(estimator.estimate_batch(difference_n, command_rad))
        poses = command_rad
    else:
        known = RecordedMachine(recording, tares, estimator, calibration, trials)
        answer, confirmed, poses = known.answers(rows)
    return _errors(recording.rows(rows), machine, answer, confirmed, poses)


def _judged_rows(recording: Recording, usable: Rows, trials: Collection[int] | None) -> Rows:
    """(R,) the usable rows, loaded and released ones with a tare, of some trials or all."""
    rows = usable.copy()
    if trials is not None:
        rows &= np.isin(recording.trial, list(trials))
    if not (rows & (recording.load_segment > 0)).any():
        raise RecordingError(
            f"{recording.name}: no load at a contact point of the arm file follows unloaded rows "
            "at its command, so there is no tare to estimate from; record load cycles "
            "(cablesense gap protocol)"
        )
    return rows


def _errors(
    taken: Recording,
    machine: FeltMachine,
    answer: ContactAnswer,
    confirmed: Rows | None,
    poses: Array,
) -> RecordedErrors:
    """Errors of answers on all rows of a recording, at poses (R, T), in what is felt of a load."""
    link = np.maximum(taken.load_segment, 1) - 1
    across_n = _in_link_axes(taken, machine, poses)[:, 1:]
    felt_n = np.einsum("rij,rj->ri", machine.felt_across[link], across_n)
    y = felt_n[:, 0]
    z = felt_n[:, 1]
    truth = ContactTruth(taken.load_segment, np.rad2deg(np.arctan2(y, z)) % 360.0, np.hypot(y, z))

    def errors(chosen: Rows) -> SingleContactMetrics:
        return single_contact_metrics(
            truth.select(chosen), answer.select(chosen), len(machine.link_names)
        )

    free = truth.segment == 0
    return RecordedErrors(
        truth,
        answer,
        errors(np.ones(len(taken), dtype=bool)),
        {int(n): errors(truth.segment == n) for n in np.unique(truth.segment) if n},
        mean_or_nan(answer.force_n[free]),
        tuple(name.replace("_", " ") for name in machine.link_names),
        float("nan") if confirmed is None else mean_or_nan(confirmed[~free]),
    )


def _in_link_axes(taken: Recording, machine: FeltMachine, poses: Array) -> Array:
    """(R, 3) the loads along the axes in which contacts on their links are stated."""
    axes: dict[bytes, Array] = {}
    force_n = np.empty_like(taken.load_n)
    for row, (command, pose) in enumerate(zip(taken.command_rad, poses, strict=True)):
        frame_pose = machine.frame_pose(command, pose)
        key = frame_pose.tobytes()
        if key not in axes:
            axes[key] = machine.links_at(frame_pose).axes
        link = max(int(taken.load_segment[row]), 1) - 1
        force_n[row] = taken.load_n[row] @ axes[key][link]
    return force_n


class RecordedMachine:
    """The machine of a recording as its law knows it, tare by tare."""

    def __init__(
        self,
        recording: Recording,
        tares: Tares,
        law: KnownLaw,
        calibration: Calibration | None = None,
        trials: Collection[int] | None = None,
    ) -> None:
        """Take the law, and a `calibration` of the machine.

        Without one it is made from unloaded poses, those of the `trials` if given.
        """
        self._recording = recording
        self._tares = tares
        self._law = law
        self._machine = felt_of(law)
        self._calibrator = Calibrator(self._machine, law)
        self._slides = self._machine.slides
        self._calibration = calibration
        self._by_poses: Calibration | None = None
        if calibration is None:
            poses = unloaded_poses(recording, trials)
            self._by_poses = self._calibrator.moved(self._calibrator.from_poses(poses))
        self._covariance_at_rest = torque_covariance_at_rest(self._machine)

    def answers(self, rows: Rows) -> tuple[ContactAnswer, Rows, Array]:
        """Answers on rows (R,) with a tare, which of them are vouched for, and poses (B, T).

        As the node publishes them: a contact also where it is not confirmed, and none where
        readings fit no contact. Where the readings determine the moment alone, the force is the
        one at the place of the load.
        """
        recording = self._recording
        judge = Judge(self._machine)
        at_m = _places_m(recording, self._machine)
        position = np.cumsum(rows) - 1
        count = int(rows.sum())
        segment = np.zeros(count, dtype=np.int64)
        confirmed = np.zeros(count, dtype=bool)
        forces = np.zeros((count, 4))
        poses = np.zeros((count, len(self._machine.torque_names)))
        for chosen, seen in self._seen(rows):
            for k, row in enumerate(chosen):
                row_seen = seen.row(k)
                judgement = judge(row_seen, recording.tensions_n[row])
                answer_row = position[row]
                poses[answer_row] = row_seen.pose_rad[0]
                if judgement.state not in (ContactState.FREE, ContactState.IMPLAUSIBLE):
                    segment[answer_row] = judgement.segment
                confirmed[answer_row] = judgement.state in (
                    ContactState.CONTACT,
                    ContactState.MOMENT,
                )
                by_moment = judgement.state is ContactState.MOMENT
                by_moment &= judgement.segment == recording.load_segment[row]
                forces[answer_row] = (
                    _force_at(row_seen, at_m[row]) if by_moment else _force(row_seen)
                )
        return ContactAnswer(segment, *forces.T), confirmed, poses

    def unexplained_n2(self, rows: Rows) -> Array:
        """Covariance (M, M), N², of what the law does not expect of readings under known loads.

        By how much the residuals r exceed what the law expects of them, S, and where, in n trials:

            C = mean over trials of mean over rows of (r r' - S)
            Σ = (n C₊ trace(C) / trace(C₊) + trace(C)/M · 1) / (n + 1)

        What is not noise lasts while a load does, so that a trial tells as much as one of its
        rows. C₊ is C without its negative variances. The last term is as if one trial more had
        left as much in all directions alike: a few trials do not show that in some there is none.
        """
        channels = self._recording.tensions_n.shape[1]
        by_trial: dict[int, list[Array]] = {}
        for chosen, residual_n, expected_n2 in self._residuals(rows):
            beyond_n2 = residual_n[:, :, None] * residual_n[:, None, :] - expected_n2
            for row, of_row_n2 in zip(chosen, beyond_n2, strict=True):
                by_trial.setdefault(int(self._recording.trial[row]), []).append(of_row_n2)
        if not by_trial:
            return np.zeros((channels, channels))
        beyond_noise_n2 = np.mean([np.mean(each, axis=0) for each in by_trial.values()], axis=0)
        total_n2 = float(np.trace(beyond_noise_n2))
        if total_n2 <= 0.0:
            return np.zeros((channels, channels))
        variances_n2, directions = np.linalg.eigh(beyond_noise_n2)
        seen_n2 = np.maximum(variances_n2, 0.0)
        directed_n2 = (directions * (total_n2 / seen_n2.sum() * seen_n2)) @ directions.T
        alike_n2 = total_n2 / channels * np.eye(channels)
        return np.asarray((len(by_trial) * directed_n2 + alike_n2) / (len(by_trial) + 1))

    def _residuals(self, rows: Rows) -> Iterator[tuple[NDArray[np.int64], Array, Array]]:
        """Some rows (R,) at a time, residuals (R, M) and what is expected of them (R, M, M), N².

        Rows of which the law explains less than nothing are left out: it has lost the pose there,
        as among slack cables it may, and will call such readings implausible.
        """
        recording = self._recording
        of_row = self._tares.of_row
        loaded = recording.load_segment > 0
        segment = np.maximum(recording.load_segment, 1) - 1
        at_m = _places_m(recording, self._machine)
        for chosen, seen in self._seen(rows):
            chosen_segment = segment[chosen]
            row_index = np.arange(len(chosen))
            force_n = _in_link_axes(recording.rows(chosen), self._machine, seen.pose_rad)
            force_n *= loaded[chosen, None]
            lever = seen.at_joint_m[row_index, chosen_segment]
            lever = lever + at_m[chosen, None, None] * seen.by_place[row_index, chosen_segment]
            torque_n_m = np.einsum("bi,bij->bj", force_n, lever)
            expected_n = np.einsum("bmj,bj->bm", seen.by_torque, torque_n_m)
            residual_n = seen.innovation_n - expected_n
            tared_n = np.array([self._tares.unloaded[k].reading_n for k in of_row[chosen]])
            explains = _sizes(residual_n) <= _sizes(recording.tensions_n[chosen] - tared_n)
            counts = explains | ~loaded[chosen]
            expected_n2 = np.asarray(np.linalg.inv(seen.information_n2[counts]))
            yield chosen[counts], residual_n[counts], expected_n2

    def _seen(self, rows: Rows) -> Iterator[tuple[NDArray[np.int64], LawOutput]]:
        """Some of the rows (R,) at a time, and what their readings say."""
        recording = self._recording
        of_row = self._tares.of_row
        for number in np.unique(of_row[rows]):
            tare = self._tares.unloaded[number]
            calibration = self._known_after(tare)
            known = Belief(calibration.mean, calibration.covariance)
            since = np.flatnonzero(of_row == number)
            readings_n = recording.tensions_n[since]
            slides = self._slid(readings_n, tare, known)
            judged = np.flatnonzero(rows[since])
            for rounded, positions in alike(self._slides, [slides[k] for k in judged]):
                chosen = since[judged[positions]]
                belief = self._slides.carried(known, rounded)
                yield (
                    chosen,
                    self._law(
                        recording.tensions_n[chosen],
                        recording.command_rad[chosen],
                        belief.mean,
                        belief.covariance,
                        self._covariance_at_rest,
                    ),
                )

    def _slid(self, readings_n: Array, tare: Unloaded, known: Belief) -> list[Slides]:
        """Slides at each of readings (R, M) that follow a tare."""
        if not self._slides.matter(known):
            return [self._slides.unknown] * len(readings_n)
        under_load = self._slides.under_load(tare.command_rad, tare.reading_n, known)
        slides = []
        for reading_n in readings_n:
            under_load = under_load.after(reading_n)
            slides.append(under_load.slides)
        return slides

    def _known_after(self, tare: Unloaded) -> Calibration:
        if self._by_poses is not None:
            return self._by_poses
        assert self._calibration is not None
        tared = self._calibrator.updated(self._calibration, tare, force=True)
        # what touches the arm lets cables slide: what they carried at the tare counts no more
        return self._calibrator.moved(tared)


def _force(seen: LawOutput) -> tuple[float, float, float, float]:
    """Angle, deg, and magnitude, N, with both deviations; `seen` is a batch of one.

    The magnitude's deviation is that of a normal distribution with its 95 % interval.
    """
    _, y, z = seen.force_n[0].tolist()
    low_n, high_n = seen.magnitude_ci95_n[0].tolist()
    (yy, yz), (_, zz) = seen.contact_covariance[0, 2:, 2:].tolist()
    magnitude_n = max(float(np.hypot(y, z)), _LEAST_N)
    across_n2 = max(z**2 * yy + y**2 * zz - 2.0 * y * z * yz, 0.0) / magnitude_n**2
    angle, angle_std = _turns(y, z, across_n2**0.5)
    return angle, magnitude_n, (high_n - low_n) / (2.0 * NORMAL_95), angle_std


def _sizes(vectors: Array) -> Array:
    """(R,) Euclidean norms of rows (R, M)."""
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _force_at(seen: LawOutput, at_m: float) -> tuple[float, float, float, float]:
    """The same of the force at a known place that has the moment which readings determine."""
    # a moment around z is due to y, around -y to z
    around_y, around_z = (seen.moment_n_m[0] / at_m).tolist()
    y_std, z_std = (seen.moment_std_n_m[0, ::-1] / at_m).tolist()
    y = around_z
    z = -around_y
    magnitude_n = max(float(np.hypot(y, z)), _LEAST_N)
    along_std_n = float(np.hypot(y * y_std, z * z_std)) / magnitude_n
    angle, angle_std = _turns(y, z, float(np.hypot(z * y_std, y * z_std)) / magnitude_n)
    return angle, magnitude_n, along_std_n, angle_std


def _turns(y: float, z: float, across_std_n: float) -> tuple[float, float]:
    """The angle of a force, and its deviation by that of the force across it, deg."""
    magnitude_n = max(float(np.hypot(y, z)), _LEAST_N)
    angle = float(np.rad2deg(np.arctan2(y, z))) % 360.0
    return angle, float(np.rad2deg(np.arctan2(across_std_n, magnitude_n)))
