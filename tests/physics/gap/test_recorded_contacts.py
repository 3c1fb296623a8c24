"""An estimator on the known loads of a recording: tares, errors by segment, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cablesense_contact.calibration import Calibrator
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.estimator import Estimates, Estimator
from cablesense_gap.recorded_contacts import (
    RecordedMachine,
    recorded_errors,
    settled,
    tares_n,
    tares_of,
    those_settled,
    unloaded_poses,
    with_acting_loads,
)
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.arm import open_arm
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_training.evaluation.metrics import ContactTruth
from cablesense_training.law.build import TorchLaw
from tests.helpers.arm_variants import variant
from tests.helpers.gap_recordings import CYCLE, LAB, small_recording

HELD = int(np.count_nonzero((np.diff(CYCLE) == 0.0) & (CYCLE[1:] > 0.0)))
"""Loaded rows of a cycle with the load of the row before; by noise some seem to have changed."""


def read_from(made: Recording) -> Recording:
    """As the laboratory's arm would read it."""
    true_n = replay_arm(LAB, made.course)
    readings = read_tensions_n(true_n, LAB.sensors, np.random.default_rng(0))
    return replace(made, tensions_n=readings)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return read_from(small_recording())


@pytest.fixture(scope="module")
def law() -> TorchLaw:
    return TorchLaw(LAB)


def test_a_healthy_arm_is_estimated_right_on_every_segment(
    recording: Recording, law: TorchLaw
) -> None:
    errors = recorded_errors(recording, law)
    assert set(errors.by_segment) == {1, 2, 3, 4}
    assert errors.whole.contact_accuracy > 0.99
    assert errors.false_n < 0.05
    assert errors.confirmed > 0.9
    for each in errors.by_segment.values():
        assert 0.9 * 2 * HELD < each.errors.contacts <= 2 * HELD
        assert each.errors.magnitude_mae_n < 0.5
        assert each.errors.direction_mae_deg < 2.0
        assert each.errors.magnitude_coverage95 > 0.9


@pytest.mark.slow
def test_with_a_calibration_a_tare_is_taken_before_each_load() -> None:
    """Zeros that wander from trial to trial are in no single calibration of all poses."""
    workshop = open_arm("cdsm_lab")
    law = TorchLaw(workshop)
    some = read_from(small_recording(peak_n=40.0).rows(np.r_[0:164, 200:236]))
    wandering_n = np.random.default_rng(1).normal(0.0, 1.0, (7, 12))
    wandered = replace(some, tensions_n=some.tensions_n + wandering_n[some.trial])
    by_tolerances = Calibrator(FeltArm(workshop), law).by_tolerances()
    once = recorded_errors(wandered, law)
    tared = recorded_errors(wandered, law, calibration=by_tolerances)
    assert tared.whole.contact_accuracy > 0.98
    assert tared.whole.errors.magnitude_mae_n < 0.5
    assert tared.whole.errors.magnitude_coverage95 > 0.95
    assert once.whole.contact_accuracy < tared.whole.contact_accuracy - 0.05


def test_what_a_law_does_not_know_is_measured_under_known_loads(law: TorchLaw) -> None:
    made = read_from(small_recording(peak_n=12.0).rows(np.r_[0:164]))
    by_tolerances = Calibrator(FeltArm(LAB), law).by_tolerances()
    loaded = made.load_segment > 0
    noise_n = np.random.default_rng(2).normal(0.0, 0.3, made.tensions_n.shape)
    noisy = replace(made, tensions_n=made.tensions_n + loaded[:, None] * noise_n)
    tares = tares_of(made)
    exact_n2 = RecordedMachine(made, tares, law, by_tolerances).unexplained_n2(loaded)
    assert np.diag(exact_n2).mean() < 0.01
    unexplained_n2 = RecordedMachine(noisy, tares, law, by_tolerances).unexplained_n2(loaded)
    assert_allclose(np.diag(unexplained_n2).mean(), 0.3**2, rtol=0.15)


def test_readings_have_settled_where_they_change_by_noise_alone() -> None:
    made = read_from(small_recording())
    machine = FeltArm(LAB)
    size = made.tensions_n.shape
    noise_n = np.random.default_rng(3).normal(0.0, np.sqrt(machine.mean_variance(1)), size)
    still = replace(made, tensions_n=np.full(size, 50.0) + noise_n)
    first_of_trial = np.diff(made.trial, prepend=-1) != 0
    at_rest = settled(still, machine)
    assert not at_rest[first_of_trial].any()
    assert at_rest[~first_of_trial].mean() > 0.97
    lagging_n = np.exp(-np.arange(len(made)) / 3.0)[:, None] * np.full(size[1], 30.0)
    settling = settled(replace(still, tensions_n=still.tensions_n + lagging_n), machine)
    assert not settling[:12].any()  # 0.6 N a row
    assert (settling == at_rest)[30:].all()  # 2 mN


def test_where_few_readings_settle_the_loaded_ones_that_change_least_take_their_place() -> None:
    """Each row changes by one and a half newtons more than the one before."""
    made = read_from(small_recording())
    rows = np.arange(float(len(made)))
    faster_n = 50.0 + (0.75 * rows * (rows + 1.0))[:, None] * np.ones(made.tensions_n.shape[1])
    never_still = replace(made, tensions_n=faster_n)
    chosen = those_settled(never_still, FeltArm(LAB), np.ones(len(made), dtype=bool))
    loaded = made.load_segment > 0
    not_first = np.diff(made.trial, prepend=-1) == 0
    first_20 = np.flatnonzero(loaded & not_first)[:20]
    np.testing.assert_array_equal(np.flatnonzero(chosen & loaded), first_20)
    assert not chosen[first_20[-1] + 1 :].any()


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


def test_unloaded_poses_are_neither_of_a_motion_nor_after_a_load() -> None:
    made = small_recording()
    poses = unloaded_poses(made)
    assert len(poses) == 9  # at rest first, and before each load
    assert [one.count for one in poses] == [20] + 8 * [4]
    times = [one.taken_ns for one in poses]
    assert times == sorted(times)
    assert [one.command_rad[4] for one in unloaded_poses(made, [4, 5])] == [0.0, 0.1]


def test_loads_without_a_tare_are_refused(recording: Recording, law: TorchLaw) -> None:
    loaded = recording.rows(recording.load_segment > 0)
    with pytest.raises(RecordingError, match="no tare to estimate from"):
        recorded_errors(loaded, law)


class PerfectNetwork(Estimator):
    """A network that knows the truth, in the order in which it is asked; it notes how often."""

    def __init__(self, truth: ContactTruth) -> None:
        self.metadata = type("Metadata", (), {"arm": LAB})()
        self._truth = truth
        self.rows = 0

    def estimate_batch(self, tension_differences_n, joint_commands_rad=None) -> Estimates:
        self.rows = len(tension_differences_n)
        released = np.abs(tension_differences_n).max(axis=1) < 1.0
        zeros = np.zeros(self.rows)
        segment = np.where(released, 0, self._truth.segment)
        size = self._truth.magnitude_n
        stated = (self._truth.angle_deg, size, zeros + 0.1, zeros + 0.1, size, size)
        return Estimates(zeros, segment, *stated, misfit_n=zeros, plausible=zeros == 0.0)


def test_a_network_gets_differences_to_tares_at_contact_points(
    recording: Recording, law: TorchLaw
) -> None:
    """The same readings; only what is stated of the place of trial 1 differs."""
    network = PerfectNetwork(recorded_errors(recording, law).truth)
    errors = recorded_errors(recording, network)
    assert errors.whole.contact_accuracy == 1.0
    assert errors.whole.errors.magnitude_mae_n == 0.0
    assert np.isnan(errors.confirmed)
    loaded = recording.load_segment > 0
    first = recording.trial == 1
    far = replace(recording, load_at_m=np.where(first & loaded, 0.11, np.nan))
    with pytest.raises(RecordingError, match="no load at a contact point"):
        recorded_errors(far, network, [1])
    of_law = recorded_errors(far, law, anywhere=False)
    cycles = np.count_nonzero(loaded) / np.count_nonzero(CYCLE)
    held = (cycles - 1) * HELD
    assert 0.9 * held < of_law.whole.errors.contacts <= held


@pytest.mark.parametrize("at_m", [0.04, 0.1])
def test_a_law_is_judged_on_loads_anywhere(law: TorchLaw, at_m: float) -> None:
    """On segment 1, where the moment alone is known, by the force that it means at the place."""
    made = small_recording()
    made = replace(made, load_at_m=np.where(made.load_segment > 0, at_m, np.nan))
    errors = recorded_errors(read_from(made), law)
    assert set(errors.by_segment) == {1, 2, 3, 4}
    for each in errors.by_segment.values():
        assert each.contact_accuracy > 0.95
        assert each.errors.magnitude_mae_n < 0.7


def test_an_estimator_is_not_blamed_for_a_load_cell(recording: Recording, law: TorchLaw) -> None:
    """A cell that reads a fifth too little, turned by half a radian about the base's x axis."""
    turn = Rotation.from_rotvec([0.5, 0.0, 0.0]).as_matrix()
    misread = replace(recording, load_n=recording.load_n @ turn / 1.2)
    cell = {"effect": "load_cell", "parameters": {"scale": 0.2, "turn_x_rad": 0.5}}
    acting = with_acting_loads(misread, variant({"effects": [cell]}, "cdsm_lab"))
    np.testing.assert_allclose(acting.load_n, recording.load_n, atol=1e-9)
    assert recorded_errors(misread, law).whole.errors.magnitude_mae_n > 3.0
    assert recorded_errors(acting, law).whole.errors.magnitude_mae_n < 0.5
