"""The law of cable friction beside two references that share no code with it.

    python benchmarks/friction_law.py [--count 200] [--write]

Random cables of two to nine elastic pieces, softer and stiffer, over guides of random grip, pulled
at random with their slack. At every rest of the law a search over all patterns of sticking and
sliding says what the tensions have to be (up to five pieces), and a simulation in time says what
they become along the path between rows (`chain_reference`); the law comes as near to that as its
steps are short. Errors are the largest over rows and pieces, by the range of the history.
"""

from __future__ import annotations

import argparse
from typing import Any

import harness
import numpy as np
from chain_reference import random_history, searched, timed

from cablesense_base import Array
from cablesense_sim.cable_chain import CableChains

ROWS, SUBSTEPS, MOST_SEARCHED = 20, 20, 4
BAR = 0.01


def main() -> None:
    """Compares on random histories; prints errors and bars, keeps them with `--write`."""
    parser = harness.parser(__doc__, "results/friction_law.json")
    parser.add_argument("--count", type=int, default=200, help="cables")
    parser.add_argument("--seed", type=int, default=7, help="of the cables")
    options: argparse.Namespace = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    cases = [random_history(rng, 1 + i % 8, ROWS) for i in range(options.count)]
    found = [tensions_by_law(*case) for case in cases]
    fine = [tensions_by_law(*case[:2], _divided(case[2]))[::SUBSTEPS] for case in cases]
    by_search = [
        _error(tension, searched(*case).tension_n)
        for case, tension in zip(cases, found, strict=True)
        if len(case[1]) <= MOST_SEARCHED
    ]
    course = _timed(cases)
    by_steps, by_rows = (
        [_error(each, expected) for each, expected in zip(tensions, course, strict=True)]
        for tensions in (fine, found)
    )
    lost = [_losses(*case, tension) for case, tension in zip(cases, found, strict=True)]
    slack = sum(bool((tension == 0.0).any()) for tension in found)
    gained_m, gained_nm = (max(values) for values in zip(*lost, strict=True))
    result: dict[str, Any] = {
        **harness.origin("numpy"),
        "cables": len(cases),
        "rows_each": ROWS,
        "with_slack": slack,
        "of_the_range_from_the_search": _summary(by_search),
        "of_the_range_from_the_simulation_in_time": _summary(by_steps),
        "the_same_with_one_step_a_row": _summary(by_rows),
        "cable_gained_or_lost_of_the_stretch": gained_m,
        "work_gained_at_a_guide_of_all_work": gained_nm,
    }
    harness.publish("friction_law.json", result, options)
    harness.print_bars(
        {
            f"from the search by {max(by_search):.1e}, bar {BAR}": max(by_search) <= BAR,
            f"from the simulation by {max(by_steps):.1e}, bar {BAR}": max(by_steps) <= BAR,
            "no cable gained or lost": gained_m < 1e-9,
            "no work gained": gained_nm < 1e-9,
        }
    )


def tensions_by_law(stiffness_n_m: Array, grip: Array, stretch_m: Array) -> Array:
    """(R, P) tensions at the law's rests."""
    limit = grip[None]
    cable = CableChains(1.0 / stiffness_n_m[None], stretch_m[:1], limit, np.zeros_like(limit), 0.0)
    tensions = []
    for row in stretch_m:
        tensions.append(cable.pull(row[None], limit).tensions_n[0])
        cable.settle(row[None], limit)
    return np.array(tensions)


def _divided(stretch_m: Array) -> Array:
    """The rows, each but the first divided into even steps."""
    rows = np.arange((len(stretch_m) - 1) * SUBSTEPS + 1) / SUBSTEPS
    return np.array([np.interp(rows, np.arange(len(stretch_m)), each) for each in stretch_m.T]).T


def _timed(cases: list[tuple[Array, Array, Array]]) -> list[Array]:
    """(R, P) tensions of each cable by the simulation in time; equally long ones side by side."""
    found: dict[int, Array] = {}
    for guides in {len(grip) for _, grip, _ in cases}:
        own = [i for i, case in enumerate(cases) if len(case[1]) == guides]
        stiffness, grip, stretch = (np.stack([cases[i][part] for i in own]) for part in range(3))
        course = timed(stiffness, grip, np.swapaxes(stretch, 0, 1), 4000 * guides).tension_n
        found |= {i: course[:, k] for k, i in enumerate(own)}
    return [found[i] for i in range(len(cases))]


def _error(tension_n: Array, expected_n: Array) -> float:
    return float(np.abs(tension_n - expected_n).max() / np.ptp(expected_n))


def _losses(
    stiffness_n_m: Array, grip: Array, stretch_m: Array, tension_n: Array
) -> tuple[float, float]:
    """Cable out of nowhere, by the whole stretch; work that guides gave, by that put in."""
    taut = np.asarray((tension_n > 0.0).all(axis=1))
    held = tension_n / stiffness_n_m
    missing = np.abs((held - stretch_m).sum(axis=1))[taut] / stretch_m.sum(axis=1)[taut]
    passed = np.cumsum(held - stretch_m, axis=1)[:, :-1]
    work = (np.diff(tension_n, axis=1)[1:] * np.diff(passed, axis=0))[taut[1:] & taut[:-1]]
    put_in = np.abs(tension_n[1:] * np.diff(stretch_m, axis=0)).sum()
    return float(missing.max()), float(-work.min(initial=0.0) / put_in)


def _summary(errors: list[float]) -> dict[str, float]:
    return harness.percentiles(errors, ["median", "95 %", "worst"], 7)


if __name__ == "__main__":
    main()
