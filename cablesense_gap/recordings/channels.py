"""Problems of a recording's channels: saturated, stuck or exchanged ones, those of another arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cablesense_base import Array
from cablesense_gap.recordings.recording import Recording, rows_named
from cablesense_sim.arm import Arm
from cablesense_sim.replay import reading_variance_n2

_MOVED_FLOORS = 50.0
"""A cable whose prediction varies by this many noise floors must show it."""
_STUCK_TRIALS = 3
_SATURATED_RUNS = 3
_LEAST_CORRELATION = 0.5
"""No effect turns the responses of half the cables further away from the prediction than this."""
_SCALES = (0.2, 5.0)
"""No effect scales them by more."""
_BETTER = 0.4
"""A channel belongs to another cable whose prediction leaves less than this of the residual."""


EXCHANGED = "exchanged"
"""The kind of the finding that channels read each other's cables."""


class Severity(StrEnum):
    """Whether a recording can still be used."""

    WARN = "warn"
    REFUSE = "refuse"


@dataclass(frozen=True)
class Finding:
    """One problem of a recording.

    Attributes:
        severity: whether it rules the recording out.
        kind: one word for programs, such as `time` or `exchanged`.
        text: what, where (rows from 1, columns by name) and what would be right.
    """

    severity: Severity
    kind: str
    text: str


refuse = partial(Finding, Severity.REFUSE)
warn = partial(Finding, Severity.WARN)


def channel_findings(
    recording: Recording, arm: Arm, nominal_n: Array | None, rows: NDArray[np.int64] | None = None
) -> list[Finding]:
    """Problems of the channels: saturated, stuck, of other cables or another arm.

    Without a nominal prediction for the `rows`, as in `check_recording`, only constant and
    saturated ones can be found.
    """
    read = recording.tensions_n
    findings = list(_at_range_ends(read, arm))
    if np.ptp(recording.command_rad, axis=0).any() or np.ptp(recording.load_n, axis=0).any():
        findings += [
            warn(
                "stuck",
                f"tension_{cable + 1}_n is {read[0, cable]:g} N in every row, whatever loads and "
                "poses; see whether its sensor is connected",
            )
            for cable in np.flatnonzero(np.ptp(read, axis=0) == 0.0)
        ]
    if nominal_n is None:
        return findings
    moved_n = _MOVED_FLOORS * float(np.sqrt(reading_variance_n2(arm.sensors)))
    predicted = np.ptp(nominal_n, axis=0) > moved_n
    if predicted.sum() < 2:
        return findings
    numbers = np.arange(len(recording)) if rows is None else rows
    compared = recording if rows is None else recording.rows(rows)
    read = compared.tensions_n
    cables = np.flatnonzero(predicted & (np.ptp(read, axis=0) > 0.0))
    own, expected = (v[:, cables] - v[:, cables].mean(axis=0) for v in (read, nominal_n))
    if len(cables) >= 2:
        exchanged = list(_exchanged(own, expected, cables))
        if exchanged:  # other findings would be of the wrong channels
            return [*findings, *exchanged]
    findings += _stuck(compared, numbers, nominal_n, moved_n)
    if len(cables) < 2:
        return findings
    _, pose = np.unique(compared.command_rad, axis=0, return_inverse=True)
    responses_n = [(own, expected)]
    of_loads = _less_means(own, pose), _less_means(expected, pose)
    if (np.ptp(of_loads[1], axis=0) > moved_n).all():
        responses_n.append(of_loads)
    return [*findings, *_foreign(responses_n, arm)]


def unborne_findings(unborne: NDArray[np.bool_], arm: Arm) -> list[Finding]:
    """Findings for rows (R,) in which the arm of the file has no equilibrium under the load."""
    if not unborne.any():
        return []
    return [
        warn(
            "unborne",
            f"{rows_named(unborne)}: {arm.name} as its file describes it finds no rest under the "
            "recorded loads, though the real arm did; left out. Check the scale of the loads, or "
            "load the arm less",
        )
    ]


def _at_range_ends(read: Array, arm: Arm) -> Iterator[Finding]:
    """Saturated channels. A reading of 0 N is no finding: a slack cable has no tension."""
    if arm.sensors.range_n is None:
        return
    low, high = arm.sensors.range_n
    tolerance = 0.5 * arm.sensors.step_n
    for cable, values in enumerate(read.T, start=1):
        for end, limit in ((values <= low - tolerance, low), (values >= high - tolerance, high)):
            if end.any() and limit != 0.0:
                yield warn(
                    "saturated",
                    f"tension_{cable}_n is at the end of the sensors' range, {limit:g} N, in "
                    f"{rows_named(end)}; load less, or widen the range",
                )


def _stuck(
    recording: Recording, numbers: NDArray[np.int64], nominal_n: Array, moved_n: float
) -> Iterator[Finding]:
    """Channels that stay at one value while the prediction changes; rows have `numbers` from 0.

    Friction and slack hold a tension too. A dead channel holds it from one trial to the next, and
    a saturated one has the same maximum in several load cycles.
    """
    channels = zip(recording.tensions_n.T, nominal_n.T, strict=True)
    for cable, (values, predicted) in enumerate(channels, start=1):
        if np.ptp(values) == 0.0:  # found already
            continue
        edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        runs = [slice(start, end) for start, end in pairwise(edges)]
        longest = max(runs, key=lambda run: run.stop - run.start)
        trials = len(np.unique(recording.trial[longest]))
        if trials >= _STUCK_TRIALS and np.ptp(predicted[longest]) > moved_n:
            yield warn(
                "stuck",
                f"tension_{cable}_n stands still in rows {numbers[longest.start] + 1} to "
                f"{numbers[longest.stop - 1] + 1}, while loads or poses change; see whether its "
                "sensor is connected",
            )
            continue
        tops = [
            run for run in runs if values[run.start] == values.max() and run.stop - run.start >= 3
        ]
        at_top = np.concatenate([predicted[run] for run in tops]) if tops else np.zeros(1)
        if len(tops) >= _SATURATED_RUNS and np.ptp(at_top) > moved_n:
            highest = np.zeros(numbers[-1] + 1, dtype=bool)
            highest[numbers[values == values.max()]] = True
            yield warn(
                "saturated",
                f"tension_{cable}_n does not exceed {values.max():g} N in "
                f"{rows_named(highest)}, while the load on it increases; load less, "
                "or give the sensors' range_n in the arm file",
            )


def _exchanged(own: Array, predicted: Array, cables: NDArray[np.int64]) -> Iterator[Finding]:
    """Channels that another cable's prediction explains better, if all fit an exchange.

    `own` and `predicted` (R, C) are of the C `cables`, less their means.
    """
    left_n = np.sqrt(((own[:, :, None] - predicted[:, None, :]) ** 2).mean(axis=0))
    # cables that answer alike would be exchanged by chance
    costs = np.where(np.eye(len(cables), dtype=bool), left_n, left_n / _BETTER)
    channel, cable = linear_sum_assignment(costs)
    moved = channel != cable
    better = left_n[channel, cable] < _BETTER * left_n[channel, channel]
    pairs = [
        f"tension_{cables[i] + 1}_n reads cable_{cables[j] + 1}"
        for i, j in zip(channel[moved & better], cable[moved & better], strict=True)
    ]
    if pairs and (better | ~moved).all():
        yield refuse(
            EXCHANGED,
            f"{', '.join(pairs)}, by all that loads and poses do to it: plugs or columns look "
            "exchanged; correct the recording, or continue with --force",
        )


def _foreign(responses_n: list[tuple[Array, Array]], arm: Arm) -> list[Finding]:
    """Tensions of another arm, or in another unit, if no pair of `responses_n` is of this one.

    A pair is the readings and the predictions (R, C), both without their means. Springs in joints
    outweigh the rest of a recording over poses, and friction hides loads, but neither does both.
    """
    found = []
    for read, predicted in responses_n:
        product, power = (read * predicted).sum(axis=0), (predicted**2).sum(axis=0)
        correlation = np.median(product / np.sqrt((read**2).sum(axis=0) * power))
        scale = np.median(product / power)
        if correlation < _LEAST_CORRELATION:
            found.append(
                refuse(
                    "arm",
                    f"the tensions do not follow loads and poses as arm {arm.name} does "
                    f"(correlation {correlation:.2f}); give the arm file of this arm, and see "
                    "that axes and signs of loads and joints are those of the base frame",
                )
            )
        elif not _SCALES[0] <= scale <= _SCALES[1]:
            found.append(
                refuse(
                    "unit",
                    f"the tensions answer {scale:.3g} times as much as those of arm {arm.name}; "
                    "they and the loads must be in N",
                )
            )
        else:
            return []
    return found[:1]


def _less_means(values: Array, group: NDArray[np.int64]) -> Array:
    """`values` (R, C) minus the mean of their group (R,)."""
    sums = np.zeros((group.max() + 1, values.shape[1]))
    np.add.at(sums, group, values)
    return values - (sums / np.bincount(group)[:, None])[group]
