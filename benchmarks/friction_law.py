"""The law of cable friction compared with a reference that shares no code with it.

    python benchmarks/friction_law.py [--count 200] [--write]

Random cables of two to nine elastic pieces, softer and stiffer, over guides of random grip, pulled
at random with their slack. A search over all patterns of sticking and sliding gives the tensions
at every rest of the law. Errors are the largest over rows and pieces, by the range of the history.

The P pieces of a cable lie between its ends and G = P - 1 guides. On both sides of a guide the
tensions stay within a factor exp(grip) of each other (grip: friction times wrap angle), and cable
passes only at that bound, towards the higher tension. A piece without stretch has no tension.

A history is the stretch (R, P) that the pieces would have had nothing passed any guide: an
actuator that takes in cable adds to that of the first piece, a joint that opens to its own.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import harness
import numpy as np
from scipy.interpolate import interp1d

from cablesense_base import Array
from cablesense_sim.cable_chain import CableChains

ROWS = 20
MOST_GUIDES = 8
BAR = 1e-6
_CLOSE = 1e-9


def main() -> None:
    """Compares on random histories; prints errors and bars, keeps them with `--write`."""
    parser = harness.parser(__doc__, "results/friction_law.json")
    parser.add_argument("--count", type=int, default=200, help="cables")
    parser.add_argument("--seed", type=int, default=7, help="of the cables")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    errors = []
    for i in range(options.count):
        case = random_history(rng, 1 + i % MOST_GUIDES, ROWS)
        tensions = tensions_by_law(*case)
        expected = searched(*case)
        errors.append(float(np.abs(tensions - expected).max() / np.ptp(expected)))
    result: dict[str, Any] = {
        "cables": options.count,
        "of_the_range_from_the_search": harness.percentiles(
            errors, ["median", "95 %", "worst"], 7
        ),
        "bars": {f"from the search by at most {BAR}": max(errors) <= BAR},
    }
    harness.publish("friction_law.json", result, options, "numpy")


def tensions_by_law(stiffness_n_m: Array, grip: Array, stretch_m: Array) -> Array:
    """(R, P) tensions at the law's rests."""
    limit = grip[None]
    cable = CableChains(1.0 / stiffness_n_m[None], stretch_m[:1], limit, np.zeros_like(limit), 0.0)
    tensions = []
    for row in stretch_m:
        tensions.append(cable.pull(row[None], limit).tensions_n[0])
        cable.settle(row[None], limit)
    return np.array(tensions)


def searched(stiffness_n_m: Array, grip: Array, stretch_m: Array) -> Array:
    """(R, P) tensions by the one admissible pattern of the 3^G of sticking, sliding out and in.

    Args:
        stiffness_n_m: (P,) of the pieces.
        grip: (G,) or (R, G).
        stretch_m: (R, P) if nothing passed; the first row's tensions must hold as they are.

    Raises:
        ValueError: no pattern is admissible, or two with different tensions are.
    """
    guides = len(stiffness_n_m) - 1
    passes = np.eye(guides + 1, guides) - np.eye(guides + 1, guides, k=-1)
    patterns = np.array(list(product((0, 1, -1), repeat=guides)))
    passed = np.zeros(guides)
    tensions = []
    for stretch, bound in zip(
        stretch_m, np.broadcast_to(grip, (len(stretch_m), guides)), strict=True
    ):
        if stretch.sum() > 0.0:
            passed, tension = _admissible(stiffness_n_m, passes, patterns, bound, stretch, passed)
        else:  # wherever the slack lies, no piece has tension
            even = stretch.sum() / stiffness_n_m / (1.0 / stiffness_n_m).sum()
            passed = np.cumsum(even - stretch)[:-1]
            tension = np.zeros(guides + 1)
        tensions.append(tension)
    return np.array(tensions)


def _admissible(
    stiffness: Array, passes: Array, patterns: Array, bound: Array, stretch: Array, before: Array
) -> tuple[Array, Array]:
    """Cable passed (G,) and tensions (P,), from the cable passed `before`."""
    stick = patterns == 0
    ratio = np.exp(patterns * bound)
    by_passed = stiffness[:, None] * passes
    unpassed = stiffness * stretch
    slide = by_passed[1:] - ratio[..., None] * by_passed[:-1]
    matrix = np.where(stick[..., None], np.eye(len(bound)), slide)
    right = np.where(stick, before, ratio * unpassed[:-1] - unpassed[1:])
    passed = np.linalg.solve(matrix, right[..., None])[..., 0]
    tension = unpassed + passed @ by_passed.T
    scale_n = np.abs(unpassed).max()
    scale_m = np.abs(unpassed / stiffness).max()
    low, high = np.sort(np.stack([tension[:, 1:], tension[:, :-1]]), axis=0)
    holds = high <= np.exp(bound) * low + _CLOSE * scale_n
    onward = patterns * (passed - before) >= -_CLOSE * scale_m
    taut = low >= -_CLOSE * scale_n
    right_ones = np.flatnonzero((np.where(stick, holds, onward) & taut).all(axis=-1))
    if not len(right_ones):
        raise ValueError("no pattern of sticking and sliding is admissible")
    if np.ptp(tension[right_ones], axis=0).max() > 1e3 * _CLOSE * scale_n:
        raise ValueError("two patterns with different tensions are admissible")
    return passed[right_ones[0]], tension[right_ones[0]]


def random_history(rng: np.random.Generator, guides: int, rows: int) -> tuple[Array, Array, Array]:
    """Stiffness (P,), grips (G,) and stretch (R, P) of a cable that is pulled at random.

    It begins evenly at 50 N. The actuator and each piece move to and fro, by up to three times the
    cable's stretch; in one history of four the cable goes slack where that is enough.
    """
    stiffness = np.exp(rng.uniform(np.log(1e5), np.log(1e6), guides + 1))
    grip = rng.uniform(0.0, 0.5, guides) * rng.choice([1.0, 0.0], guides, p=[0.9, 0.1])
    knots = rng.normal(size=(max(2, rows // 4), guides + 1))
    moments = np.linspace(0.0, len(knots) - 1.0, rows)
    course = interp1d(np.arange(len(knots)), knots, axis=0)(moments)
    course -= course[0]
    lowest = -course.sum(axis=1).min()
    least = rng.choice([0.8, 1.6], p=[0.67, 0.33])
    size = min(3.0 / np.abs(course).max(), least / max(lowest, 1e-9))
    return stiffness, grip, 50.0 * (1.0 / stiffness + (1.0 / stiffness).sum() * size * course)


if __name__ == "__main__":
    main()
