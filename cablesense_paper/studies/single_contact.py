"""Fig. 10 to 12, section IV-B: one contact, every estimator, beside what noise allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_paper.drawing import (
    BLACK,
    BLUE,
    DASHES,
    DOTTED,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    draw_confusion,
    draw_predicted,
    panels,
    plain_ticks,
)
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result, study_size
from cablesense_training.baselines import BoostingBaseline, BoostingSettings
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.comparison import (
    SETTINGS,
    TABLE2_MODELS,
    Evaluation,
    Setting,
    evaluate_answer,
    evaluate_models,
)
from cablesense_training.evaluation.metrics import (
    ContactTruth,
    angle_difference_deg,
)
from cablesense_training.evaluation.noise_bound import NoiseBound, noise_bound

TEST_SEED, TRAIN_SEED = 20_260_002, 0
SHIPPED, TWO_STAGE, TREES = "shipped", "two_stage", "gradient_boosting"
LABELS = {
    SHIPPED: "shipped model",
    "closed_form": "closed form",
    TWO_STAGE: "two-stage (the paper’s)",
    TREES: "gradient boosting",
}
"""Estimators by the names of the comparison; `shipped` is the model that CableSense uses."""

TITLES = {
    "straight": "straight arm (the paper’s)",
    "random_pose": "poses within ±10°",
    "compliant": "compliant arm, poses ±10°",
    "tensions_only": "poses unknown",
    "table2": "three segments, straight",
}
_KNOWN_POSES = ("random_pose", "compliant")
FORCE_EDGES_N = np.array([0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 100.0, 150.0, 200.0])
_BINS = len(FORCE_EDGES_N) - 1

PAPER_DIRECTION_DEG, PAPER_MAE_N, PAPER_RMSE_N = 5.96, 9.97, 14.26
_COLOURS = dict(zip(LABELS, (BLUE, ORANGE, GREEN, VERMILION), strict=True))
_LINES = dict(zip(LABELS, DASHES, strict=True))
_MARKS = dict(zip(LABELS, "osD^", strict=True))
_SHOWN_POINTS = 500


@dataclass(frozen=True, eq=False)
class SettingTest:
    """One setting.

    Attributes:
        name: of the setting, one of `TITLES`.
        truth: of the samples.
        tested: by the names of `LABELS`, those that there are.
        bound: what noise leaves of an efficient unbiased estimator.
        bound_by_force: the same between `FORCE_EDGES_N`.
    """

    name: str
    truth: ContactTruth
    tested: dict[str, Evaluation]
    bound: NoiseBound
    bound_by_force: tuple[NoiseBound, ...]

    def error_by_force_n(self, estimator: str) -> Array:
        """(bins,) mean absolute magnitude error; an answer of no contact counts as 0 N."""
        touched = self.truth.segment > 0
        true_n = self.truth.magnitude_n[touched]
        error = np.abs(self.predicted_n(estimator)[touched] - true_n)
        counts = np.bincount(_bins(true_n), minlength=_BINS)
        sums = np.bincount(_bins(true_n), error, minlength=_BINS)
        return np.asarray(sums / np.maximum(counts, 1))

    def predicted_n(self, estimator: str) -> Array:
        """(B,) magnitudes, 0 N where the answer is no contact."""
        answer = self.tested[estimator].answer
        return np.where(answer.segment > 0, answer.magnitude_n, 0.0)

    def direction_error_deg(self, estimator: str) -> Array:
        """Absolute, of the contacts found."""
        truth, answer = self.truth, self.tested[estimator].answer
        found = (truth.segment > 0) & (answer.segment > 0)
        return np.abs(angle_difference_deg(answer.angle_deg[found], truth.angle_deg[found]))


def all_settings() -> tuple[Setting, ...]:
    """The settings of `cablesense evaluate`, and the three-segment arm of Table II."""
    return (*SETTINGS, Setting("table2", "cdsm_table2", "straight", TABLE2_MODELS))


def answered_setting(
    setting: Setting, samples: int, training_samples: int, boosting: BoostingSettings
) -> SettingTest:
    """All estimators of a setting; trees are grown where there are samples to train on."""
    dataset = draw_dataset(setting.arm, setting.protocol(samples), TEST_SEED)
    tested = evaluate_models(setting.models, dataset)
    if training_samples:
        protocol = setting.protocol(training_samples)
        training = draw_dataset(setting.arm, protocol, TRAIN_SEED)
        trees = BoostingBaseline(training, boosting).answer(dataset)
        tested[TREES] = evaluate_answer(trees, dataset)
    truth = ContactTruth.of(dataset)
    touched = np.flatnonzero(truth.segment > 0)
    bins = _bins(truth.magnitude_n[touched])
    by_force = tuple(noise_bound(dataset.select(touched[bins == i])) for i in range(_BINS))
    return SettingTest(setting.name, truth, tested, noise_bound(dataset), by_force)


def answered_as_the_paper_tests(setting: Setting, samples: int) -> dict[str, Evaluation]:
    """The bundled models on samples without noise, each of them a contact."""
    protocol = SingleContact(
        samples=samples, pose=setting.pose, noise=False, no_contact_fraction=0.0
    )
    return evaluate_models(setting.models, draw_dataset(setting.arm, protocol, TEST_SEED))


def _bins(magnitude_n: Array) -> NDArray[np.int64]:
    return np.minimum(np.searchsorted(FORCE_EDGES_N, magnitude_n, side="right") - 1, _BINS - 1)


def run(quick: bool, progress: Progress) -> StudyResult:
    """Fresh samples in every setting, answered by every bundled model and by trees grown here."""
    size = study_size("single_contact", quick)
    settings, tests = all_settings(), []
    for number, setting in enumerate(settings):
        trees = number == 0 or size["trees_everywhere"]
        aware = setting.name in _KNOWN_POSES and size["trees_everywhere"]
        tests.append(
            answered_setting(
                setting,
                size["samples"],
                size["training_samples"] if trees else 0,
                BoostingSettings(rounds=size["rounds"], pose_aware=aware),
            )
        )
        progress(0.85 * (number + 1) / len(settings))
    like_paper = answered_as_the_paper_tests(settings[0], size["samples"])
    progress(0.9)
    first = tests[0]
    grown = [test.error_by_force_n(TWO_STAGE)[[3, -1]] for test in tests[:2]]
    growth = [float(strong / weak) for weak, strong in grown]
    numbers = {
        **{name: _main_metrics(first.tested[name]) for name in (SHIPPED, TWO_STAGE)},
        "bound": first.bound,
        "first": TITLES[first.name],
        "estimators": len(first.tested),
        "shown_points": _SHOWN_POINTS,
        "like_paper": [
            *((LABELS[name], *_row(one, f1=False)) for name, one in like_paper.items()),
            ("the paper", "over 98", PAPER_DIRECTION_DEG, PAPER_MAE_N, PAPER_RMSE_N),
        ],
        "settings": [_setting_table(test) for test in tests],
        **_as_the_paper(like_paper[TWO_STAGE]),
        **_misclassified(first.tested[TWO_STAGE]),
        **_outliers(first.direction_error_deg(TWO_STAGE)),
        "growth": growth,
        "grows": Agreement.of_parts([ratio > 1.5 for ratio in growth]),
    }
    figures = {
        "fig_10_confusion": confusion_figure(first),
        "fig_11_direction": direction_figure(tests),
        "fig_12_magnitude": magnitude_figure(tests),
        "fig_12_error_against_force": error_figure(tests),
        "fig_10_other_settings": confusion_grid_figure(tests[1:]),
    }
    return study_result("single_contact", numbers, figures)


def _main_metrics(tested: Evaluation) -> dict[str, float]:
    errors = tested.metrics.errors
    return {
        "accuracy": 100.0 * tested.metrics.contact_accuracy,
        "direction_deg": errors.direction_mae_deg,
        "force_n": errors.magnitude_mae_n,
    }


def _row(tested: Evaluation, f1: bool) -> tuple[float, ...]:
    metrics, errors = tested.metrics, tested.metrics.errors
    return (
        100.0 * metrics.contact_accuracy, *((metrics.macro_f1,) if f1 else ()),
        errors.direction_mae_deg, errors.magnitude_mae_n, errors.magnitude_rmse_n,
    )  # fmt: skip


def _setting_table(test: SettingTest) -> dict[str, Any]:
    bound = test.bound
    limits = (bound.direction_mae_deg, bound.magnitude_mae_n, bound.magnitude_rmse_n)
    return {
        "caption": f"{TITLES[test.name]}, with noise and contact-free samples.".capitalize(),
        "rows": [
            *((LABELS[name], *_row(one, f1=True)) for name, one in test.tested.items()),
            ("noise bound", "–", "–", *limits),
        ],
    }


def _as_the_paper(tested: Evaluation) -> dict[str, Any]:
    """The paper's measures of merit, tested as it tests."""
    accuracy, direction_deg, mae_n, rmse_n = _row(tested, f1=False)
    counts = np.array(tested.metrics.confusion)
    errors = (
        ("direction error, mean absolute", direction_deg, PAPER_DIRECTION_DEG, "°"),
        ("magnitude error, mean absolute", mae_n, PAPER_MAE_N, "N"),
        ("magnitude error, RMS", rmse_n, PAPER_RMSE_N, "N"),
    )
    return {
        "accuracy": accuracy,
        "wrong": int(counts.sum() - np.trace(counts)),
        "missed": int(counts[1:, 0].sum()),
        "errors": [
            dict(zip(("what", "ours", "theirs", "unit"), error, strict=True)) for error in errors
        ],
    }


def _misclassified(tested: Evaluation) -> dict[str, Any]:
    """Where the wrong answers lie."""
    counts = np.array(tested.metrics.confusion)
    classes = np.arange(len(counts))
    apart = np.abs(classes[:, None] - classes[None, :])
    on_arm = (classes[:, None] > 0) & (classes[None, :] > 0) & (apart > 0)
    next_to, other = int(counts[on_arm & (apart == 1)].sum()), int(counts[on_arm].sum())
    if other == 0:
        agreement, why = Agreement.PARTLY, "No contact is mistaken for one on another segment."
    elif next_to > 0.5 * other:
        agreement, why = Agreement.YES, "Of those on another segment, most are on the next one."
    else:
        agreement, why = Agreement.NO, "Wrong segments are not mostly the next ones."
    return {
        "between": int(counts[1:, 0].sum() + counts[0, 1:].sum()),
        "next_to": next_to,
        "further": other - next_to,
        "adjacent": agreement,
        "adjacent_why": why,
    }


def _outliers(error_deg: Array) -> dict[str, Any]:
    within, most = float(np.quantile(error_deg, 0.95)), float(error_deg.max())
    outlying = Agreement.YES if most > 5.0 * within else Agreement.PARTLY
    return {"within_deg": within, "most_deg": most, "outlying": outlying}


def confusion_figure(test: SettingTest) -> Any:
    """Fig. 10 for one setting, its estimators side by side."""
    count = len(test.tested)
    figure, every = panels(1, count, 3.1, width=count / len(LABELS), grid="", sharey=True)
    for axes, (name, tested) in zip(every[0], test.tested.items(), strict=True):
        _draw_segments(axes, tested, LABELS[name])
    every[0, 0].set_ylabel("true segment")
    return figure


def confusion_grid_figure(tests: Sequence[SettingTest]) -> Any:
    """Fig. 10 for other settings, one a row."""
    names = _present(tests)
    figure, every = _grid(tests, names, 2.45, "")
    for row, test in zip(every, tests, strict=True):
        for axes, name in zip(row, names, strict=True):
            if name in test.tested:
                _draw_segments(axes, test.tested[name], LABELS[name] if test is tests[0] else "")
        row[0].set_ylabel(f"{TITLES[test.name]}\ntrue segment")
    return figure


def direction_figure(tests: Sequence[SettingTest]) -> Any:
    """Fig. 11: shares of contacts by absolute direction error, on a logarithmic axis."""
    figure, every = panels(len(tests), 1, 1.75 * len(tests) + 0.5, sharex=True)
    edges = np.logspace(-3.0, np.log10(180.0), 42)
    for axes, test in zip(every[:, 0], tests, strict=True):
        for name, tested in test.tested.items():
            error = test.direction_error_deg(name)
            share = np.histogram(np.maximum(error, edges[0]), edges)[0] / len(error)
            mean = tested.metrics.errors.direction_mae_deg
            axes.stairs(
                100.0 * share, edges, color=_COLOURS[name], ls=_LINES[name], lw=1.7,
                label=LABELS[name] if test is tests[0] else "",
            )  # fmt: skip
            axes.plot(mean, 0.0, _MARKS[name], color=_COLOURS[name], ms=7, clip_on=False, zorder=4)
        axes.axvline(test.bound.direction_mae_deg, color=BLACK, ls=DOTTED, lw=1.4)
        axes.axvline(PAPER_DIRECTION_DEG, color=BLACK, ls="--", lw=1.2)
        axes.set(title=TITLES[test.name], ylabel="contacts, %", xscale="log", ylim=(0.0, None))
    first, lowest = every[0, 0], every[-1, 0]
    plain_ticks(lowest.xaxis)
    lowest.set(xlabel="absolute direction error, ° (logarithmic)", xlim=(edges[0], edges[-1]))
    first.plot([], [], color=BLACK, ls=DOTTED, label="mean, noise bound")
    first.plot([], [], color=BLACK, ls="--", label="mean, the paper: 5.96°")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def magnitude_figure(tests: Sequence[SettingTest]) -> Any:
    """Fig. 12: predicted against actual magnitude."""
    names = _present(tests)
    figure, every = _grid(tests, names, 2.35, "both")
    ticks = (0, 100, 200)
    for row, test in zip(every, tests, strict=True):
        touched = np.flatnonzero(test.truth.segment > 0)[:_SHOWN_POINTS]
        for axes, name in zip(row, names, strict=True):
            if name not in test.tested:
                continue
            errors = test.tested[name].metrics.errors
            draw_predicted(
                axes, test.truth.magnitude_n[touched], test.predicted_n(name)[touched], 200.0,
                f"MAE {errors.magnitude_mae_n:.2f} N\nRMSE {errors.magnitude_rmse_n:.2f} N",
                _COLOURS[name],
            )  # fmt: skip
            axes.set(xlim=(0.0, 200.0), ylim=(0.0, 215.0), xticks=ticks, yticks=ticks)
            axes.set_title(LABELS[name] if test is tests[0] else "")
        row[0].set_ylabel(f"{TITLES[test.name]}\npredicted, N")
    for axes in every[-1]:
        axes.set_xlabel("actual, N")
    return figure


def error_figure(tests: Sequence[SettingTest]) -> Any:
    """Mean absolute magnitude error against force, beside the noise bound."""
    figure, every = panels(-(-len(tests) // 3), 3, 5.6, sharex=True, sharey=True)
    centre = 0.5 * (FORCE_EDGES_N[1:] + FORCE_EDGES_N[:-1])
    spare = list(every.ravel())[len(tests) :]
    for axes, test in zip(every.ravel(), tests, strict=False):
        for name in test.tested:
            axes.plot(
                centre, test.error_by_force_n(name), _MARKS[name], ls=_LINES[name], ms=4, lw=1.5,
                color=_COLOURS[name], label=LABELS[name],
            )  # fmt: skip
        bound = [part.magnitude_mae_n for part in test.bound_by_force]
        axes.plot(centre, bound, color=BLACK, ls=DOTTED, lw=2.0, label="noise bound")
        axes.axhline(PAPER_MAE_N, color=BLACK, ls="--", lw=1.0, label="the paper’s mean: 9.97 N")
        axes.set(title=TITLES[test.name], yscale="log", xlim=(0.0, 200.0))
        plain_ticks(axes.yaxis)
    for axes in spare:
        axes.set_visible(False)
    figure.supxlabel("force, N", fontsize=9.5)
    figure.supylabel("mean absolute error, N (logarithmic)", fontsize=9.5)
    figure.legend(*every[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _present(tests: Sequence[SettingTest]) -> list[str]:
    """Estimators that any of the settings has."""
    return [name for name in LABELS if any(name in test.tested for test in tests)]


def _grid(
    tests: Sequence[SettingTest], names: list[str], height_in: float, grid: str
) -> tuple[Any, Any]:
    """A row a setting, a column an estimator; panels of absent estimators are marked so."""
    figure, every = panels(
        len(tests), len(names), height_in * len(tests) + 0.3, width=len(names) / len(LABELS),
        grid=grid,
    )  # fmt: skip
    for row, test in zip(every, tests, strict=True):
        for axes, name in zip(row, names, strict=True):
            if name not in test.tested:
                axes.axis("off")
                place = {"ha": "center", "va": "center", "transform": axes.transAxes}
                axes.text(0.5, 0.5, "none", color=GREY, **place)
    return figure, every


def _draw_segments(axes: Any, tested: Evaluation, title: str) -> None:
    counts = tested.metrics.confusion
    draw_confusion(axes, counts, ["–", *(str(n + 1) for n in range(len(counts) - 1))])
    right = f"{100.0 * tested.metrics.contact_accuracy:.2f} % right"
    axes.set(title="\n".join(filter(None, (title, right))), xlabel="answered segment")
