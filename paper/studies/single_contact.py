"""Fig. 10 to 12, section IV-B: one contact, every estimator, and the limit that noise sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binned_statistic

from cablesense_base import Array
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.comparison import (
    SETTINGS,
    SHIPPED,
    TABLE2_MODELS,
    TWO_STAGE,
    Evaluation,
    Setting,
    evaluate_answer,
    evaluate_models,
)
from cablesense_training.evaluation.metrics import (
    ContactTruth,
    NoiseBound,
    angle_difference_deg,
    noise_bound,
)
from paper.boosting import BoostingBaseline, BoostingSettings
from paper.drawing import (
    BLACK,
    BLUE,
    DASHES,
    DOTTED,
    GREEN,
    VERMILION,
    confusion_grid,
    panels,
    plain_ticks,
)
from paper.study import Figures, Numbers, Progress

TEST_SEED = 20_260_002
TRAIN_SEED = 0
TREES = "gradient_boosting"
LABELS = {
    SHIPPED: "shipped estimator",
    TWO_STAGE: "two-stage (the paper’s)",
    TREES: "gradient boosting",
}
"""Estimators by the names of the comparison; `shipped` is the one that CableSense uses."""

STYLES = {
    name: {"color": colour, "marker": mark, "ls": dashes}
    for name, colour, mark, dashes in zip(
        LABELS, (BLUE, GREEN, VERMILION), "oD^", DASHES, strict=False
    )
}
TITLES = {
    "straight": "straight arm (the paper’s)",
    "random_pose": "poses within ±10°",
    "compliant": "compliant arm, poses ±10°",
    "table2": "three segments, straight",
}
ALL_SETTINGS = (*SETTINGS, Setting("table2", "cdsm_table2", "straight", TABLE2_MODELS))
"""The settings of `cablesense evaluate`, and the three-segment arm of Table II."""

_KNOWN_POSES = ("random_pose", "compliant")
FORCE_EDGES_N = np.array([0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 100.0, 150.0, 200.0])
PAPER_DIRECTION_DEG = 5.96
PAPER_MAE_N = 9.97
PAPER_RMSE_N = 14.26


@dataclass(frozen=True, eq=False)
class SettingTest:
    """One setting of `TITLES`, with those estimators of `LABELS` that there are.

    The bound is the error that noise leaves to an efficient unbiased estimator, of all
    contacts and of those between `FORCE_EDGES_N`.
    """

    name: str
    truth: ContactTruth
    tested: dict[str, Evaluation]
    bound: NoiseBound
    bound_by_force: tuple[NoiseBound, ...]

    def error_by_force_n(self, estimator: str) -> Array:
        """(bins,) mean absolute magnitude error; an answer of no contact counts as 0 N."""
        touched = self.truth.segment > 0
        answer = self.tested[estimator].answer
        true_n = self.truth.magnitude_n[touched]
        error_n = np.abs(np.where(answer.segment > 0, answer.magnitude_n, 0.0)[touched] - true_n)
        return np.asarray(binned_statistic(true_n, error_n, "mean", FORCE_EDGES_N).statistic)

    def direction_error_deg(self, estimator: str) -> Array:
        """Absolute, of the contacts found."""
        truth = self.truth
        answer = self.tested[estimator].answer
        hits = (truth.segment > 0) & (answer.segment > 0)
        return np.abs(angle_difference_deg(answer.angle_deg[hits], truth.angle_deg[hits]))


def answered_setting(
    setting: Setting, samples: int, training_samples: int, boosting: BoostingSettings
) -> SettingTest:
    """All estimators of a setting; trees are grown where there are samples to train on."""
    dataset = draw_dataset(setting.arm, setting.protocol(samples), TEST_SEED)
    tested = evaluate_models(setting.models, dataset)
    if training_samples:
        training = draw_dataset(setting.arm, setting.protocol(training_samples), TRAIN_SEED)
        trees = BoostingBaseline(training, boosting).answer(dataset)
        tested[TREES] = evaluate_answer(trees, dataset)
    truth = ContactTruth.of(dataset)
    touched = np.flatnonzero(truth.segment > 0)
    bins = np.digitize(truth.magnitude_n[touched], FORCE_EDGES_N[1:-1])
    by_force = (dataset.select(touched[bins == i]) for i in range(len(FORCE_EDGES_N) - 1))
    return SettingTest(
        setting.name, truth, tested, noise_bound(dataset), tuple(map(noise_bound, by_force))
    )


def single_contact(
    size: Numbers, progress: Progress, settings: Sequence[Setting] = ALL_SETTINGS
) -> tuple[Numbers, Figures]:
    """Fresh samples in every setting, answered by every bundled model and by trees grown here."""
    tests = []
    for number, setting in enumerate(settings):
        trees = number == 0 or size["trees_everywhere"]
        aware = setting.name in _KNOWN_POSES and size["trees_everywhere"]
        boosting = BoostingSettings(rounds=size["rounds"], pose_aware=aware)
        training_samples = size["training_samples"] if trees else 0
        tests.append(answered_setting(setting, size["samples"], training_samples, boosting))
        progress(0.85 * (number + 1) / len(settings))
    as_tested = SingleContact(
        samples=size["samples"], pose=settings[0].pose, noise=False, no_contact_fraction=0.0
    )
    clean = draw_dataset(settings[0].arm, as_tested, TEST_SEED)
    like_paper = evaluate_models(settings[0].models, clean)
    progress(0.9)
    first = tests[0]
    off_deg = first.direction_error_deg(TWO_STAGE)
    within_deg = float(np.quantile(off_deg, 0.95))
    most_deg = float(off_deg.max())
    by_force_n = [test.error_by_force_n(TWO_STAGE) for test in tests[:2]]
    growth = [float(error_n[-1] / error_n[3]) for error_n in by_force_n]
    numbers = {
        **{name: _errors(first.tested[name]) for name in (SHIPPED, TWO_STAGE)},
        "bound": first.bound,
        "first": TITLES[first.name],
        "estimators": len(first.tested),
        "like_paper": [
            *((LABELS[name], *_errors(one).values()) for name, one in like_paper.items()),
            ("the paper", "over 98", PAPER_DIRECTION_DEG, PAPER_MAE_N, PAPER_RMSE_N),
        ],
        "settings": [_setting_table(test) for test in tests],
        **_as_the_paper(like_paper[TWO_STAGE]),
        **_misclassified(first.tested[TWO_STAGE]),
        "within_deg": within_deg,
        "most_deg": most_deg,
        "outlying": most_deg > 5.0 * within_deg,
        "growth": growth,
        "grows": [ratio > 1.5 for ratio in growth],
    }
    matrices = {name: one.metrics.confusion for name, one in first.tested.items()}
    classes = ["–", *map(str, range(1, len(matrices[SHIPPED])))]
    labels = [LABELS[name] for name in matrices]
    fig_10 = confusion_grid({"segment": list(matrices.values())}, labels, classes, 2.5)
    return numbers, {
        "fig_10_confusion": fig_10,
        "fig_11_direction": direction_figure(tests),
        "fig_12_error_against_force": error_figure(tests),
    }


def _errors(tested: Evaluation) -> dict[str, float]:
    metrics = tested.metrics
    errors = tested.metrics.errors
    return {
        "accuracy": 100.0 * metrics.contact_accuracy,
        "direction_deg": errors.direction_mae_deg,
        "force_n": errors.magnitude_mae_n,
        "force_rmse_n": errors.magnitude_rmse_n,
    }


def _setting_table(test: SettingTest) -> dict[str, Any]:
    rows: list[tuple[str | float, ...]] = []
    for name, one in test.tested.items():
        accuracy, *errors = _errors(one).values()
        rows.append((LABELS[name], accuracy, one.metrics.macro_f1, *errors))
    bound = test.bound
    limits = (bound.direction_mae_deg, bound.magnitude_mae_n, bound.magnitude_rmse_n)
    caption = f"{TITLES[test.name]}, with noise and contact-free samples.".capitalize()
    return {"caption": caption, "rows": [*rows, ("noise bound", "–", "–", *limits)]}


def _as_the_paper(tested: Evaluation) -> dict[str, Any]:
    """The paper's measures of merit, tested as it tests."""
    accuracy, *ours = _errors(tested).values()
    counts = np.array(tested.metrics.confusion)
    theirs = (
        ("direction error, mean absolute", PAPER_DIRECTION_DEG, "°"),
        ("magnitude error, mean absolute", PAPER_MAE_N, "N"),
        ("magnitude error, RMS", PAPER_RMSE_N, "N"),
    )
    return {
        "accuracy": accuracy,
        "wrong": int(counts.sum() - np.trace(counts)),
        "missed": int(counts[1:, 0].sum()),
        "errors": [
            {"what": what, "ours": our, "theirs": paper, "unit": unit}
            for our, (what, paper, unit) in zip(ours, theirs, strict=True)
        ],
    }


def _misclassified(tested: Evaluation) -> dict[str, Any]:
    """Where the wrong answers lie."""
    counts = np.array(tested.metrics.confusion)
    on_arm = counts[1:, 1:]
    next_to = int(np.trace(on_arm, 1) + np.trace(on_arm, -1))
    other = int(on_arm.sum() - np.trace(on_arm))
    if other == 0:
        agreement = "partly"
        why = "No contact is mistaken for one on another segment."
    elif next_to > 0.5 * other:
        agreement = "yes"
        why = "Of those on another segment, most are on the next one."
    else:
        agreement = "no"
        why = "Wrong segments are not mostly the next ones."
    return {
        "between": int(counts[1:, 0].sum() + counts[0, 1:].sum()),
        "next_to": next_to,
        "further": other - next_to,
        "adjacent": agreement,
        "adjacent_why": why,
    }


def direction_figure(tests: Sequence[SettingTest]) -> Any:
    """Fig. 11: shares of contacts by absolute direction error, on a logarithmic axis."""
    figure, grid_axes = panels(len(tests), 1, 1.75 * len(tests) + 0.5, sharex=True)
    edges = np.logspace(-3.0, np.log10(180.0), 42)
    for axes, test in zip(grid_axes[:, 0], tests, strict=True):
        for name, tested in test.tested.items():
            error = test.direction_error_deg(name)
            share = np.histogram(np.maximum(error, edges[0]), edges)[0] / len(error)
            mean = tested.metrics.errors.direction_mae_deg
            style = STYLES[name]
            axes.stairs(
                100.0 * share,
                edges,
                color=style["color"],
                ls=style["ls"],
                lw=1.7,
                label=LABELS[name] if test is tests[0] else "",
            )
            axes.plot(mean, 0.0, **style, ms=7, clip_on=False, zorder=4)
        axes.axvline(test.bound.direction_mae_deg, color=BLACK, ls=DOTTED, lw=1.4)
        axes.axvline(PAPER_DIRECTION_DEG, color=BLACK, ls="--", lw=1.2)
        axes.set(title=TITLES[test.name], ylabel="contacts, %", xscale="log", ylim=(0.0, None))
    first = grid_axes[0, 0]
    lowest = grid_axes[-1, 0]
    plain_ticks(lowest.xaxis)
    lowest.set(xlabel="absolute direction error, ° (logarithmic)", xlim=(edges[0], edges[-1]))
    first.plot([], [], color=BLACK, ls=DOTTED, label="mean, noise bound")
    first.plot([], [], color=BLACK, ls="--", label="mean, the paper: 5.96°")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def error_figure(tests: Sequence[SettingTest]) -> Any:
    """Mean absolute magnitude error against force, with the noise bound."""
    figure, grid_axes = panels(-(-len(tests) // 3), 3, 5.6, sharex=True, sharey=True)
    centre = 0.5 * (FORCE_EDGES_N[1:] + FORCE_EDGES_N[:-1])
    for axes, test in zip(grid_axes.ravel(), tests, strict=False):
        for name in test.tested:
            errors_n = test.error_by_force_n(name)
            axes.plot(centre, errors_n, **STYLES[name], ms=4, lw=1.5, label=LABELS[name])
        bound = [part.magnitude_mae_n for part in test.bound_by_force]
        axes.plot(centre, bound, color=BLACK, ls=DOTTED, lw=2.0, label="noise bound")
        axes.axhline(PAPER_MAE_N, color=BLACK, ls="--", lw=1.0, label="the paper’s mean: 9.97 N")
        axes.set(title=TITLES[test.name], yscale="log", xlim=(0.0, 200.0))
        plain_ticks(axes.yaxis)
    for axes in grid_axes.ravel()[len(tests) :]:
        axes.set_visible(False)
    figure.supxlabel("force, N", fontsize=9.5)
    figure.supylabel("mean absolute error, N (logarithmic)", fontsize=9.5)
    figure.legend(
        *grid_axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3
    )
    return figure
