"""Every single-contact model and its peers on fresh samples, with what noise allows.

The pictures of Fig. 10 to 12, for every setting and estimator.

Confusion matrices as pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base.arrays import Array
from cablesense_gap.report.style import WIDTH_IN
from cablesense_paper.study import (
    BLACK,
    BLUE,
    DASHES,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    Picture,
    picture,
)
from cablesense_training.baselines import BoostingPeer, BoostingSettings
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.comparison import (
    SETTINGS,
    TABLE2_MODELS,
    Setting,
    single_answer,
)
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    angle_difference_deg,
    single_contact_metrics,
)
from cablesense_training.evaluation.noise_bound import NoiseBound, noise_bound
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

TEST_SEED, TRAIN_SEED = 20_260_002, 0
SHIPPED, TREES = "shipped", "gradient_boosting"
ESTIMATORS = (SHIPPED, "closed_form", "two_stage", TREES)
"""By the names of the comparison; `shipped` is the model that CableSense uses."""

LABELS = {
    SHIPPED: "shipped model",
    "closed_form": "closed form",
    "two_stage": "two-stage (the paper’s)",
    TREES: "gradient boosting",
}
TITLES = {
    "straight": "straight arm (the paper’s)",
    "random_pose": "poses within ±10°",
    "compliant": "compliant arm, poses ±10°",
    "tensions_only": "poses unknown",
    "table2": "three segments, straight",
}
FORCE_EDGES_N = np.array([0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 100.0, 150.0, 200.0])


@dataclass(frozen=True, eq=False)
class Tested:
    """One estimator's answers on a setting's samples, and its figures."""

    answer: ContactAnswer
    metrics: SingleContactMetrics


@dataclass(frozen=True, eq=False)
class SettingTest:
    """One setting.

    Attributes:
        name: of the setting, one of `TITLES`.
        truth: of the samples.
        tested: by the names of `ESTIMATORS`, those that there are.
        bound: what noise leaves of an efficient unbiased estimator.
        bound_by_force: the same between `FORCE_EDGES_N`.
    """

    name: str
    truth: ContactTruth
    tested: dict[str, Tested]
    bound: NoiseBound
    bound_by_force: tuple[NoiseBound, ...]

    def error_by_force_n(self, estimator: str) -> Array:
        """(bins,) mean absolute magnitude error; an answer of no contact counts as 0 N."""
        truth, answer = self.truth, self.tested[estimator].answer
        said = np.where(answer.segment > 0, answer.magnitude_n, 0.0)
        touched = truth.segment > 0
        error = np.abs(said - truth.magnitude_n)[touched]
        place = _bins(truth.magnitude_n[touched])
        counts = np.bincount(place, minlength=len(FORCE_EDGES_N) - 1)
        sums = np.bincount(place, error, minlength=len(FORCE_EDGES_N) - 1)
        return np.asarray(sums / np.maximum(counts, 1))


def all_settings() -> tuple[Setting, ...]:
    """The settings of `cablesense evaluate`, and the three-segment arm of Table II."""
    peers = {name: model for name, model in TABLE2_MODELS.items() if name != SHIPPED}
    table2 = Setting("table2", "cdsm_table2", "straight", TABLE2_MODELS[SHIPPED], peers)
    return (*SETTINGS, table2)


def answered_setting(
    setting: Setting, samples: int, training_samples: int, boosting: BoostingSettings
) -> SettingTest:
    """All estimators of a setting; trees are grown where there are samples to train on."""
    dataset = draw_dataset(setting.arm, setting.protocol(samples), TEST_SEED)
    tested = answered_models(setting, dataset)
    if training_samples:
        training = draw_dataset(setting.arm, setting.protocol(training_samples), TRAIN_SEED)
        tested[TREES] = _tested(dataset, BoostingPeer(training, boosting).answer(dataset))
    truth = _truth(dataset)
    touched = np.flatnonzero(truth.segment > 0)
    place = _bins(truth.magnitude_n[touched])
    return SettingTest(
        name=setting.name,
        truth=truth,
        tested=tested,
        bound=noise_bound(dataset),
        bound_by_force=tuple(
            noise_bound(dataset.select(touched[place == i])) for i in range(len(FORCE_EDGES_N) - 1)
        ),
    )


def answered_models(setting: Setting, dataset: Dataset) -> dict[str, Tested]:
    """The bundled models of a setting on a dataset."""
    models = {SHIPPED: setting.model, **setting.peers}
    return {
        name: _tested(dataset, single_answer(Estimator.load(find_model(model)), dataset))
        for name, model in models.items()
    }


def as_the_paper_tests(setting: Setting, samples: int) -> dict[str, Tested]:
    """The bundled models on samples without noise, each of them a contact."""
    protocol = SingleContact(
        samples=samples, pose=setting.pose, noise=False, no_contact_fraction=0.0
    )
    return answered_models(setting, draw_dataset(setting.arm, protocol, TEST_SEED))


def _tested(dataset: Dataset, answer: ContactAnswer) -> Tested:
    metrics = single_contact_metrics(_truth(dataset), answer, dataset.arm.segment_count)
    return Tested(answer, metrics)


def _truth(dataset: Dataset) -> ContactTruth:
    return ContactTruth(dataset.segment, dataset.angle_deg, dataset.magnitude_n)


def _bins(magnitude_n: Array) -> NDArray[np.int64]:
    place = np.searchsorted(FORCE_EDGES_N, magnitude_n, side="right") - 1
    return np.minimum(place, len(FORCE_EDGES_N) - 2)


def draw_confusion(axes: Any, counts: ArrayLike, names: Sequence[str]) -> None:
    """A matrix of counts, true classes down, answered ones across, in percent of each row.

    A cell that never occurred stays empty; one that did says its share to two digits.
    """
    table = np.asarray(counts, dtype=float)
    share = 100.0 * table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=120.0)
    for row, column in np.argwhere(table > 0):
        value = share[row, column]
        axes.text(
            column, row, shown_share(value), ha="center", va="center", fontsize=7.6,
            color="white" if value > 60.0 else BLACK,
        )  # fmt: skip
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def shown_share(percent: float) -> str:
    """`99.9`, `0.05`: never 100 unless it is just that."""
    if percent == 100.0:
        return "100"
    if percent >= 10.0:
        return f"{min(percent, 99.9):.1f}"
    return f"{percent:.1f}" if percent >= 1.0 else f"{percent:.2f}"


PAPER_DIRECTION_DEG, PAPER_MAE_N = 5.96, 9.97
_COLOURS = dict(zip(ESTIMATORS, (BLUE, ORANGE, GREEN, VERMILION), strict=True))
_LINES = dict(zip(ESTIMATORS, DASHES, strict=True))
_MARKS = dict(zip(ESTIMATORS, "osD^", strict=True))
_SHOWN_POINTS = 500
_PER_DECADE = 8


def confusion_picture(test: SettingTest) -> Picture:
    """Fig. 10 for one setting, its estimators side by side."""
    import matplotlib.pyplot as plt

    count = len(test.tested)
    figure, every = plt.subplots(
        1, count, figsize=(WIDTH_IN * count / 4, 3.1), sharey=True, layout="constrained"
    )
    for axes, (name, tested) in zip(np.atleast_1d(every), test.tested.items(), strict=True):
        _confusion(axes, tested, LABELS[name])
    np.atleast_1d(every)[0].set_ylabel("true segment")
    return picture(
        "fig_10_confusion",
        figure,
        f"Fig. 10 of the paper, {TITLES[test.name]}, with no contact (–) as a class of its own. "
        "Percent of each row; empty cells never occurred.",
        f"Confusion matrices of {count} estimators over no contact and the segments",
    )


def confusion_grid_picture(tests: Sequence[SettingTest]) -> Picture:
    """Fig. 10 for other settings, one a row."""
    names = _present(tests)
    figure, every = _grid(len(tests), len(names), 2.45)
    for row, test in zip(every, tests, strict=True):
        for axes, name in zip(row, names, strict=True):
            if name in test.tested:
                _confusion(axes, test.tested[name], LABELS[name] if test is tests[0] else "")
            else:
                _absent(axes)
        row[0].set_ylabel(f"{TITLES[test.name]}\ntrue segment")
    return picture(
        "fig_10_other_settings",
        figure,
        "The same as Fig. 10 in the other settings.",
        "Confusion matrices of all estimators in the other settings",
    )


def direction_picture(tests: Sequence[SettingTest]) -> Picture:
    """Fig. 11: shares of contacts by absolute direction error, on a logarithmic axis."""
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        len(tests), 1, figsize=(WIDTH_IN, 1.75 * len(tests) + 0.5), sharex=True,
        layout="constrained",
    )  # fmt: skip
    edges = np.logspace(-3.0, np.log10(180.0), round(5.26 * _PER_DECADE))
    for axes, test in zip(np.atleast_1d(every), tests, strict=True):
        for name, tested in test.tested.items():
            error = _direction_error_deg(test, tested)
            share = np.histogram(np.maximum(error, edges[0]), edges)[0] / len(error)
            mean = tested.metrics.errors.direction_mae_deg
            axes.stairs(
                100.0 * share, edges, color=_COLOURS[name], ls=_LINES[name], lw=1.7,
                label=LABELS[name] if test is tests[0] else "",
            )  # fmt: skip
            axes.plot(mean, 0.0, _MARKS[name], color=_COLOURS[name], ms=7, clip_on=False, zorder=4)
        axes.axvline(test.bound.direction_mae_deg, color=BLACK, ls=(0, (1, 1)), lw=1.4)
        axes.axvline(PAPER_DIRECTION_DEG, color=BLACK, ls="--", lw=1.2)
        axes.set(title=TITLES[test.name], ylabel="contacts, %", xscale="log", ylim=(0.0, None))
        axes.grid()
    lowest = np.atleast_1d(every)[-1]
    lowest.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    lowest.set(xlabel="absolute direction error, ° (logarithmic)", xlim=(edges[0], edges[-1]))
    first = np.atleast_1d(every)[0]
    first.plot([], [], color=BLACK, ls=(0, (1, 1)), label="mean, noise bound")
    first.plot([], [], color=BLACK, ls="--", label="mean, the paper: 5.96°")
    figure.legend(loc="outside upper center", ncols=3)
    return picture(
        "fig_11_direction",
        figure,
        "Fig. 11 of the paper: absolute direction errors of the contacts found. Marks on the "
        "axis: mean of each estimator. Errors below 0.001° stand in the first step.",
        "Histograms of the direction error of all estimators by setting",
    )


def magnitude_picture(tests: Sequence[SettingTest]) -> Picture:
    """Fig. 12: predicted against actual magnitude."""
    names = _present(tests)
    figure, every = _grid(len(tests), len(names), 2.35)
    for row, test in zip(every, tests, strict=True):
        for axes, name in zip(row, names, strict=True):
            if name not in test.tested:
                _absent(axes)
                continue
            _scatter(axes, test, test.tested[name], name)
            axes.set_title(LABELS[name] if test is tests[0] else "")
        row[0].set_ylabel(f"{TITLES[test.name]}\npredicted, N")
    for axes in every[-1]:
        axes.set_xlabel("actual, N")
    return picture(
        "fig_12_magnitude",
        figure,
        f"Fig. 12 of the paper: predicted against actual magnitude, {_SHOWN_POINTS} contacts a "
        "panel; the errors are of all. An answer of no contact counts as 0 N.",
        "Predicted against actual force of all estimators by setting",
    )


def error_picture(tests: Sequence[SettingTest]) -> Picture:
    """Mean absolute magnitude error against force, beside the noise bound."""
    import matplotlib.pyplot as plt

    columns = 3
    figure, every = plt.subplots(
        -(-len(tests) // columns), columns, figsize=(WIDTH_IN, 5.6), sharex=True, sharey=True,
        layout="constrained", squeeze=False,
    )  # fmt: skip
    centre = 0.5 * (FORCE_EDGES_N[1:] + FORCE_EDGES_N[:-1])
    panels = list(every.ravel())
    for axes, test in zip(panels, tests, strict=False):
        for name in test.tested:
            axes.plot(
                centre, test.error_by_force_n(name), _MARKS[name], ls=_LINES[name], ms=4, lw=1.5,
                color=_COLOURS[name], label=LABELS[name] if test is tests[0] else "",
            )  # fmt: skip
        bound = [part.magnitude_mae_n for part in test.bound_by_force]
        first = test is tests[0]
        axes.plot(
            centre, bound, color=BLACK, ls=(0, (1, 1)), lw=2.0,
            label="noise bound" if first else "",
        )  # fmt: skip
        axes.axhline(
            PAPER_MAE_N, color=BLACK, ls="--", lw=1.0,
            label="the paper’s mean: 9.97 N" if first else "",
        )  # fmt: skip
        axes.set(title=TITLES[test.name], yscale="log", xlim=(0.0, 200.0))
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.grid()
    for axes in panels[len(tests) :]:
        axes.set_visible(False)
    figure.supxlabel("force, N", fontsize=9.5)
    figure.supylabel("mean absolute error, N (logarithmic)", fontsize=9.5)
    figure.legend(loc="outside upper center", ncols=3)
    return picture(
        "fig_12_error_against_force",
        figure,
        "Fig. 12 of the paper, drawn as error against force. Below the noise bound no unbiased "
        "estimator gets; below 2 N a miss counts with the whole force.",
        "Mean absolute force error against force of all estimators by setting",
    )


def _present(tests: Sequence[SettingTest]) -> list[str]:
    """Estimators that any of the settings has."""
    return [name for name in ESTIMATORS if any(name in test.tested for test in tests)]


def _grid(rows: int, columns: int, height_in: float) -> tuple[Any, Any]:
    import matplotlib.pyplot as plt

    size = (WIDTH_IN * columns / len(ESTIMATORS), height_in * rows + 0.3)
    return plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")


def _confusion(axes: Any, tested: Tested, title: str) -> None:
    counts = tested.metrics.confusion
    draw_confusion(axes, counts, ["–", *(str(n + 1) for n in range(len(counts) - 1))])
    accuracy = shown_accuracy(tested.metrics.contact_accuracy)
    axes.set(
        title="\n".join(filter(None, (title, f"{accuracy} right"))), xlabel="answered segment"
    )


def shown_accuracy(share: float) -> str:
    """`99.93 %`."""
    return f"{100.0 * share:.2f} %"


def _absent(axes: Any) -> None:
    axes.axis("off")
    axes.text(0.5, 0.5, "none", ha="center", va="center", color=GREY, transform=axes.transAxes)


def _scatter(axes: Any, test: SettingTest, tested: Tested, name: str) -> None:
    touched = np.flatnonzero(test.truth.segment > 0)[:_SHOWN_POINTS]
    answer, true_n = tested.answer, test.truth.magnitude_n[touched]
    said_n = np.where(answer.segment[touched] > 0, answer.magnitude_n[touched], 0.0)
    axes.plot([0.0, 200.0], [0.0, 200.0], color=GREY, lw=1.0)
    axes.plot(true_n, said_n, ".", color=_COLOURS[name], ms=2.5)
    errors = tested.metrics.errors
    axes.text(
        0.04, 0.96, f"MAE {errors.magnitude_mae_n:.2f} N\nRMSE {errors.magnitude_rmse_n:.2f} N",
        transform=axes.transAxes, va="top", fontsize=8.5,
    )  # fmt: skip
    axes.set(xlim=(0.0, 200.0), ylim=(0.0, 215.0), xticks=(0, 100, 200), yticks=(0, 100, 200))
    axes.grid()


def _direction_error_deg(test: SettingTest, tested: Tested) -> Any:
    found = (test.truth.segment > 0) & (tested.answer.segment > 0)
    return np.abs(
        angle_difference_deg(tested.answer.angle_deg[found], test.truth.angle_deg[found])
    )
