"""What a model leaves of a recording: a regression without physics, scored on held-out folds.

No model is exact. Each channel's residual has a Bayesian linear regression on columns in groups.
Each group has its own prior variance, which is that of the largest evidence (MacKay, Bayesian
interpolation, 1992). For a healthy machine, against which another recording is diagnosed, the
columns are

- the changes that the candidates would make, linear about the nominal machine, and
- waves in the channel's own position, alone and times functions of its speed; and functions of
  its load.

The posterior predicts the mean residual of another recording, which is no gap, and its variance,
which replaces the floor. The residuals of held-out trials may make the variance larger. A part of
the variance is the scatter, which no further reading would make smaller. The rest is extrapolated:
it comes from the coefficients, and from conditions beyond those of the reference.
"""

from __future__ import annotations

from collections import ChainMap, Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.problem import Problem, unit_of
from cablesense_gap.diagnosis.selection import linear_effects
from cablesense_gap.simulator import Term

_WAVES = 40
"""Half waves over the range of positions: the ripple of a gear has tens of them."""
_SLIDING_WAVES = 8
"""Half waves over the range of positions, times functions of the speed: friction by position."""
_SLOW = (0.05, 0.3, 1.0)
"""Shares of the usual speed at which functions of the speed saturate: friction's direction, its
rise at rest, and damping."""
_POWERS = 6
"""Powers of the position, from 0: those of a spring."""
_SLIDING_POWERS = 3
"""Powers of the position times the direction of the motion, from 0."""
_FARTHEST_HALF_RANGES = 1.6
"""Half ranges from the middle beyond which powers stay constant: they grow without bound."""
_MARGIN = 0.1
"""Share of a condition's range beyond it where nothing is known any more; waves end there."""
CORRELATED = 4.0
"""Rows in turn that count as one."""
_ITERATIONS = 30
"""Of the fixed point of the evidence, which converges by then."""
_FIRST_SCATTER = 0.1
"""Share of a residual's mean square that is noise, where the iterations start."""
_LEAST_SCATTER = 1e-8
"""Share of a residual's mean square that is noise at least: rounding."""
_LEAST_FREE = 0.1
"""Share of the rows that count as free at least, however many columns are determined."""
_PRECISIONS = (1e-3, 1e9)
"""Bounds of a prior's precision, where readings have a mean square of one: free, and switched
off."""
_LEAST_SQUARE = 1e-12
"""Mean square below which a coefficient is zero."""
_LEAST_SIZE = 1e-9
"""Below which a range, a speed, a load or a column counts as zero."""

Key = tuple[str, ...]
"""The name of a column, the first part that of its group."""


class Conditions(NamedTuple):
    """How each channel's part of the machine moves and what it bears, in SI units.

    (R, C) by row and channel, or (C,) where they are bounds.
    """

    position: Array
    speed: Array
    load: Array
    acceleration: Array

    def only(self, channels: NDArray[np.int64]) -> Conditions:
        """The same of K of the C channels, given by their positions (K,)."""
        return Conditions(*(quantity[..., channels] for quantity in self))


class ConditionUnits(NamedTuple):
    """The name of a channel, and the units of its conditions."""

    name: str
    position: str
    speed: str
    load: str
    acceleration: str


def effect_columns(problem: Problem) -> dict[Key, Array]:
    """Columns (R, C) of all candidates that do not depend on history, for values of one.

    The last part of a name counts the shapes from which a candidate starts.
    """
    columns: dict[Key, Array] = {}
    for candidate in problem.simulator.candidates:
        effects = [] if candidate.history_dependent else linear_effects(problem, candidate)
        numbers: Counter[Term] = Counter()
        for term, column in chain(*(zip(e.varied, e.columns, strict=True) for e in effects)):
            if problem.parameters[term].role == "size":
                unit = unit_of(problem.parameters[term], 0.0)
                columns[(*term, str(numbers[term]))] = column / unit
                numbers[term] += 1
    return columns


@dataclass(frozen=True)
class SmoothColumns:
    """Functions of the conditions, by what the reference's are like.

    Attributes:
        low, high: (C,) the least and the largest of each condition.
        speed, load: (C,) root mean squares.
    """

    low: Conditions
    high: Conditions
    speed: Array
    load: Array

    @staticmethod
    def like(conditions: Conditions) -> SmoothColumns:
        """The functions whose ranges are those of conditions (R, C)."""
        low = Conditions(*(quantity.min(0) for quantity in conditions))
        high = Conditions(*(quantity.max(0) for quantity in conditions))
        sizes = (
            np.sqrt((c**2).mean(0)) + _LEAST_SIZE for c in (conditions.speed, conditions.load)
        )
        return SmoothColumns(low, high, *sizes)

    def powers(self, conditions: Conditions) -> Array:
        """(K, R, C) powers of the position, alone and times the direction of the motion."""
        position = np.clip(
            2.0 * self._place(conditions) - 1.0, -_FARTHEST_HALF_RANGES, _FARTHEST_HALF_RANGES
        )
        way = np.tanh(conditions.speed / (_SLOW[1] * self.speed))
        alone = [position**k for k in range(_POWERS)]
        return np.array([*alone, *(way * power for power in alone[:_SLIDING_POWERS])])

    def _place(self, conditions: Conditions) -> Array:
        """Positions (R, C) as shares of the range."""
        span = np.maximum(self.high.position - self.low.position, _LEAST_SIZE)
        return np.asarray((conditions.position - self.low.position) / span)

    def beyond(self, conditions: Conditions) -> Conditions:
        """(R, C) by how much conditions are beyond their ranges; from 1 on nothing is known."""
        margins = []
        for name, quantity, low, high in zip(
            Conditions._fields, conditions, self.low, self.high, strict=True
        ):
            size = 0.0 if name == "position" else np.maximum(np.abs(low), np.abs(high))
            span = np.maximum(np.maximum(high - low, size), _LEAST_SIZE)
            excess = np.abs(quantity - np.clip(quantity, low, high))
            margins.append(excess / (_MARGIN * span))
        return Conditions(*margins)

    def only(self, channels: NDArray[np.int64]) -> SmoothColumns:
        """The same of K of the C channels, given by their positions (K,)."""
        return SmoothColumns(
            self.low.only(channels),
            self.high.only(channels),
            self.speed[channels],
            self.load[channels],
        )

    def waves(self, conditions: Conditions) -> list[tuple[int, Key, Array]]:
        """Half waves over the range, name and column (R, C); alone and times speed functions."""
        phase = np.clip(self._place(conditions), -_MARGIN, 1.0 + _MARGIN) + _MARGIN
        phase *= np.pi / (1.0 + 2.0 * _MARGIN)
        waves = [(k, wave) for k in range(_WAVES) for wave in _wave(k, phase)]
        named_waves: list[tuple[int, Key, Array]] = [
            (k, (f"wave {k}", str(n)), wave) for n, (k, wave) in enumerate(waves)
        ]
        for share in _SLOW:
            way = np.tanh(conditions.speed / (share * self.speed))
            for n, (k, wave) in enumerate(waves[: 2 * _SLIDING_WAVES + 1]):
                named_waves.append((k, (f"wave {k} times speed", f"{share}", str(n)), wave * way))
        return named_waves

    def of(self, conditions: Conditions) -> dict[Key, Array]:
        """Columns (R, C) by name at conditions (R, C): waves, and functions of the load."""
        columns = {key: column for _, key, column in self.waves(conditions)}
        load = conditions.load / self.load
        size = np.abs(load)
        for share in _SLOW:
            way = np.tanh(conditions.speed / (share * self.speed))
            columns["load times speed", f"{share}"] = size * way
        columns |= {("load", "size"): size, ("load", "square"): load * size, ("load", ""): load}
        return columns


def _wave(k: int, at: Array) -> Sequence[Array]:
    return (np.cos(k * at), np.sin(k * at)) if k else (np.ones_like(at),)


class Prediction(NamedTuple):
    """The residuals that are expected of a healthy machine in another recording, (R, C) each.

    Attributes:
        mean: of the residuals.
        scatter: standard deviation of what does not repeat.
        extrapolated: standard deviation of the rest, by what the reference does not tell.
    """

    mean: Array
    scatter: Array
    extrapolated: Array

    @property
    def deviation(self) -> Array:
        """Standard deviation of a residual, (R, C)."""
        return np.hypot(self.scatter, self.extrapolated)


@dataclass(frozen=True)
class _Channel:
    """The posterior of one channel's coefficients, of columns by name.

    `square` is the mean square of the channel's residual.
    """

    keys: tuple[Key, ...]
    mean: Array
    covariance: Array
    square: float
    scatter: float
    factor: float = 1.0

    def part(self, columns: Mapping[Key, Array], c: int) -> Array | float:
        """(R,) contributions of some columns, of which it takes the channel c, to its mean."""
        known = zip(self.keys, self.mean.tolist(), strict=True)
        return sum(size * columns[key][:, c] for key, size in known if key in columns)

    def of(self, columns: Mapping[Key, Array], c: int, beyond: Array) -> Prediction:
        """That of its readings (R,); `beyond` (R,) as of `Discrepancy.of`.

        With columns x the extrapolated variance is xᵀ Σ x of the coefficients, and beyond the
        range the variance of all that repeats, for each margin beyond.
        """
        absent = np.zeros_like(beyond)
        x = np.array([columns[k][:, c] if k in columns else absent for k in self.keys])
        x = x.reshape(len(self.keys), len(beyond))
        of_coefficients = self.factor * np.maximum((x * (self.covariance @ x)).sum(0), 0.0)
        repeating = max(self.square - self.scatter, 0.0)
        scatter = np.full_like(beyond, np.sqrt(self.factor * self.scatter))
        return Prediction(self.mean @ x, scatter, np.sqrt(of_coefficients + repeating * beyond**2))


class Discrepancy:
    """A residual, learnt from a recording.

    Attributes:
        held_out: (R, C) each fold predicted by a fit to the others; zero in channels where that
            is no better than nothing.
    """

    def __init__(
        self, columns: Mapping[Key, Array], residual: Array, fold: NDArray[np.int64]
    ) -> None:
        """Columns and residual are (R, C); rows of one fold (R,) are held out together."""
        self.held_out = np.zeros_like(residual)
        self._channels = []
        for c in range(residual.shape[1]):
            channel, self.held_out[:, c] = _fitted(columns, residual, c, fold)
            self._channels.append(channel)

    def of(self, columns: Mapping[Key, Array], beyond: Array) -> Prediction:
        """Another recording's residuals (R, C).

        `beyond` (R, C) says by how many margins its conditions leave those of the reference.
        """
        by_channel = [
            channel.of(columns, c, beyond[:, c]) for c, channel in enumerate(self._channels)
        ]
        return Prediction(*(np.stack(part, axis=1) for part in zip(*by_channel, strict=True)))

    def part(self, columns: Mapping[Key, Array], channels: NDArray[np.int64]) -> Array:
        """(R, K) contributions of some columns (R, K) to the mean of K channels."""
        contributions = np.zeros_like(next(iter(columns.values())))
        for k, c in enumerate(channels):
            contributions[:, k] = self._channels[c].part(columns, k)
        return contributions


@dataclass(frozen=True)
class ResidualByPosition:
    """The residual that a discrepancy expects at given positions and speeds of each channel.

    Attributes:
        smooth, discrepancy: its columns of the conditions.
        powers: (K, C) coefficients of `SmoothColumns.powers` that come closest to its other
            columns: a spring is a function of the position too.
    """

    smooth: SmoothColumns
    discrepancy: Discrepancy
    powers: Array

    @staticmethod
    def learnt(
        smooth: SmoothColumns, found: Discrepancy, others: Mapping[Key, Array], powers: Array
    ) -> ResidualByPosition:
        """Fit the powers (K, R, C) of one recording to the other columns (R, C) of it."""
        rest = found.part(others, np.arange(powers.shape[2]))
        by_channel = zip(powers.transpose(2, 1, 0), rest.T, strict=True)
        return ResidualByPosition(
            smooth, found, np.stack([np.linalg.lstsq(x, y)[0] for x, y in by_channel], axis=1)
        )

    def of(self, conditions: Conditions, channels: NDArray[np.int64]) -> Array:
        """The residual (R, K) that is expected at conditions (R, C), in K of the channels."""
        smooth = self.smooth.only(channels)
        channel_conditions = conditions.only(channels)
        waves = self.discrepancy.part(smooth.of(channel_conditions), channels)
        return waves + np.einsum(
            "pc,prc->rc", self.powers[:, channels], smooth.powers(channel_conditions)
        )


Features = Mapping[str, Mapping[str, Array]]
"""Possible causes of a residual by group and name, (R,) each in any unit."""


@dataclass(frozen=True)
class FlexibleModel:
    """The part of a residual that repeats, whatever its cause.

    Attributes:
        held_out: (R, C) each trial predicted by a fit without its fold.
        explained_share: of the mean square beyond the floor; zero or less where nothing repeats.
        alone: the share that each group of features explains without the others.
        foremost: the feature with the strongest linear relation to the residual.
    """

    held_out: Array
    explained_share: float
    alone: Mapping[str, float]
    foremost: str


def flexible_model(
    features: Features,
    conditions: Conditions,
    residual: Array,
    fold: NDArray[np.int64],
    floor: float,
) -> FlexibleModel:
    """A regression of a residual (R, C) on features, and on functions of the conditions.

    `fold` (R,) says which rows are held out together; `floor` is the root mean square of what
    cannot be explained.
    """
    columns: dict[str, dict[Key, Array]] = {group: {} for group in features}
    strength: dict[str, float] = {}
    for group, group_features in features.items():
        for name, values in group_features.items():
            centred = values - values.mean()
            columns[group][group, name] = np.broadcast_to(centred[:, None], residual.shape)
            strength[name] = float(
                ((centred @ residual) ** 2).sum() / max(centred @ centred, _LEAST_SIZE)
            )
    for key, smooth in SmoothColumns.like(conditions).of(conditions).items():
        group = "motion" if "speed" in key[0] else "tension" if key[0] == "load" else "pose"
        columns.setdefault(group, {})[key] = smooth

    def share(prediction: Array) -> float:
        """Share of the mean square beyond the floor."""
        removable = float((residual**2).mean()) - floor**2
        remaining = max(float(((residual - prediction) ** 2).mean()) - floor**2, 0.0)
        return 1.0 - remaining / removable if removable > 0.0 else 0.0

    held_out = Discrepancy(dict(ChainMap(*columns.values())), residual, fold).held_out
    return FlexibleModel(
        held_out,
        share(held_out),
        {
            group: share(Discrepancy(group_columns, residual, fold).held_out)
            for group, group_columns in columns.items()
        },
        max(strength, key=lambda name: strength[name]),
    )


def _fitted(
    columns: Mapping[Key, Array], residual: Array, c: int, fold: NDArray[np.int64]
) -> tuple[_Channel, Array]:
    """The posterior of a channel, and its held-out means (R,)."""
    square = float((residual[:, c] ** 2).mean())
    sizes = {key: float(np.sqrt((column[:, c] ** 2).mean())) for key, column in columns.items()}
    keys = tuple(key for key, size in sizes.items() if size > _LEAST_SIZE * max(sizes.values()))
    zeros = np.zeros(len(residual))
    nothing = _Channel((), zeros[:0], np.zeros((0, 0)), square, square), zeros
    if not keys or not square > 0.0:
        return nothing
    key_sizes = np.array([sizes[key] for key in keys])
    x = np.array([columns[key][:, c] for key in keys]) / key_sizes[:, None]
    y = residual[:, c] / np.sqrt(square)
    group = np.unique([key[0] for key in keys], return_inverse=True)[1]
    precision, scatter = _of_most_evidence(x, y, group)

    def posterior(rows: NDArray[np.bool_]) -> tuple[Array, Array]:
        gram = x[:, rows] @ x[:, rows].T
        moment = x[:, rows] @ y[rows]
        covariance = np.linalg.inv(gram / (CORRELATED * scatter) + np.diag(precision))
        return covariance @ moment / (CORRELATED * scatter), covariance

    held_out = np.zeros_like(y)
    spread = np.zeros_like(y)
    for k in np.unique(fold):
        mean, covariance = posterior(fold != k)
        out = x[:, fold == k]
        held_out[fold == k] = mean @ out
        spread[fold == k] = (out * (covariance @ out)).sum(0) + scatter
    squares_left = (y - held_out) ** 2
    if squares_left.mean() >= 1.0:
        return nothing
    mean, covariance = posterior(np.ones(len(y), dtype=bool))
    unit = key_sizes / np.sqrt(square)
    channel = _Channel(
        keys,
        mean / unit,
        covariance / np.outer(unit, unit),
        square,
        scatter * square,
        max(float((squares_left / spread).mean()), 1.0),
    )
    return channel, held_out * np.sqrt(square)


def _of_most_evidence(x: Array, y: Array, group: NDArray[np.int64]) -> tuple[Array, float]:
    """The precision (K,) of each coefficient's prior, and the variance of the noise.

    Columns (K, R) and values (R,) have a mean square of one.
    """
    gram = x @ x.T / CORRELATED
    moment = x @ y / CORRELATED
    count = len(y) / CORRELATED
    precision = np.full(len(x), float(len(x)))
    scatter = _FIRST_SCATTER
    for _ in range(_ITERATIONS):
        covariance = np.linalg.inv(gram / scatter + np.diag(precision))
        mean = covariance @ moment / scatter
        known = 1.0 - precision * covariance.diagonal()
        known_by_group = np.bincount(group, known)
        size = np.bincount(group, mean**2)
        precision = np.clip(known_by_group / np.maximum(size, _LEAST_SQUARE), *_PRECISIONS)[group]
        square_left = count - 2.0 * moment @ mean + mean @ gram @ mean
        free = max(count - known.sum(), _LEAST_FREE * count)
        scatter = float(max(square_left / free, _LEAST_SCATTER))
    return precision, scatter
