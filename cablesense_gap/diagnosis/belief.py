"""How probable each hypothesis is, given what it leaves unexplained on held-out trials.

The weights fall with a power of what is left beyond the sensors' floor, and by a factor for every
effect that a hypothesis names:

    log w = -κ log(excess) - τ log(s / m) - π_k - ν n,    k effects of n sizes in all,

with s the sum of squares of the m tolerances in standard deviations, taken as m where it is less:
what a careful workshop leaves should not have to be many deviations off,

for tolerances alone, which are out where the gap is plain, with a power κ₀ of its own,

    log w = -κ log(least) - κ₀ log(excess / least) - τ log(s / m),    least = what can be resolved,

and an effect that nobody listed is the hypothesis that a listed one stands in for it, which leaves
a share φ of the gap, and γ floors where the gap is small:

    log w = -κ log √((φ · excess of none)² + (γ σ₀)²) - π_unknown

The few numbers are fitted to simulated cases (`benchmarks/gap_calibration.py`) by their mean log
probability, so that the probabilities mean what they say.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from cablesense_gap.diagnosis.problem import Hypothesis, excess

UNKNOWN = ("unknown",)


@dataclass(frozen=True)
class Calibration:
    """The numbers of the formula above.

    Attributes:
        power: κ.
        none: κ₀, of tolerances alone.
        one: π_1, of naming an effect.
        two: π_2, of naming two.
        size: ν.
        strain: τ.
        unknown: π of naming none that is listed.
        share: φ, what of the gap remains where a listed effect stands in for an unlisted one.
        stand_in: γ, by which a stand-in is off even where the gap is small, in floors.
        floor_share: excess that no hypothesis can do without, as a share of the floor.
    """

    power: float
    none: float
    one: float
    two: float
    size: float
    strain: float
    unknown: float
    share: float
    stand_in: float
    floor_share: float


def bundled_calibration() -> Calibration:
    """That of `calibration.json` beside this file."""
    text = files("cablesense_gap.diagnosis").joinpath("calibration.json").read_text("utf-8")
    return Calibration(**json.loads(text))


@dataclass(frozen=True)
class Belief:
    """A hypothesis, or that of an unlisted effect, with its probability."""

    effects: tuple[str, ...]
    probability: float
    hypothesis: Hypothesis | None


def beliefs(
    hypotheses: Sequence[Hypothesis], floor: float, calibration: Calibration
) -> list[Belief]:
    """Probabilities of all hypotheses and of an unlisted effect, the most probable first.

    `hypotheses` holds that of tolerances alone, which stands for `none`.
    """
    left = np.array([h.held_out_rmse for h in hypotheses])
    counts = np.array([len(h.effects) for h in hypotheses])
    sizes = np.array([h.sizes for h in hypotheses])
    strains = np.array([h.strain for h in hypotheses])
    usual = max(float(len(hypotheses[0].tolerances)), 1.0)
    weights = log_weights(left, counts, sizes, strains, usual, floor, calibration)
    shares = np.exp(weights - weights.max())
    shares /= shares.sum()
    found = [
        Belief(h.effects or ("none",), float(share), h)
        for h, share in zip(hypotheses, shares, strict=False)
    ]
    found.append(Belief(UNKNOWN, float(shares[-1]), None))
    return sorted(found, key=lambda belief: -belief.probability)


def log_weights(
    held_out_rmse: np.ndarray,
    counts: np.ndarray,
    sizes: np.ndarray,
    strains: np.ndarray,
    usual_strain: float,
    floor: float,
    calibration: Calibration,
) -> np.ndarray:
    """Of each hypothesis, and last of an unlisted effect; `counts` 0 marks tolerances alone."""
    c = calibration
    floor_share = c.floor_share * floor
    left = np.array([np.hypot(excess(e**2, floor), floor_share) for e in held_out_rmse])
    least = np.hypot(excess(0.0, floor), floor_share)
    none = left[np.flatnonzero(counts == 0)[0]]
    power = np.where(counts == 0, c.none, c.power)
    penalty = np.array([0.0, c.one, c.two])[counts] + c.size * sizes
    penalty += c.strain * np.log(np.maximum(strains / usual_strain, 1.0))
    stand_in = np.hypot(c.share * none, c.stand_in * floor)
    unknown = -c.power * np.log(stand_in / least) - c.unknown
    return np.append(-power * np.log(left / least) - penalty, unknown)
