"""Features of a recording, against what was commanded."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.unlisted import course_features
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m

SMALL = small_recording()
TENSION = 40.0 + np.outer(np.linalg.norm(SMALL.load_n, axis=1), np.linspace(-0.5, 0.5, 12))
FEATURES = course_features(SMALL, TENSION, LAB)


def column(name: str, which: int = 0) -> np.ndarray:
    at = [k for k, known in enumerate(FEATURES.names) if known == name]
    return FEATURES.values[:, at[which]]


def test_every_row_has_every_feature():
    assert FEATURES.values.shape == (len(SMALL), len(FEATURES.names))
    assert len(FEATURES.groups) == len(FEATURES.names)
    assert np.isfinite(FEATURES.values).all()


def test_loads_are_by_segment_and_axis():
    third = SMALL.load_segment == 3
    along = column("load on segment_3 along z")
    np.testing.assert_array_equal(along[third], SMALL.load_n[third, 2])
    assert not along[~third].any()


def test_motion_is_the_sign_of_the_lengths_change():
    length = held_lengths_m(mechanism_of(LAB), SMALL.command_rad)[:, 5]
    sweep = np.flatnonzero(SMALL.trial == SMALL.trial.max())[1:]
    np.testing.assert_array_equal(
        column("motion of cable_6")[sweep], np.sign(np.diff(length))[sweep - 1]
    )


def test_nothing_moves_between_trials_and_under_a_load():
    assert not column("motion of cable_6")[SMALL.trial < SMALL.trial.max()].any()


@pytest.mark.parametrize("which", [0, 1])
def test_turning_points_tell_loading_from_unloading(which):
    """At one load, before and after its peak, a play is on opposite sides."""
    rows = np.flatnonzero(SMALL.trial == 1)
    lag = column("turning points of cable_12", which)[rows]
    assert np.abs(lag).max() <= 1.0
    assert lag[10] == pytest.approx(1.0)
    assert lag[26] < -0.5


def test_waiting_begins_anew_with_each_change():
    rows = np.flatnonzero(SMALL.trial == 2)
    waited = column("time since the last change")[rows]
    np.testing.assert_allclose(waited[4:8], waited[8:12])
    assert (np.diff(waited[4:8]) < 0.0).all()
