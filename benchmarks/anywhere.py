"""The bars of contacts anywhere: a trained model against the Cramér-Rao bound and baselines.

    python benchmarks/anywhere.py [--samples 10000] [--untouched 150000] [--seed 9001] [--write]

For each arm a model is trained (`cablesense train --network anywhere`), then judged on fresh
samples of the straight arm and in poses within 10 degrees: one contact, or two in 15 %, anywhere
along the reach, and many samples of the untouched arm. Baselines answer the same samples.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import harness
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from cablesense_base import Array
from cablesense_sim.arm import open_arm
from cablesense_sim.contact_location import AXIAL_STD_N, TorqueBalance, locate, locate_two
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import AnywhereContact, Pose
from cablesense_training.evaluation.anywhere import (
    AnywhereMetrics,
    LocatedContacts,
    anywhere_metrics,
    bound_covariance,
    commanded_profile,
    four_points,
    touched,
)
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.model_training import draw_training_data, recipe_for, train_model


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
PARTICLES, ROUNDS = 200, 12
FIRST_STEP, LAST_STEP = 0.2, 1e-3
"""Diffusion of particles in the first and in the last round, as shares of a segment's reach."""
SAMPLES_AT_ONCE = 1000


def trained(name: str, seed: int) -> AnywhereEstimator:
    """A model of an arm, as `cablesense train --network anywhere` makes it."""
    options = {"pose": "random", "pose_range_deg": 10.0}
    settings = recipe_for("anywhere").settings
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        data = draw_training_data(open_arm(name), "anywhere", options, seed)
        train_model(path, "anywhere", data, settings, command="", test_samples=1000)
        return AnywhereEstimator.load(path)


class Judged(NamedTuple):
    """A model's metrics and those of the baselines, by name, on one dataset."""

    model: AnywhereMetrics
    two_by_evidence: float
    baselines: dict[str, AnywhereMetrics]
    answer: LocatedContacts
    dataset: Dataset


def judged(name: str, pose: Pose, estimator: AnywhereEstimator, count: int, seed: int) -> Judged:
    """Fresh samples of an arm, without untouched ones."""
    arm, forces = open_arm(name), ARMS[name]
    protocol = AnywhereContact(
        samples=count,
        pose=pose,
        force_low_n=forces.low_n,
        force_high_n=forces.high_n,
        no_contact_fraction=0.0,
    )
    dataset = draw_dataset(arm, protocol, seed)
    balance, _ = estimator.balance_batch(dataset.tension_difference_n, dataset.command_rad)
    one = locate(balance, estimator.reach_m, estimator.surface)
    two = dataset.contacts.sum(axis=1) == 2
    of_two = TorqueBalance(*(part[two] for part in balance))
    pairs = locate_two(of_two, estimator.reach_m, surface=estimator.surface)
    particles = contact_particles(balance, estimator.reach_m, np.random.default_rng(seed))
    points = Estimator.load(find_model(forces.points), arm)
    baselines = {
        "profile at the commanded pose": commanded_profile(dataset),
        "four points": four_points(points, dataset),
        "particle filter": particles,
    }
    answer = LocatedContacts.of(one)
    return Judged(
        anywhere_metrics(dataset, answer, pairs),
        float((pairs.log_evidence > one.log_evidence[two]).mean()),
        {label: anywhere_metrics(dataset, each) for label, each in baselines.items()},
        answer,
        dataset,
    )


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


def contact_particles(
    balance: TorqueBalance, reach: Array, rng: np.random.Generator
) -> LocatedContacts:
    """What a contact particle filter finds from the balance of B samples, within a reach (N, 2).

    Manuelli and Tedrake, Localizing External Contact Using Proprioceptive Sensors: The Contact
    Particle Filter, IROS 2016. A particle is a place on a segment. Its weight is the likelihood of
    the torques under the force that fits them best there; the paper's quadratic programme has the
    solution of least squares here, as forces act on the axis in any direction. Particles are drawn
    anew by their weights and diffuse along the arm, less from round to round.
    """
    count = len(balance.torque_n_m)
    rows = [slice(at, at + SAMPLES_AT_ONCE) for at in range(0, count, SAMPLES_AT_ONCE)]
    parts = [_filtered(TorqueBalance(*(part[at] for part in balance)), reach, rng) for at in rows]
    return LocatedContacts(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _filtered(
    balance: TorqueBalance, reach: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array, Array, Array]:
    count, segments = balance.by_place.shape[:2]
    torques = np.concatenate([balance.by_force_m, balance.by_place], axis=2)
    weighted = torques @ balance.precision[:, None]
    gram = weighted @ np.swapaxes(torques, 2, 3)
    pull = (weighted @ balance.torque_n_m[:, None, :, None])[..., 0]
    every = np.arange(count)[:, None]
    n = np.tile(np.arange(PARTICLES) % segments, (count, 1))
    low, high = reach.T
    place_m = low[n] + (high - low)[n] * rng.random(n.shape)
    for step in np.geomspace(FIRST_STEP, LAST_STEP, ROUNDS):
        gain, _ = _fitting(gram[every, n], pull[every, n], place_m)
        weight = np.exp(0.5 * (gain - gain.max(axis=1, keepdims=True)))
        ends = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
        combs = (np.arange(PARTICLES) + rng.random((count, 1))) / PARTICLES
        drawn = (ends[:, None] < combs[..., None]).sum(axis=2).clip(max=PARTICLES - 1)
        n = n[every, drawn]
        moved = step * (high - low)[n] * rng.normal(size=n.shape)
        place_m = np.clip(place_m[every, drawn] + moved, low[n], high[n])
    gain, force_n = _fitting(gram[every, n], pull[every, n], place_m)
    share = np.stack([(n == k).mean(axis=1) for k in range(segments)], axis=1)
    best = share.argmax(axis=1)
    # the particles of the likeliest segment, by their weights
    own = np.where(n == best[:, None], 0.5 * gain, -np.inf)
    weight = np.exp(own - own.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    normal_n = np.linalg.norm(force_n[..., 1:], axis=-1)
    return (
        best + 1,
        (weight * place_m).sum(axis=1),
        (weight[..., None] * force_n).sum(axis=1),
        (weight * place_m * normal_n).sum(axis=1),
        _interval(place_m, weight),
        _interval(normal_n, weight),
    )


def _fitting(gram: Array, pull: Array, place_m: Array) -> tuple[Array, Array]:
    """Gains (B, P) in chi², and forces (B, P, 3), that fit best at places (B, P)."""
    s = place_m[..., None, None]
    across = gram[..., :3, 3:] + gram[..., 3:, :3]
    information = gram[..., :3, :3] + s * across + s * s * gram[..., 3:, 3:]
    information[..., 0, 0] += AXIAL_STD_N**-2
    pulled = pull[..., :3] + place_m[..., None] * pull[..., 3:]
    force_n = np.linalg.solve(information, pulled[..., None])[..., 0]
    return np.asarray((force_n * pulled).sum(axis=-1)), np.asarray(force_n)


def _interval(values: Array, weight: Array) -> Array:
    """(B, 2) quantiles 2.5 % and 97.5 % of weighted particles (B, P)."""
    order = np.argsort(values, axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    below = np.cumsum(np.take_along_axis(weight, order, axis=1), axis=1)
    at = [(below < share).sum(axis=1).clip(max=values.shape[1] - 1) for share in (0.025, 0.975)]
    return np.take_along_axis(ordered, np.stack(at, axis=1), axis=1)


def _drawn(axes: Axes, found: Judged, title: str) -> None:
    """Median error of the place over the force, and its bound, on segments 2 to 4."""
    single = found.dataset.contacts.sum(axis=1) == 1
    data, answer = found.dataset.select(single), found.answer.select(single)
    segments, places_m, forces_n = touched(data, 1)
    normal_n = np.linalg.norm(forces_n[:, 0, 1:], axis=1)
    bound_mm = 1e3 * np.sqrt(bound_covariance(data, 1)[:, 3, 3])
    off_mm = 1e3 * np.abs(answer.place_m - places_m[:, 0])
    edges = np.geomspace(normal_n.min(), normal_n.max(), FORCE_BINS + 1)
    middle = np.sqrt(edges[1:] * edges[:-1])
    for n in (2, 3, 4):
        own = (segments[:, 0] == n) & (answer.segment == n)
        bins = np.digitize(normal_n, edges[1:-1])
        rows = [own & (bins == k) for k in range(FORCE_BINS)]
        axes.loglog(middle, [np.median(off_mm[at]) for at in rows], "o", color=f"C{n}",
                    label=f"segment {n}")  # fmt: skip
        axes.loglog(middle, [0.6745 * np.median(bound_mm[at]) for at in rows], color=f"C{n}")
    axes.set(title=title, xlabel="normal force, N", ylabel="median error of the place, mm")


def main() -> None:
    """Trains, judges, prints; keeps figures and a picture with `--write`."""
    options = harness.parser(__doc__, "anywhere.json and anywhere.png")
    options.add_argument("--samples", type=int, default=10_000, help="of each arm and pose")
    options.add_argument("--untouched", type=int, default=150_000, help="of each arm")
    options.add_argument("--seed", type=int, default=9001, help="of the samples to judge")
    given = options.parse_args()
    result: dict[str, Any] = {}
    panels, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained")
    bars: dict[str, bool] = {}
    false = untouched = 0
    for row, name in enumerate(ARMS):
        estimator = trained(name, seed=0)
        figures = result.setdefault(name, {})
        for column, (label, pose) in enumerate(POSES.items()):
            found = judged(name, pose, estimator, given.samples, given.seed + 10 * row + column)
            figures[label] = found.model.as_json() | {
                "two_by_evidence": found.two_by_evidence,
                "baselines": {each: m.as_json() for each, m in found.baselines.items()},
            }
            bars |= bars_of(f"{name}, {label}", found.model)
            _drawn(axes[row, column], found, f"{name}, {label}")
        invented = false_contacts(name, estimator, given.untouched, given.seed + 1000 * (row + 1))
        figures["untouched"] = {"samples": given.untouched, "false_contacts": invented}
        false, untouched = false + invented, untouched + given.untouched
    what = f"untouched: {false} false contacts in {untouched}, at most {FALSE_CONTACTS:g} of them"
    bars[what] = false <= FALSE_CONTACTS * untouched
    axes[0, 0].legend(title="lines: the bound")
    result["bars"] = bars
    if given.write:
        panels.savefig(harness.RESULTS / "anywhere.png", dpi=90)
    harness.publish("anywhere.json", result, given, "numpy", "torch", "onnxruntime")


if __name__ == "__main__":
    main()
