"""Known loads of a recording as contacts with a tare, and a model's errors on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.files import written_whole
from cablesense_gap.recordings.recording import Recording, RecordingError
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import normal_components_n
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    single_contact_metrics,
)
from cablesense_training.inference.estimator import Estimator


def tares_n(recording: Recording) -> Array:
    """(R, M) tare of every row that is loaded or released from a load; NaN where there is none.

    The mean of the unloaded rows just before the load, at its command.
    """
    loaded = recording.load_segment > 0
    moved = (np.diff(recording.command_rad, axis=0, prepend=np.nan) != 0.0).any(axis=1)
    tare = np.full_like(recording.tensions_n, np.nan)
    first: int | None = None  # of the latest unloaded rows at the present command
    last = 0
    for row in range(len(recording)):
        if moved[row]:
            first = None
        if not loaded[row]:
            if first is None or loaded[row - 1]:
                first = row
            last = row
            if not moved[row]:  # a load that has gone leaves what it left; none leaves none
                tare[row] = tare[row - 1]
        elif first is not None:
            tare[row] = recording.tensions_n[first : last + 1].mean(axis=0)
    return tare


class RecordedErrors(NamedTuple):
    """A model's answers on the contacts of a recording, and their errors.

    Attributes:
        truth: loads, the part that can be felt, and released rows as no contact.
        answer: the model's.
        whole: errors over all rows.
        by_segment: errors over the rows with a load on each segment, by its number.
        false_n: mean force told in rows without a load; NaN without such rows.
    """

    truth: ContactTruth
    answer: ContactAnswer
    whole: SingleContactMetrics
    by_segment: dict[int, SingleContactMetrics]
    false_n: float

    def as_json(self) -> dict[str, Any]:
        """Errors as plain values."""
        return {
            "all": asdict(self.whole),
            "by_segment": {str(n): asdict(each) for n, each in self.by_segment.items()},
            "false_force_n": self.false_n,
        }


def recorded_errors(recording: Recording, estimator: Estimator) -> RecordedErrors:
    """The errors of a model on a recording of its arm.

    Raises:
        RecordingError: no load follows unloaded rows at its command, so there is no tare.
    """
    arm: Arm = estimator.metadata.arm
    tare = tares_n(recording)
    rows = np.asarray(np.isfinite(tare).all(axis=1))
    if not (rows & (recording.load_segment > 0)).any():
        raise RecordingError(
            f"{recording.name}: no load follows unloaded rows at its command, so there is no tare "
            "to estimate from; record load cycles (cablesense gap protocol)"
        )
    taken = recording.rows(rows)
    found = estimator.estimate_batch(taken.tensions_n - tare[rows], taken.command_rad)
    answer = ContactAnswer.of(found)
    y, z = normal_components_n(
        mechanism_of(arm), taken.command_rad, np.maximum(taken.load_segment, 1), taken.load_n
    )
    truth = ContactTruth(taken.load_segment, np.rad2deg(np.arctan2(y, z)) % 360.0, np.hypot(y, z))

    def errors(chosen: NDArray[np.bool_]) -> SingleContactMetrics:
        return single_contact_metrics(
            truth.select(chosen), answer.select(chosen), arm.segment_count
        )

    free = truth.segment == 0
    told_n = answer.force_n[free]
    return RecordedErrors(
        truth,
        answer,
        errors(np.ones(len(taken), dtype=bool)),
        {int(n): errors(truth.segment == n) for n in np.unique(truth.segment) if n},
        float(told_n.mean()) if told_n.size else float("nan"),
    )


def draw_recorded_errors(path: Path, errors: Mapping[str, RecordedErrors]) -> None:
    """Estimated against true force of each model, as a PNG: a colour for each segment.

    Raises:
        RecordingError: the place cannot be written to.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(
            1, len(errors), figsize=(4.4 * len(errors), 4.2), squeeze=False, layout="constrained"
        )
        most = 1.05 * max(
            max(each.truth.force_n.max(), each.answer.force_n.max()) for each in errors.values()
        )
        for place, (name, each) in zip(axes[0], errors.items(), strict=True):
            place.plot([0.0, most], [0.0, most], color="0.7", lw=1)
            right = each.answer.segment == each.truth.segment
            for segment in np.unique(each.truth.segment):
                rows = each.truth.segment == segment
                colour = f"C{segment}" if segment else "0.4"
                label = f"segment {segment}" if segment else "no load"
                forces = each.truth.force_n, each.answer.force_n
                place.plot(*(f[rows & right] for f in forces), ".", ms=4, c=colour, label=label)
                place.plot(*(f[rows & ~right] for f in forces), "x", ms=5, c=colour)
            accuracy, off_n = each.whole.contact_accuracy, each.whole.errors.magnitude_mae_n
            place.set(
                title=f"{name}\nright segment {accuracy:.1%}, force off by {off_n:.2f} N",
                xlabel="true force, N (crosses: another segment, or none)",
                ylabel="estimated force, N",
            )
            place.legend(frameon=False)
        with written_whole(path, RecordingError) as part:
            figure.savefig(part, dpi=110, format="png")
        plt.close(figure)
