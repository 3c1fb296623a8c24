"""The bars of contacts anywhere: the law of an arm that equals its file, against the noise bound.

    python benchmarks/anywhere.py [--samples 10000] [--untouched 150000] [--seed 9001] [--write]

The model of each arm is judged on fresh samples of the straight arm and in poses within 10
degrees: one contact, or two in 15 %, anywhere along the reach, and many samples of the untouched
arm. The arm is exactly that of its file, and known to be: `built_arms.py` has those that are not.
Contacts act anywhere between the axis and the surface, as the law takes them to.
"""

from __future__ import annotations

from typing import Any

import harness
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from rich.progress import track

from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import find_model
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.built_arm import as_described
from cablesense_training.data.protocols import AnywhereContact, Pose
from cablesense_training.evaluation.law import (
    KnownArm,
    LawMetrics,
    StatedContacts,
    Statements,
    TrueContacts,
    bound_std,
    exact_calibration,
    law_metrics,
    true_contacts,
)
from cablesense_training.evaluation.touches import Touches, drawn_touches, touched_readings_n

FORCES_N = {"cdsm": (5.0, 200.0), "cdsm_lab": (5.0, 50.0)}
POSES: dict[str, Pose] = {"straight": "straight", "bent": "random"}
UNTOUCHED_AT_ONCE = 5_000

OVER_BOUND = 1.2
SAME_PLACE = 0.995
COVERAGE = (0.935, 0.965)
ANSWERED = 0.99
FALSE_CONTACTS = 1e-5
FORCE_BINS = 8
HALF_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""


def protocol_of(name: str, pose: Pose, count: int) -> AnywhereContact:
    """Contacts on an arm, without untouched samples."""
    low_n, high_n = FORCES_N[name]
    return AnywhereContact(
        samples=count, pose=pose, force_low_n=low_n, force_high_n=high_n, no_contact_fraction=0.0
    )


class Bench:
    """One arm with its model."""

    def __init__(self, name: str) -> None:
        self.arm: Arm = open_arm(name)
        law = LawModel(find_model(f"{name}_anywhere"), self.arm)
        self.known = KnownArm(law, self.arm, exact_calibration(self.arm))
        self.built = as_described(self.arm)

    def answered(self, protocol: AnywhereContact, seed: int) -> tuple[Touches, Statements]:
        """Samples that the arm bears, and what is stated of them."""
        touches = drawn_touches(self.arm, protocol, seed)
        rng = np.random.default_rng([seed, 1])
        readings = touched_readings_n(self.arm, self.built, touches, rng)
        borne = np.asarray(np.isfinite(readings).all(axis=(0, 2)))
        touches = touches.select(borne)
        return touches, self.known.stated(readings[:, borne], touches.command_rad)

    def false_contacts(self, count: int, seed: int) -> int:
        """How many samples of the untouched arm are answered with a contact."""
        false_contacts = 0
        parts = max(1, count // UNTOUCHED_AT_ONCE)
        for part in track(range(parts), f"{self.arm.name}, untouched"):
            protocol = AnywhereContact(
                samples=min(count, UNTOUCHED_AT_ONCE), pose="random", no_contact_fraction=1.0
            )
            metrics = law_metrics(self.arm, *self.answered(protocol, seed + part))
            false_contacts += metrics.false_contacts
        return false_contacts


def bars_of(where: str, metrics: LawMetrics) -> dict[str, bool]:
    """Which bars the metrics of an arm in straight or bent poses keep."""
    bars: dict[str, bool] = {}

    def bar(what: str, value: float, least: float, most: float) -> None:
        bars[f"{where}: {what}: {value:.4g} in [{least:g}, {most:g}]"] = least <= value <= most

    def shared(name: str, errors: StatedContacts) -> None:
        bar(f"{name} answered", errors.answered, ANSWERED, 1.0)
        bar(f"{name} same place", errors.same_place, SAME_PLACE, 1.0)
        bar(f"{name} coverage of forces", errors.force_coverage95, *COVERAGE)
        bar(f"{name} coverage of places", errors.place_coverage95, COVERAGE[0], 1.0)

    first, *others = metrics.segments
    shared("segment 1", first)
    bar("segment 1 moment, over bound", first.moment_n_m.median_over_bound, 0.0, OVER_BOUND)
    for n, errors in enumerate(others, start=2):
        shared(f"segment {n}", errors)
        for kind, each in (("place", errors.place_mm), ("force", errors.lateral_n)):
            bar(f"segment {n} {kind}, over bound", each.median_over_bound, 0.0, OVER_BOUND)
    return bars


def picture(
    axes: Axes, arm: Arm, truth: TrueContacts, answers: Statements, bound: Any, title: str
) -> None:
    """Median error of the place over the force, and its bound, beyond segment 1."""
    lateral_n = np.hypot(truth.force_n[:, 1], truth.force_n[:, 2])
    joint_m = np.concatenate([[0.0], np.cumsum(mechanism_of(arm).segment_length_m)[:-1]])
    along_m = joint_m[answers.segment - 1] + answers.place_m
    off_mm = 1e3 * np.abs(along_m - joint_m[truth.segment - 1] - truth.place_m)
    edges = np.geomspace(lateral_n.min(), lateral_n.max(), FORCE_BINS + 1)
    middle = np.sqrt(edges[1:] * edges[:-1])
    bins = np.digitize(lateral_n, edges[1:-1])
    for n in range(2, arm.segment_count + 1):
        rows = [(truth.segment == n) & (bins == k) for k in range(FORCE_BINS)]
        errors_mm = [np.median(off_mm[in_bin]) for in_bin in rows]
        bounds_mm = [HALF_NORMAL_MEDIAN * np.median(bound[in_bin, 0]) for in_bin in rows]
        axes.loglog(middle, errors_mm, "o", color=f"C{n}", label=f"segment {n}")
        axes.loglog(middle, bounds_mm, color=f"C{n}")
    axes.set(title=title, xlabel="lateral force, N", ylabel="median error of the place, mm")


def main() -> None:
    """Judges, prints; keeps figures and a picture with `--write`."""
    options = harness.parser(__doc__, "anywhere.json and anywhere.png")
    options.add_argument("--samples", type=int, default=10_000, help="of each arm and pose")
    options.add_argument("--untouched", type=int, default=150_000, help="of each arm")
    options.add_argument("--seed", type=int, default=9001, help="of the samples to judge")
    given = options.parse_args()
    result: dict[str, Any] = {}
    bars: dict[str, bool] = {}
    panels, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained")
    false = 0
    for row, name in enumerate(FORCES_N):
        bench = Bench(name)
        figures = result.setdefault(name, {})
        for column, (label, pose) in enumerate(POSES.items()):
            protocol = protocol_of(name, pose, given.samples)
            touches, statements = bench.answered(protocol, given.seed + 10 * row + column)
            single = np.asarray(touches.contacts.sum(axis=1) == 1)
            alone = touches.select(single)
            bound = bound_std(bench.arm, bench.built.mechanism, alone)
            metrics = law_metrics(bench.arm, touches, statements, bound)
            figures[label] = metrics.as_json()
            bars |= bars_of(f"{name}, {label}", metrics)
            answers = statements.select(single)
            title = f"{name}, {label}"
            picture(axes[row, column], bench.arm, true_contacts(alone), answers, bound, title)
        invented = bench.false_contacts(given.untouched, given.seed + 1000 * (row + 1))
        figures["untouched"] = {"samples": given.untouched, "false_contacts": invented}
        false += invented
    untouched = given.untouched * len(FORCES_N)
    what = f"untouched: {false} false contacts in {untouched}, at most {FALSE_CONTACTS:g} of them"
    bars[what] = false <= FALSE_CONTACTS * untouched
    result["bars"] = bars
    if given.write:
        axes[0, 0].legend(title="lines: the bound")
        panels.savefig(harness.RESULTS / "anywhere.png", dpi=90)
    harness.publish("anywhere.json", result, given, "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
