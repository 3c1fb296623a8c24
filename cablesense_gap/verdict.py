"""The verdict of a diagnosis, and its file `verdict.json` (docs/verdict.md)."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field, ValidationError, model_validator

from cablesense_base import CableSenseError
from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_base.plain_yaml import FilePart, describe_problem

NONE: Final = "none"
UNKNOWN: Final = "unknown"
CANNOT_TELL: Final = "cannot_tell"
"""The reference does not cover the recording, so that nothing can be said."""
MAX_FILE_BYTES = 10_000_000
"""A verdict is some pages of text; anything larger is not one."""


class VerdictError(CableSenseError):
    """A verdict that cannot be: names the file, the key, its value and what would be valid."""


def checked_effects(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names of a hypothesis.

    Raises:
        ValueError: they are not in alphabetical order, or `none`, `unknown` or `cannot_tell` has
            company.
    """
    if list(names) != sorted(set(names)):
        raise ValueError(
            f"= {', '.join(names)}: must be in alphabetical order, each once: "
            f"{', '.join(sorted(set(names)))}"
        )
    for alone in (NONE, UNKNOWN, CANNOT_TELL):
        if alone in names and len(names) > 1:
            raise ValueError(f"= {', '.join(names)}: {alone} must stand alone")
    return names


def _ascending(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"= {list(interval)}: must be [lower, upper]")
    return interval


Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Effects = Annotated[tuple[Name, ...], Field(min_length=1), AfterValidator(checked_effects)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Rows = Annotated[int, Field(ge=1)]
Newtons = Annotated[float, Field(ge=0.0)]
Interval = Annotated[tuple[float, float], AfterValidator(_ascending)]
ParameterName = Annotated[
    str, Field(pattern=r"^[a-z][a-z0-9_]*(\.[A-Za-z0-9_\-/]+)?\.[a-z][a-z0-9_]*$")
]
PlaceName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-/]+$")]
"""A robot's joints and bodies have their model's names."""
ChannelName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-/.]+$")]


_CABLE = re.compile(r"cable_[1-9]\d*")


class Where(FilePart):
    """The parts of the arm where the gap is, and what the arm was doing where it is larger."""

    cables: tuple[Annotated[str, Field(pattern=r"^cable_[1-9]\d*$")], ...] = ()
    segments: tuple[Annotated[str, Field(pattern=r"^segment_[1-9]\d*$")], ...] = ()
    joints: tuple[PlaceName, ...] = ()
    bodies: tuple[PlaceName, ...] = ()
    tendons: tuple[PlaceName, ...] = ()
    regimes: tuple[str, ...] = ()

    @property
    def places(self) -> tuple[str, ...]:
        """Cables, segments, joints, bodies and tendons together."""
        return (*self.cables, *self.segments, *self.joints, *self.bodies, *self.tendons)


class FittedNumber(FilePart):
    """A fitted parameter, its unit, and the interval that holds it with 95 %."""

    value: float
    unit: str
    ci95: Interval


class Share(FilePart):
    """The contribution of one named effect.

    Sizes are in the verdict's `unit`: N of an arm, floors of a robot. A share is no fraction of
    the gap but an RMS, and shares do not add up to it: causes overlap, and RMS values add by their
    squares where they do not.

    Attributes:
        share_n: RMS by which predictions change without it, all else as fitted.
        ci95_n: interval of `share_n`.
        left_n: RMS gap once it and the effects with larger shares are simulated.
        probability: that it is there.
        places: where; empty for the whole arm.
        alternatives: effects that this recording cannot distinguish from it.
    """

    share_n: Newtons
    ci95_n: Interval
    left_n: Newtons
    probability: Probability
    places: tuple[str, ...] = ()
    alternatives: tuple[Name, ...] = ()


class Traded(FilePart):
    """Two of the effects, whose sum the recording determines better than either: one item.

    Sizes are in the verdict's `unit`, as of `Share`.

    Attributes:
        share_n: RMS by which predictions change without both.
        ci95_n: interval of `share_n`.
        correlation: of their shares as fitted: near -1 if one can replace the other, near 1 if
            they can cancel.
    """

    effects: Effects
    share_n: Newtons
    ci95_n: Interval
    correlation: Annotated[float, Field(ge=-1.0, le=1.0)]


class Gap(FilePart):
    """How far the gap shrinks on trials that the fit has not seen; sizes are RMS over readings.

    What ends with `_n` is in the verdict's `unit`: N of an arm, floors of a robot.

    Attributes:
        before_n: gap of the nominal arm.
        after_n: gap of the amended arm, with the effects found and tolerances as fitted.
        effects_n: gap of the nominal arm with the effects alone, where a verdict names some.
        floor_n: what the sensors' noise and step leave of any model.
        removed_fraction: share of the removable gap removed; 0 where nothing was to be removed.
        ci95: interval of `removed_fraction`, by bootstrap over trials.
        by_cable_n: gap of the nominal arm, one for each cable.
    """

    before_n: Newtons
    after_n: Newtons
    floor_n: Newtons
    removed_fraction: Annotated[float, Field(le=1.0)]
    ci95: Interval
    by_cable_n: tuple[Newtons, ...]
    effects_n: Newtons | None = None

    @property
    def removed_by_effects(self) -> float | None:
        """Share of the removable gap that the effects remove without tolerances."""
        if self.effects_n is None:
            return None
        return removed_fraction(self.before_n, self.effects_n, self.floor_n)


class ChannelGap(FilePart):
    """The gap in one channel in its own unit, RMS, on trials that the fit has not seen.

    Attributes:
        removed_fraction: share of its removable gap removed, as of `Gap`.
        effects: those of the verdict that change it, the one that changes it most first.
        unlisted: the probability that something unlisted acts in it besides.
    """

    unit: str
    before: Annotated[float, Field(ge=0.0)]
    after: Annotated[float, Field(ge=0.0)]
    floor: Annotated[float, Field(ge=0.0)]
    removed_fraction: Annotated[float, Field(le=1.0)] | None = None
    effects: tuple[Name, ...] = ()
    unlisted: Probability | None = None

    @property
    def kept(self) -> float:
        """Share of its removable gap that stays, 0 to 1."""
        removed = removed_fraction(self.before, self.after, self.floor)
        return min(max(1.0 - removed, 0.0), 1.0) if self.before > self.floor else 0.0


class UnlistedBeside(FilePart):
    """Something that no list has and that acts beside the named effects.

    Attributes:
        probability: that it is there.
        channels: in which it acts, more probably than not.
        trials: of the recording, if it acts in these alone: numbers in the file, or number and
            file where a robot's recording has several.
        before_n: RMS gap of the nominal machine in the readings that are left to it; none if
            the named effects are weighed by all readings.
        after_n: the same with the named effects.
    """

    probability: Probability
    channels: tuple[ChannelName, ...] = ()
    trials: tuple[int | str, ...] = ()
    before_n: Newtons | None = None
    after_n: Newtons | None = None


class CandidateResult(FilePart):
    """A hypothesis that was weighed.

    Attributes:
        effects: `["none"]`, `["unknown"]`, or names in alphabetical order.
        unlisted: whether something unlisted acts beside these effects.
        held_out_rmse_n: RMS residual on held-out trials, where nothing unlisted acts.
        probability: that it is the truth.
        held_out_ci95_n: interval of `held_out_rmse_n`, by bootstrap over trials.
    """

    effects: Effects
    held_out_rmse_n: Newtons
    probability: Probability
    held_out_ci95_n: Interval | None = None
    unlisted: bool = False


DECIDING_ERROR: Final = "wrong_force_n"
"""The error by which one of two estimators is the better one."""


class EstimatorErrors(FilePart):
    """Errors of the force estimators of the nominal and of the amended arm, by name.

    Attributes:
        before: of the first.
        after: of the second; none where there is none.
        use: which of the two is better on these loads.
        trials: of the recording, that neither the diagnosis nor the training had.
    """

    before: dict[str, float]
    after: dict[str, float] | None = None
    use: Literal["before", "after"] = "after"
    trials: tuple[int, ...] = ()


class Earlier(FilePart):
    """An effect that the arm file listed, as an earlier diagnosis found it, judged anew.

    Attributes:
        places: where; empty for the whole arm.
        outcome: confirmed with about the same numbers, confirmed with other sizes, or not needed.
        was: its numbers in the arm file, by `parameter` or `place.parameter`.
        now: as this recording has them; none where it is not needed.
    """

    effect: Name
    places: tuple[str, ...] = ()
    outcome: Literal["stands", "changed", "not needed"]
    was: dict[str, float] = Field(default_factory=dict)
    now: dict[str, FittedNumber] = Field(default_factory=dict)


class FrictionForm(FilePart):
    """The law that the friction of one joint follows, as held-out trials tell.

    Attributes:
        law: the plainest law than which the best is not clearly better.
        determined: whether every law that does not contain it is clearly worse.
        rivals: laws that are not, though they do not contain it.
        left_n: RMS gap on held-out trials with each law that was compared.
    """

    law: str
    determined: bool
    rivals: tuple[str, ...] = ()
    left_n: dict[str, Newtons] = Field(default_factory=dict)


Quantity = Literal["position", "speed", "load", "acceleration"]
"""A condition of a channel's readings (`diagnosis.discrepancy.Conditions`)."""


class Lacking(FilePart):
    """A condition of a channel's readings that the reference does not cover.

    Attributes:
        recorded: the interval that holds nine tenths of its values in these readings.
        reference: the interval that the reference has.
    """

    quantity: Quantity
    unit: str
    recorded: Interval
    reference: Interval


_LEAST_COVERED = 0.5
"""Share of a channel's readings below which its floor is mostly extrapolated: a verdict against
the reference is then `cannot_tell`, but for effects that the covered readings show."""


class ChannelCoverage(FilePart):
    """The share of a channel's readings that the reference covers, and what it lacks.

    Attributes:
        lacking: quantities of which these readings go beyond the reference's; none where single
            ones are within, and only their combination is not covered.
    """

    share: Probability
    lacking: tuple[Lacking, ...] = ()

    @property
    def is_mostly_covered(self) -> bool:
        """Whether most of the channel's floor is known by the reference, not extrapolated."""
        return self.share >= _LEAST_COVERED


class ReferenceGap(FilePart):
    """The healthy recording that a verdict is against; what it names came since.

    Attributes:
        recording: its name.
        before_n: RMS gap of the nominal model there.
        left_n: the same with tolerances and discrepancy, on trials that their fit has not seen.
        channels: of a robot, both by joint.
        covered_share: share of the diagnosed readings that the reference covers; the verdict is
            of these alone.
        coverage: the same by channel, and which quantities are lacking.
    """

    recording: str
    before_n: Newtons
    left_n: Newtons
    channels: dict[ChannelName, ChannelGap] = Field(default_factory=dict)
    covered_share: Probability | None = None
    coverage: dict[ChannelName, ChannelCoverage] = Field(default_factory=dict)

    @property
    def uncovered_channels(self) -> dict[str, ChannelCoverage]:
        """The channels that are mostly not covered, by name."""
        return {name: each for name, each in self.coverage.items() if not each.is_mostly_covered}


class Verdict(FilePart):
    """The cause of the gap, its place, its probability, and how far the gap shrinks.

    docs/verdict.md explains every key. All sizes with `_n` at their ends are root mean squares in
    `unit`: N of an arm; channels of a robot are each in units of their floor, `floors`.

    Attributes:
        effects: `("none",)`, `("unknown",)`, `("cannot_tell",)`, or names in alphabetical order.
        probability: that exactly these effects are the cause; of `cannot_tell` the share of the
            least covered channel that the reference does not cover.
        ambiguity_group: hypotheses that this recording cannot distinguish; several effects of
            one hypothesis are joined by `+`.
        parameters: by `effect.parameter`, or `effect.place.parameter` for one place of several.
        shares: of each effect named.
        traded: pairs of these whose shares trade against each other, the largest first.
        forms: of a robot, by joint, the law of its friction.
        earlier: effects that the arm file listed; the verdict's effects are additional.
        unlisted: what acts beside the effects named and is in no list; none where nothing does.
        candidates: all hypotheses weighed, in any order.
        reference: present if the verdict says what changed since a healthy recording.
        channels: the gap in each cable, or at each joint of a robot, in its own unit.
        doubts: for a robot, why the amended model is doubtful, as sentences; the probability is
            then at most a half.
        rows_used: of the recording's `rows`; sizes are over those `rows_counted` of them in which
            the arm has one rest.
    """

    effects: Effects
    probability: Probability
    ambiguity_group: tuple[str, ...] = ()
    next_experiment: str = ""
    where: Where
    parameters: dict[ParameterName, FittedNumber] = Field(default_factory=dict)
    gap: Gap
    shares: dict[Name, Share] = Field(default_factory=dict)
    traded: tuple[Traded, ...] = ()
    forms: dict[PlaceName, FrictionForm] = Field(default_factory=dict)
    earlier: tuple[Earlier, ...] = ()
    tolerances_n: Newtons | None = None
    unlisted: UnlistedBeside | None = None
    unexplained_n: Newtons | None = None
    unexplained_share: Probability | None = None
    candidates: tuple[CandidateResult, ...] = ()
    estimator: EstimatorErrors | None = None
    reference: ReferenceGap | None = None
    doubts: tuple[str, ...] = ()
    why: tuple[str, ...] = ()
    seconds: Newtons | None = None
    recording: str = ""
    rows: Rows | None = None
    rows_used: Rows | None = None
    rows_counted: Rows | None = None
    arm: str = ""
    unit: str = "N"
    channels: dict[ChannelName, ChannelGap] = Field(default_factory=dict)
    compared: str = ""

    @model_validator(mode="after")
    def _probabilities_are_of_one_truth(self) -> Verdict:
        total = sum(candidate.probability for candidate in self.candidates)
        if total > 1.0 + 1e-3:  # rounded numbers may add up to a little more
            raise ValueError(
                f"candidates: probabilities add up to {total:.4g}; at most 1 is right"
            )
        kinds = Counter((c.effects, c.unlisted) for c in self.candidates)
        for (effects, _), count in kinds.items():
            if count > 1:
                raise ValueError(f"candidates: {joined(effects)} stands twice; each must be once")
        return self

    @model_validator(mode="after")
    def _cannot_tell_names_what_lacks(self) -> Verdict:
        if self.effects != (CANNOT_TELL,):
            return self
        if self.reference is None:
            raise ValueError(
                f"effects: {CANNOT_TELL} is said against a reference alone, and there is none; "
                f"give one, or say {NONE}, {UNKNOWN} or names of effects"
            )
        if not self.reference.uncovered_channels:
            raise ValueError(
                f"reference.coverage: {CANNOT_TELL} needs a channel of which less than "
                f"{_LEAST_COVERED:.0%} is covered, and none is here"
            )
        return self

    @property
    def of_robot(self) -> bool:
        """Whether its machine is a robot: channels that are no cables, each with its own floor."""
        return self.unit == "floors" or any(
            not _CABLE.fullmatch(channel) for channel in self.channels
        )

    @property
    def ranked(self) -> tuple[CandidateResult, ...]:
        """Candidates, the most probable first; among equals the one that leaves less."""
        return tuple(sorted(self.candidates, key=lambda c: (-c.probability, c.held_out_rmse_n)))


def joined(effects: tuple[str, ...] | list[str]) -> str:
    """Effects as one name, `payload+sensor_gain`."""
    return "+".join(sorted(effects))


def listed(items: list[str], last: str = "and") -> str:
    """Text `a, b and c`."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"


def short(value: float) -> str:
    """A number with two digits, and no decimals from 10 on."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def removed_fraction(before_n: float, after_n: float, floor_n: float) -> float:
    """Share of the removable gap that is removed; 0 where the gap before is within the floor."""
    removable_n = before_n - floor_n
    return min(1.0, (before_n - after_n) / removable_n) if removable_n > 0.0 else 0.0


def write_verdict(path: str | Path, verdict: Verdict) -> None:
    """Write a verdict as JSON; the file appears whole or not at all.

    Raises:
        VerdictError: the place cannot be written to.
    """
    text = verdict.model_dump_json(indent=2, exclude_none=True) + "\n"
    write_atomically(path, text, VerdictError)


def read_verdict(path: str | Path) -> Verdict:
    """Read a verdict.

    Raises:
        VerdictError: the file cannot be read, is not JSON, has an unknown key or a value that
            cannot be.
    """
    text = read_bounded_text(path, MAX_FILE_BYTES, "a verdict", VerdictError)
    try:
        return Verdict.model_validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            problem = f"not valid JSON ({first['ctx']['error']})"
        elif first["type"] == "string_pattern_mismatch":
            key = ".".join(map(str, first["loc"]))
            pattern = first["ctx"]["pattern"]
            problem = f"{key} = {str(first['input'])[:80]!r}: must be written as {pattern}"
        else:
            problem = describe_problem(error, Verdict)
        raise VerdictError(f"{path}: {problem}") from None
