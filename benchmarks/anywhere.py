"""The bars of contacts anywhere: the shipped models against the Cramér-Rao bound and baselines.

    python benchmarks/anywhere.py [--samples 10000] [--untouched 150000] [--seed 9001] [--write]

The model of each arm is judged on fresh samples of the straight arm and in poses within 10
degrees: one contact, or two in 15 %, anywhere along the reach, and many samples of the untouched
arm. Baselines answer the same samples.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import harness
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from cablesense_sim.arm import open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import AnywhereContact, Pose
from cablesense_training.evaluation.anywhere import (
    AnywhereMetrics,
    anywhere_metrics,
    bound_covariance,
    commanded_profile,
    evaluate_anywhere,
    four_points,
    touched,
)
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model


class Range(NamedTuple):
    """Forces on an arm, N, and the model of four points that is compared on it."""

    low_n: float
    high_n: float
    points: str


ARMS = {
    "cdsm": Range(5.0, 200.0, "peers/cdsm_closed_form"),
    "cdsm_lab": Range(5.0, 50.0, "peers/cdsm_lab_closed_form"),
}
POSES: dict[str, Pose] = {"straight": "straight", "bent": "random"}
UNTOUCHED_AT_ONCE = 25_000

OVER_BOUND, PAIRS_OVER_BOUND = 1.2, 1.3
SEGMENT_RIGHT, PAIRS_RIGHT = 0.995, 0.97
COVERAGE = (0.935, 0.965)
FALSE_CONTACTS = 1e-5
FORCE_BINS = 8
HALF_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""


def drawn(name: str, pose: Pose, count: int, seed: int) -> Dataset:
    """Fresh samples of an arm, without untouched ones."""
    protocol = AnywhereContact(
        samples=count,
        pose=pose,
        force_low_n=ARMS[name].low_n,
        force_high_n=ARMS[name].high_n,
        no_contact_fraction=0.0,
    )
    return draw_dataset(open_arm(name), protocol, seed)


def of_baselines(dataset: Dataset) -> dict[str, Any]:
    """The metrics of the baselines, by name."""
    points = Estimator.load(find_model(ARMS[dataset.arm.name].points), dataset.arm)
    answers = {
        "profile at the commanded pose": commanded_profile(dataset),
        "four points": four_points(points, dataset),
    }
    return {label: anywhere_metrics(dataset, each).as_json() for label, each in answers.items()}


def false_contacts(name: str, estimator: AnywhereEstimator, count: int, seed: int) -> int:
    """How many samples of the untouched arm are answered with a contact."""
    arm, found = open_arm(name), 0
    for part in range(max(1, count // UNTOUCHED_AT_ONCE)):
        protocol = AnywhereContact(
            samples=min(count, UNTOUCHED_AT_ONCE), pose="random", no_contact_fraction=1.0
        )
        drawn = draw_dataset(arm, protocol, seed + part)
        located, _ = estimator.locate_batch(drawn.tension_difference_n, drawn.command_rad)
        found += int((located.segment > 0).sum())
    return found


def bars_of(where: str, metrics: AnywhereMetrics) -> dict[str, bool]:
    """Which bars the metrics of an arm in straight or bent poses keep."""
    first, *others = metrics.segments
    bars: dict[str, bool] = {}

    def bar(what: str, value: float, least: float, most: float) -> None:
        bars[f"{where}: {what}: {value:.4g} in [{least:g}, {most:g}]"] = least <= value <= most

    for n, errors in enumerate(others, start=2):
        for kind, each in (("place", errors.place_mm), ("normal force", errors.normal_n)):
            bar(f"segment {n} {kind}, RMS over bound", each.rms_over_bound, 0.0, OVER_BOUND)
            bar(f"segment {n} {kind}, median over bound", each.median_over_bound, 0.0, OVER_BOUND)
        bar(f"segment {n} right, clear of joints", errors.clear_segment_right, SEGMENT_RIGHT, 1.0)
        bar(f"segment {n} coverage of places", errors.place_coverage95, *COVERAGE)
        bar(f"segment {n} coverage of forces", errors.normal_coverage95, *COVERAGE)
    bar("segment 1 moment, RMS over bound", first.moment_n_m.rms_over_bound, 0.0, OVER_BOUND)
    bar("segment 1 coverage of forces", first.normal_coverage95, *COVERAGE)
    if metrics.pairs is not None and metrics.pairs.determined > 0.0:
        pairs = metrics.pairs
        bar("two contacts, segments right", pairs.segments_right, PAIRS_RIGHT, 1.0)
        for kind, each in (("places", pairs.place_mm), ("forces", pairs.normal_n)):
            what = f"two contacts, {kind}"
            bar(f"{what}, RMS over bound", each.rms_over_bound, 0.0, PAIRS_OVER_BOUND)
            bar(f"{what}, median over bound", each.median_over_bound, 0.0, PAIRS_OVER_BOUND)
    return bars


def picture(axes: Axes, estimator: AnywhereEstimator, dataset: Dataset, title: str) -> None:
    """Median error of the place over the force, and its bound, on segments 2 to 4."""
    data = dataset.select(dataset.contacts.sum(axis=1) == 1)
    answer, _ = estimator.locate_batch(data.tension_difference_n, data.command_rad)
    segments, places_m, forces_n = (part[:, 0] for part in touched(data, 1))
    normal_n = np.linalg.norm(forces_n[:, 1:], axis=1)
    bound_mm = 1e3 * np.sqrt(bound_covariance(data, 1)[:, 3, 3])
    off_mm = 1e3 * np.abs(answer.place_m - places_m)
    edges = np.geomspace(normal_n.min(), normal_n.max(), FORCE_BINS + 1)
    middle, bins = np.sqrt(edges[1:] * edges[:-1]), np.digitize(normal_n, edges[1:-1])
    for n in (2, 3, 4):
        own = (segments == n) & (answer.segment == n)
        rows = [own & (bins == k) for k in range(FORCE_BINS)]
        errors_mm = [np.median(off_mm[at]) for at in rows]
        bounds_mm = [HALF_NORMAL_MEDIAN * np.median(bound_mm[at]) for at in rows]
        axes.loglog(middle, errors_mm, "o", color=f"C{n}", label=f"segment {n}")
        axes.loglog(middle, bounds_mm, color=f"C{n}")
    axes.set(title=title, xlabel="normal force, N", ylabel="median error of the place, mm")


def main() -> None:
    """Judges, prints; keeps figures and a picture with `--write`."""
    options = harness.parser(__doc__, "anywhere.json and anywhere.png")
    options.add_argument("--samples", type=int, default=10_000, help="of each arm and pose")
    options.add_argument("--untouched", type=int, default=150_000, help="of each arm")
    options.add_argument("--seed", type=int, default=9001, help="of the samples to judge")
    given = options.parse_args()
    result: dict[str, Any] = {}
    panels, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained")
    bars: dict[str, bool] = {}
    false = 0
    for row, name in enumerate(ARMS):
        estimator = AnywhereEstimator.load(find_model(f"{name}_anywhere"))
        figures = result.setdefault(name, {})
        for column, (label, pose) in enumerate(POSES.items()):
            dataset = drawn(name, pose, given.samples, given.seed + 10 * row + column)
            metrics = evaluate_anywhere(estimator, dataset)
            figures[label] = metrics.as_json() | {"baselines": of_baselines(dataset)}
            bars |= bars_of(f"{name}, {label}", metrics)
            picture(axes[row, column], estimator, dataset, f"{name}, {label}")
        invented = false_contacts(name, estimator, given.untouched, given.seed + 1000 * (row + 1))
        figures["untouched"] = {"samples": given.untouched, "false_contacts": invented}
        false += invented
    untouched = given.untouched * len(ARMS)
    what = f"untouched: {false} false contacts in {untouched}, at most {FALSE_CONTACTS:g} of them"
    bars[what] = false <= FALSE_CONTACTS * untouched
    result["bars"] = bars
    if given.write:
        axes[0, 0].legend(title="lines: the bound")
        panels.savefig(harness.RESULTS / "anywhere.png", dpi=90)
    harness.publish("anywhere.json", result, given, "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
