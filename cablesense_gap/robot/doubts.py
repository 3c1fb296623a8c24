"""Doubts about a robot's recording, its hypotheses and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from cablesense_base import Array, some_of
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.robot.efforts import look_exchanged, looks_reversed
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.robot.motion import Motion
from cablesense_gap.robot.recording import RobotRecording
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Gap
from cablesense_sim.effects.effect import Parameter

_LEAVING_SHARE = 0.6
"""Columns are tried where the model's residual is more than this share of a measured channel."""
_BELIEVED_SHARE = 0.5
"""Changed columns are believed if the residual is then at most this share of the former."""
_TOUCHED_SHARE = 0.02
"""Change of the share that a channel leaves, from which on changed columns touch it."""
_MOST_SHARE = 2.0
"""Largest share of a channel that a residual counts as."""
_NEXT_ROW = 3.0
"""Times the usual interval up to which rows follow each other."""
_NEAR_TURN = 0.1
"""Share of a turn by which a jump may differ from one: joints move from row to row, a little."""
_AT_ZERO = 0.002
"""Share of a joint's span within which its position counts as zero."""
_OF_ANY_SIZE = ("link_mass",)
"""Effects that are as probable large as small: a heavier link and a payload in its middle, which
may have any mass, are one change with two names."""
_FURTHER_NUMBER_COST = 0.5
"""Each number in a further place of an effect costs this, natural logarithm."""
_FAR_BEYOND = 10.0
"""Times the model's own value that make a number of a verdict doubtful; of masses, if they are
also more than the whole robot's."""
_LITTLE_REMOVED = 0.5
"""Removed share of the gap below which a verdict is doubtful."""

Left = Callable[[RobotRecording], Mapping[str, float]]
"""By channel, the nominal model's residual as a share of the measured values, RMS."""


def exchanged(recording: RobotRecording, robot: Robot, left: Left) -> list[str]:
    """Exchanges and reversals of columns with which the nominal model fits far better.

    As sentences. They are sought before any effect is fitted: such a column is no property of a
    robot, and effects that imitate it get impossible numbers.
    """
    sentences: list[str] = []
    while max((now := left(recording)).values()) >= _LEAVING_SHARE:
        tried = [(_gain(now, left(each)), text, each) for text, each in _changes(recording, robot)]
        gain, text, changed = max(tried, key=lambda each: each[0])
        if gain <= 0.0 or text in sentences:
            break
        sentences.append(text)
        recording = changed
    return sentences


def _gain(before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """By how much the channels that a change of columns touches are better, if that is plain."""
    pairs = np.array([(before[c], after.get(c, np.inf)) for c in before])
    was_off, now_off = np.minimum(
        pairs[np.abs(np.diff(pairs)[:, 0]) > _TOUCHED_SHARE], _MOST_SHARE
    ).T
    square_before = float(was_off @ was_off)
    square_after = float(now_off @ now_off)
    return (
        square_before - square_after
        if square_before >= len(was_off) * _LEAVING_SHARE**2
        and square_after <= _BELIEVED_SHARE**2 * square_before
        else 0.0
    )


def _changes(recording: RobotRecording, robot: Robot) -> Iterator[tuple[str, RobotRecording]]:
    """Every exchange of two columns of one kind, and every column with the other sign."""
    units = robot.position_units
    driven = "torque" if np.isfinite(recording.torque).any() else "command"
    names = robot.joints if driven == "torque" else robot.controls
    for kind, labels, alike in (
        (driven, names, units if driven == "torque" else [""] * len(names)),
        ("position", robot.joints, units),
    ):
        values: Array = getattr(recording, kind)

        def changed(values: Array, kind: str = kind) -> RobotRecording:
            columns: dict[str, Any] = {kind: values}
            return replace(recording, **columns)

        known = np.flatnonzero(np.isfinite(values).all(0)).tolist()
        for a, b in combinations(known, 2):
            if alike[a] == alike[b]:
                order = np.arange(values.shape[1])
                order[[a, b]] = b, a
                text = look_exchanged(f"{kind}.{labels[a]}", f"{kind}.{labels[b]}")
                yield text, changed(values[:, order])
        for a in known:
            sign = np.where(np.arange(values.shape[1]) == a, -1.0, 1.0)
            yield looks_reversed(f"{kind}.{labels[a]}"), changed(values * sign)


def wrapped(recording: RobotRecording, robot: Robot) -> list[str]:
    """Hinges whose position jumps by a whole turn from one row to the next, as sentences."""
    interval_s = np.diff(recording.time_s)
    usual_s = float(np.median(interval_s[interval_s > 0.0]))
    in_turn = (interval_s > 0.0) & (interval_s <= _NEXT_ROW * usual_s)
    step = np.diff(recording.position, axis=0) / (2.0 * np.pi)
    jumps = in_turn[:, None] & (np.abs(np.abs(step) - 1.0) < _NEAR_TURN)
    return [
        f"position.{robot.joints[j]} jumps by a whole turn before row "
        f"{np.flatnonzero(jumps[:, j])[0] + 2}: it is wrapped, and must be continuous"
        for j in np.flatnonzero(jumps.any(0)).tolist()
        if robot.position_units[j] == "rad"
    ]


def beyond_range(recording: RobotRecording, robot: Robot) -> list[str]:
    """Commands that the model's actuators clip, if torques are computed from commands."""
    if np.isfinite(recording.torque).any():
        return []
    low, high = robot.model.actuator_ctrlrange.T
    most = recording.command.max(0)
    least = recording.command.min(0)
    clipped = robot.model.actuator_ctrllimited.astype(bool) & ((most > high) | (least < low))
    return [
        f"command.{robot.controls[a]} goes from {least[a]:.3g} to {most[a]:.3g}, which the model "
        f"clips to its range of {low[a]:.3g} to {high[a]:.3g}."
        for a in np.flatnonzero(clipped)
    ]


def servos_read(robot: Robot, motion: Motion) -> list[str]:
    """A sentence if servos of the model are taken to act on the recorded positions."""
    model = robot.model
    servos = [robot.actuators[a] for a in np.flatnonzero(model.actuator_biasprm[:, 1])]
    if not (motion.forward and motion.by_command and servos):
        return []
    return [
        f"The servos {some_of(servos)} are taken to act on the recorded positions, so joint_zero "
        "shows in weights alone, and a zero of a servo that differs appears as torque_offset."
    ]


def starts_at_zero(recording: RobotRecording) -> list[str]:
    """Whether all joints read zero at the start of each trial: by chance, or as they were set."""
    position = recording.position
    starts = np.diff(recording.trial, prepend=recording.trial[0] - 1) != 0
    at_zero = np.abs(position[starts]) <= _AT_ZERO * np.ptp(position, axis=0)
    if starts.sum() < 2 or not at_zero.all():
        return []
    return ["All trials start at zero; if encoders were set to zero there, say so with --zeroed."]


def weighed(problem: Problem, hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis, with what its tolerances, sizes and places cost.

    One tolerance far off counts as much as all of them off. A robot has dozens of tolerances. A
    single one, for example a delay of many samples, would not show in the sum of their squares.
    """
    largest = problem.worst_nuisance(hypothesis)
    least = len(hypothesis.nuisance) * (largest / problem.far_off) ** 4
    return replace(
        hypothesis,
        nuisance_chi2=max(hypothesis.nuisance_chi2, least),
        log_prior_penalty=_log_prior_penalty(problem, hypothesis),
    )


def _log_prior_penalty(problem: Problem, hypothesis: Hypothesis) -> float:
    """Sizes cost nothing within their expected range, and beyond it the same for each decade.

    The size that is surely farthest off counts for its location.
    """
    far: dict[tuple[str, str], list[float]] = {location: [] for location in hypothesis.locations}
    for term, value in hypothesis.values.items():
        parameter = problem.parameters[term]
        if parameter.role == "size":
            sure = max(abs(value) - hypothesis.deviations[term], 0.0)
            expected = np.inf if term.effect in _OF_ANY_SIZE else parameter.spread
            far[term[:2]].append(sure / (expected * parameter.typical))
    first = {location[0]: location for location in reversed(far)}
    numbers = sum(
        len(distances) for location, distances in far.items() if location != first[location[0]]
    )
    return (
        float(2.0 * sum(np.log(max(1.0, *distances)) for distances in far.values()))
        + _FURTHER_NUMBER_COST * numbers
    )


def of_verdict(
    robot: Robot,
    change: Change,
    inertia: Array,
    ranges: Mapping[Term, Parameter],
    values: Mapping[Term, float],
    gap: Gap,
) -> Iterator[str]:
    """Sizes at their bounds, a robot changed far beyond its model, and a gap that stays.

    `inertia` (J,) is what joints feel of the model. Its dampers and friction are often
    placeholders, so these may be far off.
    """
    for term, value in values.items():
        bounds = (ranges[term].low, ranges[term].high)
        name = f"{term.effect} at {term.place}"
        if ranges[term].role == "size" and value and value in bounds:
            yield f"{name}: {term.parameter} ends at its bound of {value:.3g}."
    nominal = robot.nominal()
    more_kg = change.mass_kg - nominal.mass_kg
    whole_kg = float(nominal.mass_kg.sum())
    # a light flange bears many times its own mass, but hardly more than the robot's
    heavy = more_kg > np.maximum(_FAR_BEYOND * nominal.mass_kg, whole_kg)
    for k in np.flatnonzero(heavy).tolist():
        yield (
            f"{more_kg[k]:.3g} kg are added to {robot.bodies[k]}, which has "
            f"{nominal.mass_kg[k]:.3g} kg; the whole model has {whole_kg:.3g} kg."
        )
    rotor = change.armature - nominal.armature
    for k in np.flatnonzero(rotor > _FAR_BEYOND * inertia).tolist():
        times = 1.0 + rotor[k] / inertia[k]
        yield f"The inertia of {robot.joints[k]} is {times:.1f} times the model's."
    if gap.removed_fraction < _LITTLE_REMOVED:
        yield f"The amended model leaves {1.0 - gap.removed_fraction:.0%} of the gap."
