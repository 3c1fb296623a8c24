"""What the law states of contacts anywhere, against the truth: answers, errors, and coverage.

Samples are of arms that differ from their file as its tolerances allow, commissioned in unloaded
poses, and of exactly the arm of the file, known without error. There errors are compared with the
Cramér-Rao bound of all components of the force, the place, and where on the surface it acts, with
the priors that the law has: without them a straight arm determines no axial force, and segment 1
no place. Errors over the bound are one where an estimate is efficient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.arm_routes import arm_slides
from cablesense_contact.calibration import Calibration, Calibrator
from cablesense_contact.felt import alike
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.law import Law
from cablesense_contact.slides import Belief, Slides
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import as_described, built_arm
from cablesense_sim.effects.registry import amended, transmissions
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.noise_bound import contact_information
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.touch import touched_places
from cablesense_sim.uncertain_arm import arm_parameters, cable_friction
from cablesense_training.data.generation import solved_rows
from cablesense_training.data.protocols import AnywhereContact, protocol_from_options
from cablesense_training.evaluation.metrics import mean_or_nan, plain_values
from cablesense_training.evaluation.touches import (
    Touches,
    drawn_touches,
    touched_readings_n,
    unloaded_readings,
)

SAMPLES_AN_ARM = 100
"""Samples of one built arm; the next ones are of another."""
WRONG_N = 5.0
"""A statement is wrong if its lateral force is off by more than this"""
WRONG_SHARE = 0.2
"""and by more than this share of the force, or if its place is another."""
SAME_PLACE_M = 0.02
"""Next to a joint the neighbour's end is the same place."""

_LOW_N = 5.0
"""Weakest force of the protocol."""
_LOW_SHARE = 0.25
"""The same of a weak arm, as a share of its strongest."""
_HIGH_N = 40.0
"""Strongest force of the protocol, if the arm's own is not lower."""
_ROWS_AT_ONCE = 256
"""In one call of the law: they fit the memory of a laptop."""
_ROUNDING_M = 1e-4
"""By which a place may lie outside its interval and still count as in it."""
_HALF_NORMAL_MEDIAN = 0.6744898
"""Median of the absolute value of a standard normal number."""
_LATERAL_STD_N = 200.0
"""Prior deviation of each lateral component, and"""
_AXIAL_STD_N = 100.0
"""of the axial force of contacts on the axis, as the law has them."""


class Statements(NamedTuple):
    """What is stated of B readings.

    Attributes:
        state: (B,) of `ContactState`.
        segment: (B,) of the likeliest contact, from 1 on.
        place_m: (B,) from that segment's joint centre.
        region_m: (B, 2) interval of the place along the straight arm, from the first joint centre.
        force_n: (B, 3) along the axes of the segment at the command.
        magnitude_ci95_n: (B, 2) interval of the lateral force.
        moment_n_m: (B, 2) about the joint centre, around y and z.
    """

    state: NDArray[np.object_]
    segment: NDArray[np.int64]
    place_m: Array
    region_m: Array
    force_n: Array
    magnitude_ci95_n: Array
    moment_n_m: Array

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Statements:
        """Some of them."""
        return Statements._make(part[rows] for part in self)

    @classmethod
    def concatenate(cls, parts: list[Statements]) -> Statements:
        """All of some parts, one after the other."""
        return cls._make(np.concatenate(column) for column in zip(*parts, strict=True))


class TrueContacts(NamedTuple):
    """The one contact of each of B samples; segment 0 where nothing touches.

    Attributes:
        segment: (B,) from 1 on.
        place_m: (B,) from its joint centre.
        line_m: (B,) where the force's line of action meets the axis.
        force_n: (B, 3) along the axes that the segment has at the command.
    """

    segment: NDArray[np.int64]
    place_m: Array
    line_m: Array
    force_n: Array

    def select(self, rows: NDArray[np.bool_]) -> TrueContacts:
        """Some of them."""
        return TrueContacts._make(part[rows] for part in self)


@dataclass(frozen=True)
class BoundedErrors:
    """Absolute errors of one number over a set of contacts, in its unit; NaN of none.

    Those over the bound are one where errors are normal with their standard deviations at best;
    NaN where no bound is known.
    """

    median: float
    rms: float
    quantile95: float
    rms_over_bound: float = float("nan")
    median_over_bound: float = float("nan")

    @classmethod
    def of(cls, error: Array, bound_std: Array | None = None) -> BoundedErrors:
        """Of errors (C,) with their bounds (C,); a bound of zero is unknown and does not count."""
        if bound_std is not None:
            known = bound_std > 0.0
            error = error[known]
            bound_std = bound_std[known]
        if not len(error):
            return cls(*[float("nan")] * 3)
        size = np.abs(error)
        plain = cls(
            median=float(np.median(size)),
            rms=float(np.sqrt((size**2).mean())),
            quantile95=float(np.quantile(size, 0.95)),
        )
        if bound_std is None:
            return plain
        ratio = size / bound_std
        return replace(
            plain,
            rms_over_bound=float(np.sqrt((ratio**2).mean())),
            median_over_bound=float(np.median(ratio)) / _HALF_NORMAL_MEDIAN,
        )


@dataclass(frozen=True)
class StatedContacts:
    """Statements on single contacts; shares and errors are NaN of none.

    Attributes:
        contacts: their number.
        answered: share that is stated as a contact, with its force or its moment alone.
        force_known: share of the answered whose force is stated.
        same_place: share of the answered with the right segment, or a place next to the true one.
        place_mm, lateral_n, axial_n: where the force is stated and the place is the same; the
            magnitude of the force across the segment, and the force along it.
        moment_n_m: of the answered on the right segment, its magnitude about the joint centre.
        place_coverage95, force_coverage95: share of the intervals of the answered that hold the
            place, and the lateral force.
        wrong: number of statements that are: see `WRONG_N`.
    """

    contacts: int
    answered: float
    force_known: float
    same_place: float
    place_mm: BoundedErrors
    lateral_n: BoundedErrors
    axial_n: BoundedErrors
    moment_n_m: BoundedErrors
    place_coverage95: float
    force_coverage95: float
    wrong: int


@dataclass(frozen=True)
class LawMetrics:
    """Statements on samples of protocol `anywhere`, of one arm or of several.

    Attributes:
        arms: how many.
        doubted_calibrations: of these, whose unloaded readings doubt the tolerances.
        untouched: samples without a contact.
        free: share of them that is stated to be free.
        false_contacts: of them, stated as a contact.
        two_contacts: samples with two contacts at once.
        two_as_one: share of them that is stated as one contact.
        touched: samples with one contact.
        segments: the same by segment, from 1 on.
    """

    arms: int
    doubted_calibrations: int
    untouched: int
    free: float
    false_contacts: int
    two_contacts: int
    two_as_one: float
    touched: StatedContacts
    segments: tuple[StatedContacts, ...]

    def as_json(self) -> dict[str, Any]:
        """As plain values: shares first, then each kind of errors; None of what there is none."""
        content = asdict(self)
        rows = {"all": content.pop("touched")}
        rows |= {f"segment_{n}": row for n, row in enumerate(content.pop("segments"), start=1)}
        kinds = [name for name, value in rows["all"].items() if isinstance(value, dict)]
        errors = {kind: {name: row.pop(kind) for name, row in rows.items()} for kind in kinds}
        return dict(plain_values({**content, "touched": rows, **errors}))


class KnownArm:
    """An arm as its law knows it, at rest in any pose; states what readings show."""

    def __init__(self, law: Law, arm: Arm, calibration: Calibration) -> None:
        self._law = law
        self._judge = Judge(FeltArm(arm))
        self._known = Belief(calibration.mean, calibration.covariance)
        self._slides = arm_slides(arm)
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))

    def stated(self, readings_n: Array, commands_rad: Array) -> Statements:
        """Statements on the last of readings (K, B, M) at commands (B, 2N).

        Those before it begin with that of the untouched arm in the same pose: they show in which
        direction cables slide at their guides.
        """
        last = readings_n[-1]
        slides = [self._slides.unknown] * len(last)
        if len(readings_n) > 2 and self._slides.matter(self._known):
            courses = readings_n.swapaxes(0, 1)
            slides = [
                self._slid(course, command_rad)
                for course, command_rad in zip(courses, commands_rad, strict=True)
            ]
        parts = []
        order = []
        for rounded, rows in alike(self._slides, slides):
            known = self._slides.carried(self._known, rounded)
            for first in range(0, len(rows), _ROWS_AT_ONCE):
                chosen = rows[first : first + _ROWS_AT_ONCE]
                parts.append(self._answers(last[chosen], commands_rad[chosen], known))
                order.append(chosen)
        statements = Statements.concatenate(parts)
        return statements.select(np.argsort(np.concatenate(order)))

    def _slid(self, course_n: Array, command_rad: Array) -> Slides:
        """Slides at the last of readings (K, M) that begin with those of the untouched arm."""
        under_load = self._slides.under_load(command_rad, course_n[0], self._known)
        for reading_n in course_n[1:]:
            under_load = under_load.after(reading_n)
        return under_load.slides

    def _answers(self, readings_n: Array, commands_rad: Array, known: Belief) -> Statements:
        seen = self._law(readings_n, commands_rad, known.mean, known.covariance, self._unrest)
        judged = [self._judge(seen.row(i), reading) for i, reading in enumerate(readings_n)]
        state = np.empty(len(judged), dtype=object)
        state[:] = [each.state for each in judged]
        return Statements(
            state=state,
            segment=np.array([each.segment for each in judged], dtype=np.int64),
            place_m=seen.place_m,
            region_m=seen.region_m,
            force_n=seen.force_n,
            magnitude_ci95_n=seen.magnitude_ci95_n,
            moment_n_m=seen.moment_n_m,
        )


def exact_calibration(arm: Arm) -> Calibration:
    """That of an arm which equals its file: only what friction its cables carry is unknown."""
    parameters = arm_parameters(arm)
    friction = parameters.slices["friction"]
    mean = np.zeros(len(parameters))
    covariance = np.zeros((len(parameters), len(parameters)))
    if cable_friction(arm).listed:
        mean[friction] = parameters.prior_mean[friction]
        slides = arm_slides(arm)
        mean, covariance = slides.carried(Belief(mean, covariance), slides.unknown)
    return Calibration(
        arm.identity, mean, covariance, mean, covariance, made_from="the arm file, as exact"
    )


def law_protocol(
    arm: Arm, samples: int, no_contact_fraction: float | None = None
) -> AnywhereContact:
    """Contacts of 5 N to a firm push in bent poses, or as the arm bears.

    `no_contact_fraction` is the share of untouched samples, by default the protocol's own.

    Raises:
        WeakArmError: the arm cannot stand, or bears no contact.
    """
    options = {"kind": "anywhere", "samples": samples, "pose": "random"}
    protocol = protocol_from_options(options, arm)
    assert isinstance(protocol, AnywhereContact)
    high_n = min(protocol.force_high_n, _HIGH_N)
    low_n = min(_LOW_N, _LOW_SHARE * high_n)
    return replace(
        protocol, force_low_n=low_n, force_high_n=high_n, no_contact_fraction=no_contact_fraction
    )


def evaluate_exact(law: Law, arm: Arm, protocol: AnywhereContact, seed: int) -> LawMetrics:
    """Statements on exactly the arm of the file, with the bound where its cables do not rub."""
    built = as_described(arm)
    touches = drawn_touches(arm, protocol, seed)
    readings = touched_readings_n(arm, built, touches, np.random.default_rng([seed, 1]))
    borne = np.asarray(np.isfinite(readings).all(axis=(0, 2)))
    touches = touches.select(borne)
    known = KnownArm(law, arm, exact_calibration(arm))
    statements = known.stated(readings[:, borne], touches.command_rad)
    bound = None
    if not transmissions([built.entries]):
        single = touches.contacts.sum(axis=1) == 1
        mechanism = amended(built.mechanism, built.entries)
        bound = bound_std(arm, mechanism, touches.select(single))
    return law_metrics(arm, touches, statements, bound)


def evaluate_built(
    law: Law,
    arm: Arm,
    protocol: AnywhereContact,
    seed: int,
    on_done: Callable[[int], None] = lambda _: None,
) -> LawMetrics:
    """Statements on arms of the file's tolerances, each commissioned in unloaded poses.

    `on_done` counts samples. Arms that find no rest in one of these poses are left out.

    Raises:
        EquilibriumError: no arm is left.
    """
    calibrator = Calibrator(FeltArm(arm), law)
    touches = drawn_touches(arm, protocol, seed)
    reach_rad = float(np.deg2rad(protocol.pose_range_deg))
    statements = []
    kept = []
    doubted = 0
    for first in range(0, len(touches.contacts), SAMPLES_AN_ARM):
        arm_touches = touches.select(slice(first, first + SAMPLES_AN_ARM))
        on_done(len(arm_touches.contacts))
        built = built_arm(arm, _seed_of(seed, first))
        rng = np.random.default_rng([seed, 2, first])
        try:
            unloaded = unloaded_readings(arm, built, reach_rad, rng)
        except EquilibriumError:
            continue
        calibration = calibrator.moved(calibrator.from_poses(unloaded))
        doubted += not calibration.as_described
        readings = touched_readings_n(arm, built, arm_touches, rng)
        borne = np.asarray(np.isfinite(readings).all(axis=(0, 2)))
        kept.append(arm_touches.select(borne))
        known = KnownArm(law, arm, calibration)
        statements.append(known.stated(readings[:, borne], arm_touches.command_rad[borne]))
    if not kept:
        raise EquilibriumError(
            f"no arm of the tolerances of {arm.identity} finds a rest in every unloaded pose: "
            "they are too large for its stiff cables; state smaller ones in the arm file"
        )
    whole = Touches._make(np.concatenate(column) for column in zip(*kept, strict=True))
    metrics = law_metrics(arm, whole, Statements.concatenate(statements))
    return replace(metrics, arms=len(kept), doubted_calibrations=doubted)


def _seed_of(seed: int, number: int) -> int:
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def law_metrics(
    arm: Arm, touches: Touches, statements: Statements, bound: Array | None = None
) -> LawMetrics:
    """The metrics of statements on samples; `bound` is that of those with one contact."""
    number = touches.contacts.sum(axis=1)
    is_contact = is_stated(statements)
    is_free = statements.state == ContactState.FREE
    single = number == 1
    truth = true_contacts(touches.select(single))
    answers = statements.select(single)
    return LawMetrics(
        arms=1,
        doubted_calibrations=0,
        untouched=int((number == 0).sum()),
        free=mean_or_nan(is_free[number == 0]),
        false_contacts=int(is_contact[number == 0].sum()),
        two_contacts=int((number == 2).sum()),
        two_as_one=mean_or_nan(is_contact[number == 2]),
        touched=stated_contacts(arm, truth, answers, bound),
        segments=by_segment(arm, truth, answers, bound),
    )


def is_stated(statements: Statements) -> NDArray[np.bool_]:
    """(B,) whether a contact is stated, with its force or its moment alone."""
    state = statements.state
    return np.asarray((state == ContactState.CONTACT) | (state == ContactState.MOMENT))


def true_contacts(touches: Touches) -> TrueContacts:
    """The contacts of samples with one each."""
    rows = np.arange(len(touches.contacts))
    n = touches.contacts.argmax(axis=1)
    return TrueContacts(
        segment=n + 1,
        place_m=touches.place_m[rows, n],
        line_m=touches.line_m[rows, n],
        force_n=touches.force_n[rows, n],
    )


def by_segment(
    arm: Arm, truth: TrueContacts, answers: Statements, bound: Array | None = None
) -> tuple[StatedContacts, ...]:
    """The statements on contacts of each segment."""
    stated = []
    for n in range(1, arm.segment_count + 1):
        on_segment = truth.segment == n
        segment_bound = None if bound is None else bound[on_segment]
        stated.append(
            stated_contacts(
                arm, truth.select(on_segment), answers.select(on_segment), segment_bound
            )
        )
    return tuple(stated)


def stated_contacts(
    arm: Arm, truth: TrueContacts, answers: Statements, bound: Array | None = None
) -> StatedContacts:
    """The statements on C single contacts.

    `bound` (C, 4) has the least standard deviations of place, lateral and axial force, and moment.
    """
    length_m = mechanism_of(arm).segment_length_m
    joint_m = np.concatenate([[0.0], np.cumsum(length_m)[:-1]])
    true_m = joint_m[truth.segment - 1] + truth.place_m
    along_m = joint_m[answers.segment - 1] + answers.place_m
    lateral_n = np.hypot(truth.force_n[:, 1], truth.force_n[:, 2])
    found_n = np.hypot(answers.force_n[:, 1], answers.force_n[:, 2])
    answered = is_stated(answers)
    known = answers.state == ContactState.CONTACT
    right = answers.segment == truth.segment
    low_m, high_m = answers.region_m.T
    place_held = (low_m - _ROUNDING_M <= true_m) & (true_m <= high_m + _ROUNDING_M)
    low_n, high_n = answers.magnitude_ci95_n.T
    force_held = (low_n <= lateral_n) & (lateral_n <= high_n)
    near = right | place_held | (np.abs(along_m - true_m) < SAME_PLACE_M)
    off_n = np.abs(found_n - lateral_n)
    far_off = known & (off_n > np.maximum(WRONG_N, WRONG_SHARE * lateral_n))
    moment = np.hypot(answers.moment_n_m[:, 0], answers.moment_n_m[:, 1])
    true_moment = lateral_n * truth.line_m

    def errors(error: Array, column: int, rows: NDArray[np.bool_]) -> BoundedErrors:
        return BoundedErrors.of(error[rows], None if bound is None else bound[rows, column])

    placed = known & near
    return StatedContacts(
        contacts=len(answered),
        answered=mean_or_nan(answered),
        force_known=mean_or_nan(known[answered]),
        same_place=mean_or_nan(near[answered]),
        place_mm=errors(1e3 * (along_m - true_m), 0, placed),
        lateral_n=errors(found_n - lateral_n, 1, placed),
        axial_n=errors(answers.force_n[:, 0] - truth.force_n[:, 0], 2, placed & right),
        moment_n_m=errors(moment - true_moment, 3, answered & right),
        place_coverage95=mean_or_nan(place_held[answered]),
        force_coverage95=mean_or_nan(force_held[answered]),
        wrong=int((answered & (~near | far_off)).sum()),
    )


def bound_std(arm: Arm, mechanism: Mechanism, touches: Touches) -> Array:
    """(C, 4) least standard deviations of place, mm, lateral and axial force, N, and moment, N·m.

    Of samples with one contact each; zero where the arm finds no rest again.
    """
    truth = true_contacts(touches)
    rows = np.arange(len(truth.segment))
    line_m = truth.line_m
    places = touched_places(arm)
    radius_m = places.radius_m[truth.segment - 1]
    variance_n2 = reading_variance_n2(arm.sensors)

    def of_rows(own: NDArray[np.int64]) -> Array:
        information = contact_information(
            mechanism,
            touches.command_rad[own],
            truth.segment[own],
            line_m[own],
            truth.force_n[own],
            variance_n2,
        )
        return information.reshape(len(own), -1)

    information = solved_rows((len(rows), 16), len(rows), of_rows).reshape(-1, 4, 4)
    at_rest = np.asarray(np.isfinite(information).all(axis=(1, 2)))
    information = np.nan_to_num(information)

    x, y, z = truth.force_n.T
    lateral_n = np.maximum(np.hypot(y, z), 1e-9)
    share = np.divide(
        (line_m - truth.place_m) * lateral_n,
        radius_m * x,
        out=np.full_like(x, 0.5),
        where=radius_m * np.abs(x) > 0.0,
    )
    # (f_x, f_y, f_z, line) by (f_x, f_y, f_z, place, share of the radius)
    by = np.zeros((len(rows), 4, 5))
    by[:, [0, 1, 2, 3], [0, 1, 2, 3]] = 1.0
    by[:, 3, 0] = radius_m * share / lateral_n
    by[:, 3, 1] = -radius_m * share * x * y / lateral_n**3
    by[:, 3, 2] = -radius_m * share * x * z / lateral_n**3
    by[:, 3, 4] = radius_m * x / lateral_n
    whole = np.swapaxes(by, 1, 2) @ information @ by
    axial_std_n = places.friction * lateral_n if places.friction else _AXIAL_STD_N
    span_m = (places.touched_m[:, 1] - places.touched_m[:, 0])[truth.segment - 1]
    whole[:, 0, 0] += 1.0 / np.square(axial_std_n)
    whole[:, [1, 2], [1, 2]] += _LATERAL_STD_N**-2
    whole[:, 3, 3] += 12.0 / span_m**2
    whole[:, 4, 4] += 12.0
    covariance = np.linalg.inv(whole)

    of_lateral = np.zeros((len(rows), 5))
    of_lateral[:, 1] = y / lateral_n
    of_lateral[:, 2] = z / lateral_n
    of_moment = of_lateral * line_m[:, None] + lateral_n[:, None] * by[:, 3]
    of_place = np.zeros((len(rows), 5))
    of_place[:, 3] = 1e3
    of_axial = np.zeros((len(rows), 5))
    of_axial[:, 0] = 1.0
    directions = np.stack([of_place, of_lateral, of_axial, of_moment], axis=1)
    variance = ((directions @ covariance) * directions).sum(axis=2)
    return np.asarray(np.sqrt(variance.clip(min=0.0)) * at_rest[:, None])
