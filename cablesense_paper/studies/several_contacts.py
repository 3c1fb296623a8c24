"""Fig. 13 and 14, section IV-C: several contacts at once, which segments and how hard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.report.style import WIDTH_IN, plain_log_ticks
from cablesense_paper.study import (
    BLACK,
    BLUE,
    DASHES,
    GREEN,
    GREY,
    VERMILION,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

if TYPE_CHECKING:
    from cablesense_training.data.dataset import Dataset
    from cablesense_training.evaluation.metrics import MultiContactMetrics


SAMPLES, QUICK_SAMPLES = 20_480, 2_048
TRAINING_SAMPLES, QUICK_TRAINING_SAMPLES, QUICK_ROUNDS = 50_000, 4_096, 60
_SHIPPED, _TWO_STAGE, _TREES = "shipped model", "two-stage (the paper’s)", "gradient boosting"
_STYLES = {
    _SHIPPED: (BLUE, "o", DASHES[0]),
    _TWO_STAGE: (GREEN, "D", DASHES[2]),
    _TREES: (VERMILION, "^", DASHES[3]),
}
_SHOWN_POINTS = 500


@dataclass(frozen=True, eq=False)
class _Tested:
    touched: NDArray[np.bool_]
    magnitude_n: Array
    metrics: MultiContactMetrics


def run(quick: bool, tell: Tell) -> StudyResult:
    """None to four contacts on the straight arm, answered by the bundled models and by trees."""
    from cablesense_sim.arm import open_arm
    from cablesense_training.data.generation import draw_dataset
    from cablesense_training.evaluation.comparison import (
        MULTI_ARM,
        WEAKEST_MULTI_N,
        multi_protocol,
    )
    from cablesense_training.evaluation.noise_bound import multi_contact_bound_n

    arm = open_arm(MULTI_ARM)
    protocol = multi_protocol(QUICK_SAMPLES if quick else SAMPLES)
    test = draw_dataset(arm, protocol, 20_260_002)
    tell(0.1)
    tested = _models(test)
    tell(0.3)
    training = multi_protocol(QUICK_TRAINING_SAMPLES if quick else TRAINING_SAMPLES)
    tested[_TREES] = _trees(draw_dataset(arm, training, 0), test, quick)
    tell(0.9)
    bound_n = multi_contact_bound_n(test, WEAKEST_MULTI_N)
    alone_n = _alone_mae_n(len(test))
    shipped, two_stage = tested[_SHIPPED].metrics, tested[_TWO_STAGE].metrics
    errors_n = ", ".join(f"{value:.2f}" for value in two_stage.magnitude_mae_n)
    return StudyResult(
        lead=(
            f"Which segments are touched is right in {_percent(two_stage.recognition_accuracy)} "
            f"for the paper’s network and {_percent(shipped.recognition_accuracy)} for the "
            f"shipped model (macro F1 {two_stage.macro_f1:.4f} and {shipped.macro_f1:.4f}), "
            f"contacts from {WEAKEST_MULTI_N:.0f} N up. Force errors fall from point 1 to point "
            f"4, as in the paper: {errors_n} N."
        ),
        pictures=(
            _confusion_picture(test, tested, WEAKEST_MULTI_N),
            _scatter_picture(test, tested),
            _error_picture(tested, bound_n),
        ),
        tables=(_table(tested, bound_n),),
        comparisons=_comparisons(two_stage, alone_n, test, tested[_TWO_STAGE]),
        notes=(
            "Forces are 0 to 60 N on each touched segment from any side; the paper says that its "
            "range is constrained, and not to what. An answer of untouched counts as 0 N.",
            "The noise bound here knows which segments are touched; below it no unbiased "
            "estimator of the magnitudes gets.",
        ),
    )


def _models(test: Dataset) -> dict[str, _Tested]:
    from cablesense_training.evaluation.comparison import MULTI_MODEL, MULTI_PEERS
    from cablesense_training.inference.estimator import MultiEstimator
    from cablesense_training.inference.metadata import find_model

    tested = {}
    for name, model in ((_SHIPPED, MULTI_MODEL), (_TWO_STAGE, MULTI_PEERS["two_stage"])):
        estimator = MultiEstimator.load(find_model(model), test.arm)
        said = estimator.estimate_batch(test.tension_difference_n, test.command_rad)
        tested[name] = _tested(test, said.probabilities > 0.5, said.magnitude_n)
    return tested


def _trees(training: Dataset, test: Dataset, quick: bool) -> _Tested:
    from cablesense_training.baselines import BoostingSettings, MultiBoostingPeer

    settings = BoostingSettings(rounds=QUICK_ROUNDS) if quick else BoostingSettings()
    return _tested(test, *MultiBoostingPeer(training, settings).answer(test))


def _tested(test: Dataset, touched: NDArray[np.bool_], magnitude_n: Array) -> _Tested:
    from cablesense_training.evaluation.comparison import WEAKEST_MULTI_N
    from cablesense_training.evaluation.metrics import multi_contact_metrics

    metrics = multi_contact_metrics(
        test.contacts, test.magnitudes_n, touched, magnitude_n, WEAKEST_MULTI_N
    )
    return _Tested(touched, magnitude_n, metrics)


def _alone_mae_n(samples: int) -> float:
    """Force error of the paper's network for one contact, 0 to 200 N on the straight arm."""
    from cablesense_training.data.generation import draw_dataset
    from cablesense_training.evaluation.comparison import SETTINGS, single_figures
    from cablesense_training.inference.estimator import Estimator
    from cablesense_training.inference.metadata import find_model

    straight = SETTINGS[0]
    test = draw_dataset(straight.arm, straight.protocol(samples), 20_260_002)
    estimator = Estimator.load(find_model(straight.peers["two_stage"]), test.arm)
    return single_figures(estimator, test).errors.magnitude_mae_n


def _comparisons(
    two_stage: MultiContactMetrics, alone_n: float, test: Dataset, tested: _Tested
) -> tuple[Comparison, ...]:
    from cablesense_training.evaluation.comparison import WEAKEST_MULTI_N

    errors_n = np.array(two_stage.magnitude_mae_n)
    mean_n = float(errors_n.mean())
    recognised = 100.0 * two_stage.recognition_accuracy
    wrong = tested.touched != test.contacts
    weak = int((wrong & test.contacts & (test.magnitudes_n < WEAKEST_MULTI_N)).sum())
    share = 100.0 * float(1.0 - wrong.mean())
    return (
        Comparison(
            "two-stage network: segments recognised, contacts from 5 N", recognised, "over 99",
            "%", Agreement.YES if recognised > 99.0 else Agreement.NO,
            "Every segment of every sample counts, those that nothing touches too.",
        ),
        Comparison(
            "two-stage network: segments recognised, all contacts", share, "over 99", "%",
            Agreement.YES if share > 99.0 else Agreement.NO,
            f"Of {int(wrong.sum())} wrong answers {weak} are misses of contacts below "
            f"{WEAKEST_MULTI_N:.0f} N, which look like none; the paper does not say what its "
            "weakest are.",
        ),
        Comparison(
            "two-stage network: force error from point 1 to 4",
            ", ".join(f"{value:.2f}" for value in errors_n) + " N",
            "decreases progressively", "",
            Agreement.YES if (np.diff(errors_n) < 0.0).all() else Agreement.PARTLY,
            "Cables that end further out are pulled by the outer contacts alone; what pulls at "
            "point 1 has to be told from all others’ pull.",
        ),
        Comparison(
            "two-stage network: force error, several contacts against one",
            f"{mean_n:.2f} N against {alone_n:.2f} N", "reduced by the constrained range", "",
            Agreement.YES if mean_n < alone_n else Agreement.NO,
            "Here the error is within a few times what noise leaves, and noise weighs more where "
            "up to eight unknowns are told from twelve tensions than where two are. The paper’s "
            "error is far larger and grows with the force, so a narrower range helps.",
        ),
    )  # fmt: skip


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f} %"


def _table(tested: dict[str, _Tested], bound_n: Array) -> SmallTable:
    rows: list[tuple[str | float, ...]] = [
        (
            name, 100.0 * one.metrics.recognition_accuracy,
            100.0 * one.metrics.all_segments_right, one.metrics.macro_f1,
            *one.metrics.magnitude_mae_n,
        )
        for name, one in tested.items()
    ]  # fmt: skip
    rows.append(("noise bound", "–", "–", "–", *(float(value) for value in bound_n)))
    rows.append(("the paper", "over 99", "–", "–", "–", "–", "–", "–"))
    return SmallTable(
        "None to four contacts on the straight arm, with sensor noise and step; contacts from "
        "5 N.",
        (
            "estimator", "segments right, %", "samples all right, %", "macro F1",
            *(f"force MAE, point {n}, N" for n in range(1, 1 + len(bound_n))),
        ),
        tuple(rows),
    )  # fmt: skip


def _confusion_picture(test: Dataset, tested: dict[str, _Tested], weakest_n: float) -> Picture:
    import matplotlib.pyplot as plt

    from cablesense_paper.contact_tests import draw_confusion
    from cablesense_training.evaluation.metrics import confusion_matrix

    segments = test.contacts.shape[1]
    figure, every = plt.subplots(
        len(tested), segments, figsize=(0.78 * WIDTH_IN, 2.1 * len(tested)), layout="constrained"
    )
    for row, (name, one) in zip(every, tested.items(), strict=True):
        for n, axes in enumerate(row):
            counted = ~test.contacts[:, n] | (test.magnitudes_n[:, n] >= weakest_n)
            counts = confusion_matrix(test.contacts[counted, n], one.touched[counted, n], 2)
            draw_confusion(axes, counts, ("no", "yes"))
            if one is tested[_SHIPPED]:
                axes.set_title(f"point {n + 1}")
            if n == 0:
                axes.set_ylabel(f"{name}\ntouched")
            if one is tested[_TREES]:
                axes.set_xlabel("answered as touched")
    return picture(
        "fig_13_confusion",
        figure,
        "Fig. 13 of the paper: is a point touched, percent of each row; contacts "
        f"from {weakest_n:.0f} N.",
        "Confusion matrices of touched and untouched for each point and estimator",
    )


def _scatter_picture(test: Dataset, tested: dict[str, _Tested]) -> Picture:
    import matplotlib.pyplot as plt

    segments = test.contacts.shape[1]
    figure, every = plt.subplots(
        len(tested), segments, figsize=(WIDTH_IN, 2.3 * len(tested) + 0.3), sharex=True,
        sharey=True, layout="constrained",
    )  # fmt: skip
    for row, (name, one) in zip(every, tested.items(), strict=True):
        for n, axes in enumerate(row):
            touched = np.flatnonzero(test.contacts[:, n])[:_SHOWN_POINTS]
            said_n = np.where(one.touched[touched, n], one.magnitude_n[touched, n], 0.0)
            axes.plot([0.0, 60.0], [0.0, 60.0], color=GREY, lw=1.0)
            axes.plot(test.magnitudes_n[touched, n], said_n, ".", color=_STYLES[name][0], ms=2.5)
            axes.text(
                0.04, 0.96, f"MAE {one.metrics.magnitude_mae_n[n]:.2f} N",
                transform=axes.transAxes, va="top", fontsize=8.5,
            )  # fmt: skip
            axes.grid()
            if one is tested[_SHIPPED]:
                axes.set_title(f"point {n + 1}")
        row[0].set_ylabel(f"{name}\npredicted, N")
    every[0, 0].set(xlim=(0.0, 60.0), ylim=(0.0, 65.0), xticks=(0, 20, 40, 60))
    for axes in every[-1]:
        axes.set_xlabel("actual, N")
    return picture(
        "fig_14_magnitude",
        figure,
        f"Fig. 14 of the paper: predicted against actual force of each contact, {_SHOWN_POINTS} a "
        "panel. MAE: mean absolute error of all contacts from 5 N.",
        "Predicted against actual force for each point and estimator",
    )


def _error_picture(tested: dict[str, _Tested], bound_n: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.72 * WIDTH_IN, 3.1), layout="constrained")
    points: Any = np.arange(1, 1 + len(bound_n))
    for name, one in tested.items():
        colour, mark, dashes = _STYLES[name]
        axes.plot(
            points, one.metrics.magnitude_mae_n, mark, ls=dashes, color=colour, lw=1.6, label=name
        )
    axes.plot(points, bound_n, color=BLACK, ls=(0, (1, 1)), lw=2.0, label="noise bound")
    axes.set(
        xlabel="contact point, 4 is the tip", ylabel="mean absolute error, N (logarithmic)",
        yscale="log", xticks=points,
    )  # fmt: skip
    plain_log_ticks(axes.yaxis)
    axes.grid()
    figure.legend(loc="outside right center")
    return picture(
        "fig_14_error_by_point",
        figure,
        "Fig. 14 of the paper, drawn as error by contact point: it falls towards the tip.",
        "Mean absolute force error by contact point for each estimator and the noise bound",
    )


STUDY = Study(
    name="several_contacts",
    title="Several contacts at once",
    place="Fig. 13 and 14, IV-C",
    order=90,
    quick=f"{QUICK_SAMPLES:,} rather than {SAMPLES:,} samples; trees of {QUICK_ROUNDS} rounds on "
    f"{QUICK_TRAINING_SAMPLES:,} samples rather than 200 on {TRAINING_SAMPLES:,}",
    run=run,
)
