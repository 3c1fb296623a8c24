"""Fig. 13 and 14, section IV-C: several contacts at once, which segments and how hard."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_sim.arm import open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.evaluation.comparison import (
    MULTI_ARM,
    SETTINGS,
    TWO_STAGE,
    WEAKEST_MULTI_N,
    MultiEvaluation,
    evaluate_models,
    evaluate_multi_answer,
    evaluate_multi_models,
    multi_protocol,
)
from cablesense_training.evaluation.metrics import confusion_matrix, multi_contact_bound_n
from paper.boosting import BoostingSettings, MultiBoostingBaseline
from paper.drawing import BLACK, DOTTED, confusion_grid, one_panel, plain_log_ticks
from paper.studies.single_contact import LABELS, STYLES, TEST_SEED, TRAIN_SEED, TREES
from paper.study import Figures, Numbers, Progress


def several_contacts(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """None to four contacts on the straight arm, answered by the paper's network and by trees."""
    arm = open_arm(MULTI_ARM)
    test = draw_dataset(arm, multi_protocol(size["samples"]), TEST_SEED)
    answers = evaluate_multi_models(test)
    progress(0.3)
    training = draw_dataset(arm, multi_protocol(size["training_samples"]), TRAIN_SEED)
    trees = MultiBoostingBaseline(training, BoostingSettings(rounds=size["rounds"]))
    answers[TREES] = evaluate_multi_answer(*trees.answer(test), test)
    progress(0.9)
    bound_n = multi_contact_bound_n(test, WEAKEST_MULTI_N)
    two_stage = answers[TWO_STAGE].metrics
    wrong = answers[TWO_STAGE].touched != test.contacts
    weak = wrong & test.contacts & (test.magnitudes_n < WEAKEST_MULTI_N)
    errors_n = np.array(two_stage.magnitude_mae_n)
    # one contact, 0 to 200 N on the straight arm
    setting = SETTINGS[0]
    alone = draw_dataset(setting.arm, setting.protocol(len(test)), TEST_SEED)
    of_one = evaluate_models({TWO_STAGE: setting.models[TWO_STAGE]}, alone)[TWO_STAGE]
    mean_n = float(errors_n.mean())
    alone_n = of_one.metrics.errors.magnitude_mae_n
    metrics = {name: one.metrics for name, one in answers.items()}
    numbers = {
        "weakest_n": WEAKEST_MULTI_N,
        "recognised": 100.0 * two_stage.recognition_accuracy,
        "f1": two_stage.macro_f1,
        "errors": ", ".join(f"{value:.2f}" for value in errors_n),
        "all_recognised": 100.0 * float(1.0 - wrong.mean()),
        "wrong": wrong.sum(),
        "weak": weak.sum(),
        "decreases": (np.diff(errors_n) < 0.0).all(),
        "mean_n": mean_n,
        "alone_n": alone_n,
        "reduced": mean_n < alone_n,
        "rows": [
            *(
                (
                    LABELS[name],
                    100.0 * one.recognition_accuracy,
                    100.0 * one.all_segments_right,
                    one.macro_f1,
                    *one.magnitude_mae_n,
                )
                for name, one in metrics.items()
            ),
            ("noise bound", "–", "–", "–", *map(float, bound_n)),
            ("the paper", "over 99", "–", "–", *("–" for _ in bound_n)),
        ],
    }
    return numbers, {
        "fig_13_confusion": _confusion_figure(test, answers),
        "fig_14_error_by_point": _error_figure(answers, bound_n),
    }


def _confusion_figure(test: Dataset, answers: dict[str, MultiEvaluation]) -> Any:
    counted = ~test.contacts | (test.magnitudes_n >= WEAKEST_MULTI_N)
    matrices = {
        LABELS[name]: [
            confusion_matrix(truth[which], answered[which], 2)
            for truth, answered, which in zip(
                test.contacts.T, one.touched.T, counted.T, strict=True
            )
        ]
        for name, one in answers.items()
    }
    points = [f"point {n + 1}" for n in range(test.contacts.shape[1])]
    return confusion_grid(matrices, points, ("no", "yes"), 2.1)


def _error_figure(answers: dict[str, MultiEvaluation], bound_n: Array) -> Any:
    figure, axes = one_panel(3.1, width=0.72)
    points = np.arange(1, 1 + len(bound_n))
    for name, one in answers.items():
        axes.plot(points, one.metrics.magnitude_mae_n, **STYLES[name], lw=1.6, label=LABELS[name])
    axes.plot(points, bound_n, color=BLACK, ls=DOTTED, lw=2.0, label="noise bound")
    axes.set(
        xlabel="contact point, 4 is the tip",
        ylabel="mean absolute error, N (logarithmic)",
        yscale="log",
        xticks=points,
    )
    plain_log_ticks(axes.yaxis)
    figure.legend(loc="outside right center")
    return figure
