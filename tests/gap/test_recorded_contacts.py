"""A model on the known loads of a recording: tares, errors by segment, refusals, the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_variants import variant
from gap_recordings import CYCLE, LAB, small_recording
from scipy.spatial.transform import Rotation

from cablesense_gap.recorded_contacts import recorded_errors, tares_n, with_acting_loads
from cablesense_gap.recordings.recording import Recording, RecordingError
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.temporal_estimator import TemporalEstimator


@pytest.fixture(scope="module")
def recording() -> Recording:
    """As the laboratory's arm would read it."""
    made = small_recording()
    true_n = replay_arm(LAB, *made.inputs)
    readings = read_tensions_n(true_n, LAB.sensors, np.random.default_rng(0))
    return replace(made, tensions_n=readings)


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    return Estimator.load(find_model("cdsm_lab"))


def test_a_healthy_arm_is_estimated_right_on_every_segment(
    recording: Recording, estimator: Estimator
) -> None:
    found = recorded_errors(recording, estimator)
    assert set(found.by_segment) == {1, 2, 3, 4}
    assert found.whole.contact_accuracy > 0.99
    assert found.false_n < 0.05
    for each in found.by_segment.values():
        assert each.errors.contacts == 2 * np.count_nonzero(CYCLE)
        assert each.errors.magnitude_mae_n < 0.3
        assert each.errors.direction_mae_deg < 2.0


def test_the_tare_of_a_release_is_that_of_the_load_before() -> None:
    made = small_recording()
    tensions = 0.1 * np.arange(float(len(made)))[:, None] * np.ones(12)
    tare = tares_n(replace(made, tensions_n=tensions))[:, 0]
    loaded = made.load_segment > 0
    released = np.flatnonzero(np.isfinite(tare) & ~loaded)
    assert released.size
    for row in released:
        before = np.flatnonzero(loaded[:row])[-1]
        assert tare[row] == tare[before] < row


def test_readings_that_are_not_steady_are_no_tare() -> None:
    made = small_recording()
    loads = np.flatnonzero(np.diff((made.load_segment > 0).astype(int)) == 1) + 1
    first, second = loads[:2]
    tensions = made.tensions_n.copy()
    tensions[second - 4 : second] += np.linspace(20.0, 2.0, 4)[:, None]  # what a lag leaves
    tare = tares_n(replace(made, tensions_n=tensions))
    assert np.array_equal(tare[second], tare[first])


def test_loads_without_a_tare_are_refused(recording: Recording, estimator: Estimator) -> None:
    loaded = recording.rows(recording.load_segment > 0)
    with pytest.raises(RecordingError, match="no tare to estimate from"):
        recorded_errors(loaded, estimator)


def test_a_model_is_judged_on_loads_where_it_expects_contacts(
    recording: Recording, estimator: Estimator
) -> None:
    """The same readings; only what is stated of the place of trial 1 differs."""
    loaded, first = recording.load_segment > 0, recording.trial == 1
    middle = replace(recording, load_at_m=np.where(loaded, 0.065, np.nan))
    far = replace(recording, load_at_m=np.where(first & loaded, 0.11, np.nan))
    whole, others = recorded_errors(middle, estimator), recorded_errors(far, estimator)
    assert whole.whole.errors == recorded_errors(recording, estimator).whole.errors
    one_cycle = np.count_nonzero(CYCLE)
    assert others.whole.errors.contacts == whole.whole.errors.contacts - one_cycle
    with pytest.raises(RecordingError, match="no load at a contact point"):
        recorded_errors(far, estimator, [1])


@pytest.mark.parametrize("at_m", [0.04, 0.1])
def test_a_model_of_contacts_anywhere_is_judged_on_loads_anywhere(at_m: float) -> None:
    """On segment 1, where the moment alone is known, by the force that it means at the place."""
    made = small_recording()
    made = replace(made, load_at_m=np.where(made.load_segment > 0, at_m, np.nan))
    true_n = replay_arm(LAB, *made.inputs)
    readings = read_tensions_n(true_n, LAB.sensors, np.random.default_rng(0))
    anywhere = AnywhereEstimator.load(find_model("cdsm_lab_anywhere"))
    found = recorded_errors(replace(made, tensions_n=readings), anywhere)
    assert set(found.by_segment) == {1, 2, 3, 4}
    for each in found.by_segment.values():
        assert each.contact_accuracy > 0.95
        assert each.errors.magnitude_mae_n < 0.5


def test_a_history_dependent_model_answers_along_the_recording(recording: Recording) -> None:
    """Made for another arm of the same form; the recording is that one's."""
    estimator = TemporalEstimator.load(find_model("cdsm_moving"))
    arm = estimator.metadata.arm
    true_n = replay_arm(arm, *recording.inputs)
    found = recorded_errors(replace(recording, tensions_n=true_n), estimator, [1, 2])
    assert found.whole.contact_accuracy > 0.9
    assert found.whole.errors.magnitude_mae_n < 1.0


def test_an_estimator_is_not_blamed_for_a_load_cell(
    recording: Recording, estimator: Estimator
) -> None:
    """A cell that reads a fifth too little, turned by half a radian about the base's x axis."""
    turn = Rotation.from_rotvec([0.5, 0.0, 0.0]).as_matrix()
    misread = replace(recording, load_n=recording.load_n @ turn / 1.2)
    cell = {"effect": "load_cell", "parameters": {"scale": 0.2, "turn_x_rad": 0.5}}
    acting = with_acting_loads(misread, variant({"effects": [cell]}, "cdsm_lab"))
    np.testing.assert_allclose(acting.load_n, recording.load_n, atol=1e-9)
    assert recorded_errors(misread, estimator).whole.errors.magnitude_mae_n > 3.0
    assert recorded_errors(acting, estimator).whole.errors.magnitude_mae_n < 0.3
