"""Errors of estimated forces, on answers whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_base.arrays import Array
from cablesense_gap.retraining import answered_n, estimator_figures, tared_loads
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import contact_angle_deg, normal_force_n
from cablesense_training.inference.estimator import Estimates

LOADS = tared_loads(small_recording())
ARM = mechanism_of(LAB)
ANGLE_DEG = contact_angle_deg(ARM, LOADS.command_rad, LOADS.segment, LOADS.force_n)
SIZE_N = np.linalg.norm(
    normal_force_n(ARM, LOADS.command_rad, LOADS.segment, ANGLE_DEG, 1.0).sum(1) * LOADS.force_n,
    axis=1,
)


def answers(turned_deg: float = 0.0, more: float = 1.0, segment: int | None = None) -> Array:
    """All answers, turned by an angle and larger by a factor; the true segment or another."""
    segments = LOADS.segment if segment is None else np.full(len(LOADS), segment)
    nothing = np.zeros(len(LOADS))
    said = Estimates(
        probabilities=np.zeros((len(LOADS), 5)),
        segment=segments,
        angle_deg=ANGLE_DEG + turned_deg,
        magnitude_n=SIZE_N * more,
        magnitude_std_n=nothing,
        angle_std_deg=nothing,
    )
    return answered_n(ARM, LOADS, said)


def test_the_truth_has_no_error():
    figures = estimator_figures(ARM, LOADS, answers())
    assert figures["contact_accuracy"] == 1.0
    assert figures["force_mae_n"] == pytest.approx(0.0, abs=1e-9)
    assert figures["direction_mean_deg"] == pytest.approx(0.0, abs=1e-4)
    assert figures["loads"] == 8.0


def test_each_error_is_told_by_its_figure():
    figures = estimator_figures(ARM, LOADS, answers(turned_deg=-7.0, more=1.1))
    assert figures["direction_mean_deg"] == pytest.approx(7.0)
    assert figures["force_mae_n"] == pytest.approx(0.1 * SIZE_N[LOADS.at_peak].mean())


def test_no_contact_counts_as_no_force():
    figures = estimator_figures(ARM, LOADS, answers(segment=0))
    assert figures["contact_accuracy"] == 0.0
    assert figures["force_mae_n"] == pytest.approx(SIZE_N[LOADS.at_peak].mean())
    assert "direction_mean_deg" not in figures


def test_another_segment_is_not_right():
    assert estimator_figures(ARM, LOADS, answers(segment=2))["contact_accuracy"] == 0.25
