"""Whether channels are what they say: saturated, stuck, of other cables or another arm.

What is wrong with a recording, and how bad that is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cablesense_base.arrays import Array
from cablesense_gap.recordings.recording import Recording, RecordingError, rows_named
from cablesense_sim.arm import Arm
from cablesense_sim.sensors import reading_variance_n2


class Severity(StrEnum):
    """Whether a recording can still be used."""

    WARN = "warn"
    REFUSE = "refuse"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        severity: whether it rules the recording out.
        kind: one word for programs, such as `time` or `swapped`.
        text: what, where (rows from 1, columns by name) and what would be right.
    """

    severity: Severity
    kind: str
    text: str


@dataclass(frozen=True)
class RecordingReport:
    """All that was found in a recording, the worst first."""

    name: str
    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether nothing rules it out."""
        return all(finding.severity is not Severity.REFUSE for finding in self.findings)

    def of_kind(self, kind: str) -> tuple[Finding, ...]:
        """The findings of a kind."""
        return tuple(finding for finding in self.findings if finding.kind == kind)

    def raise_if_unusable(self) -> None:
        """Nothing, where the recording can be used.

        Raises:
            RecordingError: the first reason that rules it out, and how many more there are.
        """
        refusals = [f.text for f in self.findings if f.severity is Severity.REFUSE]
        if refusals:
            more = f" (and {len(refusals) - 1} more)" if len(refusals) > 1 else ""
            raise RecordingError(f"{self.name}: {refusals[0]}{more}")


def refuse(kind: str, text: str) -> Finding:
    """A finding that rules the recording out."""
    return Finding(Severity.REFUSE, kind, text)


def warn(kind: str, text: str) -> Finding:
    """A finding to know of."""
    return Finding(Severity.WARN, kind, text)


Rows = NDArray[np.bool_]

MOVED_FLOORS = 50.0
"""A cable whose prediction varies by this many noise floors must show it."""
STUCK_TRIALS = 3
SATURATED_RUNS = 3
MOST_COSINE = 0.5
"""No effect turns the answers of half the cables further away from the prediction than this."""
SCALES = (0.2, 5.0)
"""Nor does any scale them by more."""
BETTER = 0.4
"""A channel belongs to another cable whose prediction leaves less than this of the residual."""


def channel_findings(recording: Recording, arm: Arm, nominal_n: Array | None) -> list[Finding]:
    """What is wrong with the channels; without a nominal prediction (R, M) the obvious alone."""
    read = recording.tensions_n
    findings = list(_at_range_ends(read, arm))
    findings += _dead(recording)
    if nominal_n is None:
        return findings
    floor_n = float(np.sqrt(reading_variance_n2(arm.sensors)))
    told = np.ptp(nominal_n, axis=0) > MOVED_FLOORS * floor_n
    if told.sum() < 2:
        return findings
    living = told & (np.ptp(read, axis=0) > 0.0)
    swapped = list(_swapped(read, nominal_n, np.flatnonzero(living)))
    if swapped:  # what else is said of these channels is said of the wrong ones
        return [*findings, *swapped]
    stuck = _stuck(recording, nominal_n, MOVED_FLOORS * floor_n)
    return [*findings, *stuck, *_foreign(read, nominal_n, living, arm)]


def _at_range_ends(read: Array, arm: Arm) -> Iterator[Finding]:
    if arm.sensors.range_n is None:
        return
    low, high = arm.sensors.range_n
    tolerance = 0.5 * arm.sensors.step_n
    for cable, values in enumerate(read.T, start=1):
        for end, name in ((values <= low - tolerance, low), (values >= high - tolerance, high)):
            if end.any():
                yield warn(
                    "saturated",
                    f"tension_{cable}_n is at the end of the sensors' range, {name:g} N, in "
                    f"{rows_named(end)}; load less, or widen the range",
                )


def _dead(recording: Recording) -> Iterator[Finding]:
    changes = np.ptp(recording.command_rad, axis=0).any() or np.ptp(recording.load_n, axis=0).any()
    if not changes:
        return
    for cable, values in enumerate(recording.tensions_n.T, start=1):
        if np.ptp(values) == 0.0:
            yield warn(
                "stuck",
                f"tension_{cable}_n is {values[0]:g} N in every row, whatever loads and poses; "
                "see whether its sensor is connected",
            )


def _stuck(recording: Recording, nominal_n: Array, moved_n: float) -> Iterator[Finding]:
    """Channels that stop at one value while the prediction moves on.

    Friction and slack hold a tension as well, but not from one trial to the next, as a dead
    channel does, nor at the same maximum in one cycle of loads after another.
    """
    channels = zip(recording.tensions_n.T, nominal_n.T, strict=True)
    for cable, (values, told) in enumerate(channels, start=1):
        if np.ptp(values) == 0.0:  # dead, and said already
            continue
        edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        runs = [slice(start, end) for start, end in pairwise(edges)]
        longest = max(runs, key=lambda run: run.stop - run.start)
        trials = len(np.unique(recording.trial[longest]))
        if trials >= STUCK_TRIALS and np.ptp(told[longest]) > moved_n:
            yield warn(
                "stuck",
                f"tension_{cable}_n stands still in rows {longest.start + 1} to {longest.stop}, "
                "while loads or poses change; see whether its sensor is connected",
            )
            continue
        tops = [
            run for run in runs if values[run.start] == values.max() and run.stop - run.start >= 3
        ]
        at_top = np.concatenate([told[run] for run in tops]) if tops else np.zeros(1)
        if len(tops) >= SATURATED_RUNS and np.ptp(at_top) > moved_n:
            yield warn(
                "saturated",
                f"tension_{cable}_n does not exceed {values.max():g} N in "
                f"{rows_named(values == values.max())}, while the load on it goes on; load less, "
                "or give the sensors' range_n in the arm file",
            )


def _swapped(read: Array, nominal_n: Array, living: NDArray[np.int64]) -> Iterator[Finding]:
    """Channels that another cable's prediction explains better, if all fit an exchange."""
    if len(living) < 2:
        return
    own = read[:, living] - read[:, living].mean(axis=0)
    told = nominal_n[:, living] - nominal_n[:, living].mean(axis=0)
    left_n = np.sqrt(((own[:, :, None] - told[:, None, :]) ** 2).mean(axis=0))
    channel, cable = linear_sum_assignment(left_n)
    moved = channel != cable
    better = left_n[channel, cable] < BETTER * left_n[channel, channel]
    pairs = [
        f"tension_{living[i] + 1}_n reads cable_{living[j] + 1}"
        for i, j in zip(channel[moved & better], cable[moved & better], strict=True)
    ]
    if pairs and (better | ~moved).all():
        yield warn(
            "swapped",
            f"{', '.join(pairs)}, by all that loads and poses do to it; see whether the plugs or "
            "the columns are exchanged",
        )


def _foreign(read: Array, nominal_n: Array, living: Rows, arm: Arm) -> Iterator[Finding]:
    own = read[:, living] - read[:, living].mean(axis=0)
    told = nominal_n[:, living] - nominal_n[:, living].mean(axis=0)
    if own.shape[1] < 2:
        return
    product, power = (own * told).sum(axis=0), (told**2).sum(axis=0)
    cosine = np.median(product / np.sqrt((own**2).sum(axis=0) * power))
    if cosine < MOST_COSINE:
        yield refuse(
            "arm",
            f"the tensions do not follow loads and poses as arm {arm.name} does (correlation "
            f"{cosine:.2f}); give the arm file of this arm, and see that axes and signs of loads "
            "and joints are those of the base frame",
        )
        return
    scale = np.median(product / power)
    if not SCALES[0] <= scale <= SCALES[1]:
        yield refuse(
            "unit",
            f"the tensions answer {scale:.3g} times as much as those of arm {arm.name}; they and "
            "the loads must be in N",
        )
