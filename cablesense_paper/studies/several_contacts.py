"""Fig. 13 and 14, section IV-C: several contacts at once, which segments and how hard."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import plain_log_ticks
from cablesense_paper.drawing import (
    BLACK,
    BLUE,
    DASHES,
    DOTTED,
    GREEN,
    VERMILION,
    draw_confusion,
    draw_predicted,
    one_panel,
    panels,
)
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result, study_size
from cablesense_sim.arm import open_arm
from cablesense_training.baselines import BoostingSettings, MultiBoostingBaseline
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.evaluation.comparison import (
    MULTI_ARM,
    SETTINGS,
    WEAKEST_MULTI_N,
    MultiEvaluation,
    evaluate_models,
    evaluate_multi_answer,
    evaluate_multi_models,
    multi_protocol,
)
from cablesense_training.evaluation.metrics import (
    confusion_matrix,
)
from cablesense_training.evaluation.noise_bound import multi_contact_bound_n

_TEST_SEED, _TRAIN_SEED = 20_260_002, 0
_SHIPPED, _TWO_STAGE, _TREES = "shipped model", "two-stage (the paper’s)", "gradient boosting"
_STYLES = {
    _SHIPPED: (BLUE, "o", DASHES[0]),
    _TWO_STAGE: (GREEN, "D", DASHES[2]),
    _TREES: (VERMILION, "^", DASHES[3]),
}
_SHOWN_POINTS = 500


def run(quick: bool, progress: Progress) -> StudyResult:
    """None to four contacts on the straight arm, answered by the bundled models and by trees."""
    size = study_size("several_contacts", quick)
    arm = open_arm(MULTI_ARM)
    test = draw_dataset(arm, multi_protocol(size["samples"]), _TEST_SEED)
    progress(0.1)
    bundled = evaluate_multi_models(test).values()
    answers = dict(zip((_SHIPPED, _TWO_STAGE), bundled, strict=True))
    progress(0.3)
    training = draw_dataset(arm, multi_protocol(size["training_samples"]), _TRAIN_SEED)
    trees = MultiBoostingBaseline(training, BoostingSettings(rounds=size["rounds"]))
    answers[_TREES] = evaluate_multi_answer(*trees.answer(test), test)
    progress(0.9)
    bound_n = multi_contact_bound_n(test, WEAKEST_MULTI_N)
    shipped, two_stage = answers[_SHIPPED].metrics, answers[_TWO_STAGE].metrics
    wrong = answers[_TWO_STAGE].touched != test.contacts
    weak = wrong & test.contacts & (test.magnitudes_n < WEAKEST_MULTI_N)
    errors_n = np.array(two_stage.magnitude_mae_n)
    mean_n, alone_n = float(errors_n.mean()), _alone_mae_n(len(test))
    numbers = {
        "weakest_n": WEAKEST_MULTI_N,
        "shown_points": _SHOWN_POINTS,
        "recognised": 100.0 * two_stage.recognition_accuracy,
        "shipped_recognised": 100.0 * shipped.recognition_accuracy,
        "f1": two_stage.macro_f1,
        "shipped_f1": shipped.macro_f1,
        "errors": ", ".join(f"{value:.2f}" for value in errors_n),
        "all_recognised": 100.0 * float(1.0 - wrong.mean()),
        "wrong": wrong.sum(),
        "weak": weak.sum(),
        "decreases": Agreement.YES if (np.diff(errors_n) < 0.0).all() else Agreement.PARTLY,
        "mean_n": mean_n,
        "alone_n": alone_n,
        "reduced": Agreement.YES if mean_n < alone_n else Agreement.NO,
        "rows": _rows(answers, bound_n),
    }
    figures = {
        "fig_13_confusion": _confusion_figure(test, answers),
        "fig_14_magnitude": _magnitude_figure(test, answers),
        "fig_14_error_by_point": _error_figure(answers, bound_n),
    }
    return study_result("several_contacts", numbers, figures)


def _alone_mae_n(samples: int) -> float:
    """Force error of the paper's network for one contact, 0 to 200 N on the straight arm."""
    straight = SETTINGS[0]
    test = draw_dataset(straight.arm, straight.protocol(samples), _TEST_SEED)
    alone = evaluate_models({_TWO_STAGE: straight.models["two_stage"]}, test)[_TWO_STAGE]
    return alone.metrics.errors.magnitude_mae_n


def _rows(answers: dict[str, MultiEvaluation], bound_n: Array) -> list[tuple[str | float, ...]]:
    rows: list[tuple[str | float, ...]] = [
        (
            name, 100.0 * one.metrics.recognition_accuracy,
            100.0 * one.metrics.all_segments_right, one.metrics.macro_f1,
            *one.metrics.magnitude_mae_n,
        )
        for name, one in answers.items()
    ]  # fmt: skip
    rows.append(("noise bound", "–", "–", "–", *(float(value) for value in bound_n)))
    rows.append(("the paper", "over 99", "–", "–", *("–" for _ in bound_n)))
    return rows


def _confusion_figure(test: Dataset, answers: dict[str, MultiEvaluation]) -> Any:
    figure, every = panels(
        len(answers), test.contacts.shape[1], 2.1 * len(answers), width=0.78, grid=""
    )
    for row, (name, one) in zip(every, answers.items(), strict=True):
        for n, axes in enumerate(row):
            counted = ~test.contacts[:, n] | (test.magnitudes_n[:, n] >= WEAKEST_MULTI_N)
            counts = confusion_matrix(test.contacts[counted, n], one.touched[counted, n], 2)
            draw_confusion(axes, counts, ("no", "yes"))
        row[0].set_ylabel(f"{name}\ntouched")
    _label_columns(every, "answered as touched")
    return figure


def _magnitude_figure(test: Dataset, answers: dict[str, MultiEvaluation]) -> Any:
    figure, every = panels(
        len(answers), test.contacts.shape[1], 2.3 * len(answers) + 0.3, sharex=True, sharey=True
    )
    for row, (name, one) in zip(every, answers.items(), strict=True):
        for n, axes in enumerate(row):
            touched = np.flatnonzero(test.contacts[:, n])[:_SHOWN_POINTS]
            predicted_n = np.where(one.touched[touched, n], one.magnitude_n[touched, n], 0.0)
            draw_predicted(
                axes, test.magnitudes_n[touched, n], predicted_n, 60.0,
                f"MAE {one.metrics.magnitude_mae_n[n]:.2f} N", _STYLES[name][0],
            )  # fmt: skip
        row[0].set_ylabel(f"{name}\npredicted, N")
    every[0, 0].set(xlim=(0.0, 60.0), ylim=(0.0, 65.0), xticks=(0, 20, 40, 60))
    _label_columns(every, "actual, N")
    return figure


def _label_columns(every: Any, xlabel: str) -> None:
    for n, (top, bottom) in enumerate(zip(every[0], every[-1], strict=True), start=1):
        top.set_title(f"point {n}")
        bottom.set_xlabel(xlabel)


def _error_figure(answers: dict[str, MultiEvaluation], bound_n: Array) -> Any:
    figure, axes = one_panel(3.1, width=0.72)
    points = np.arange(1, 1 + len(bound_n))
    for name, one in answers.items():
        colour, mark, dashes = _STYLES[name]
        axes.plot(
            points, one.metrics.magnitude_mae_n, mark, ls=dashes, color=colour, lw=1.6, label=name
        )
    axes.plot(points, bound_n, color=BLACK, ls=DOTTED, lw=2.0, label="noise bound")
    axes.set(
        xlabel="contact point, 4 is the tip", ylabel="mean absolute error, N (logarithmic)",
        yscale="log", xticks=points,
    )  # fmt: skip
    plain_log_ticks(axes.yaxis)
    figure.legend(loc="outside right center")
    return figure
