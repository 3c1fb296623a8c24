"""From a recording to an estimator that knows the arm, and when the first one is kept."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablesense_gap import adaptation
from cablesense_gap.adaptation import (
    AdaptationError,
    adapt,
    diagnosed_calibration,
    withheld_trials,
)
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.recorded_contacts import RecordedMachine, at_contact_points
from cablesense_gap.verdict import Share
from cablesense_plants.arm.body import read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm, ListedEffect, find_arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import read_tensions_n, replay_arm
from cablesense_sim.uncertain_arm import arm_parameters
from tests.helpers.expected_parameters import expected_parameters
from tests.helpers.gap_recordings import LAB, small_recording
from tests.helpers.verdict_cases import verdict_of

PROTOCOL = small_recording()
SHORT = small_recording(peak_n=25.0).rows(np.r_[0:260])
WORKSHOP = open_arm("cdsm_lab")
"""With the tolerances of a careful workshop; those of `LAB` are narrow."""
GAIN = ListedEffect(effect="sensor_gain", at="cable_1", parameters={"gain": 0.3})
FRICTION = ListedEffect(effect="capstan_friction", parameters={"coefficient": 0.15})
SHARE = Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.1, probability=1.0)


def having(arm: Arm, *effects: ListedEffect) -> Arm:
    return arm.model_copy(update={"effects": list(effects)})


def recorded(arm: Arm, made: Recording = SHORT) -> Recording:
    true_n = replay_arm(arm, made.course)
    readings = read_tensions_n(true_n, arm.sensors, np.random.default_rng(0))
    return replace(made, tensions_n=readings)


@cache
def healthy() -> Recording:
    return recorded(LAB)


def as_built(seed: int, gain: float) -> Recording:
    """An arm of the workshop by the independent plant; its first sensor has another gain too."""
    rng = np.random.default_rng(seed)
    built = BuiltArm(read_nominal(find_arm("cdsm_lab")), Workmanship(), rng)
    built.gains[0] *= 1.0 + gain
    contact_m = mechanism_of(WORKSHOP).contact_m
    pushes = [
        () if not n else (Push(int(n), contact_m[n - 1], load_n),)
        for n, load_n in zip(SHORT.load_segment, SHORT.load_n, strict=True)
    ]
    tensions_n = built.rests(SHORT.command_rad, pushes).tensions_n
    return replace(SHORT, tensions_n=built.read(tensions_n, rng))


@pytest.fixture
def diagnosed_as(monkeypatch: pytest.MonkeyPatch):
    """Puts a diagnosis that names just these effects in place of one that takes its time."""
    asked: list[Collection[int]] = []

    def put(*effects: ListedEffect) -> list[Collection[int]]:
        def diagnose(
            recording: Recording,
            arm: Arm,
            *others: object,
            unseen: Collection[int] = (),
            force: bool = False,
            announce: object = None,
            kept: object = None,
        ) -> Diagnosis:
            asked.append(unseen or others[-1])
            shares = {effect.effect: SHARE for effect in effects}
            names = "+".join(sorted(shares)) or "none"
            read = recording.tensions_n
            verdict = verdict_of(names, shares=shares)
            every = np.ones(len(recording), dtype=bool)
            amended = having(arm, *effects)
            known = expected_parameters(amended)
            return Diagnosis(recording, arm, verdict, amended, read, read, every, known)

        monkeypatch.setattr(adaptation, "diagnose", diagnose)
        return asked

    return put


def test_the_trials_withheld_have_loads_and_leave_each_segment_to_learn_from():
    places = replace(PROTOCOL, load_at_m=np.where(PROTOCOL.trial % 3, 0.02, np.nan))
    apart = withheld_trials(places, LAB)
    assert 0 < len(apart) <= len(np.unique(PROTOCOL.trial)) / 3
    seen = ~np.isin(PROTOCOL.trial, apart)
    assert set(PROTOCOL.load_segment[seen]) == {0, 1, 2, 3, 4}
    assert PROTOCOL.load_segment[~seen & at_contact_points(places, LAB)].any()


def test_a_recording_without_loads_is_refused():
    idle = replace(
        PROTOCOL, load_segment=np.zeros_like(PROTOCOL.load_segment), load_n=0.0 * PROTOCOL.load_n
    )
    with pytest.raises(AdaptationError, match="small: 0 trials have a load"):
        withheld_trials(idle, LAB)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_estimator_of_a_built_arm_is_repaired(diagnosed_as, seed: int):
    """Beside the hidden gain, no cable, hole or mass is as the file says."""
    asked = diagnosed_as(GAIN)
    recording = as_built(seed, gain=0.3)
    adaptation = adapt(recording, WORKSHOP)
    assert asked == [withheld_trials(recording, WORKSHOP)]
    assert adaptation.better
    before = adaptation.before.whole.errors
    after = adaptation.after.whole.errors
    assert after.magnitude_mae_n < 0.5 * before.magnitude_mae_n
    assert after.contact_accuracy > 0.99
    assert after.magnitude_coverage95 > 0.9
    assert after.direction_coverage95 > 0.9
    assert adaptation.after.confirmed > 0.9
    assert adaptation.adapted.unexplained_n < 0.3
    errors = adaptation.diagnosis.verdict.estimator
    assert errors.use == "after"
    assert errors.after["force_mae_n"] == after.magnitude_mae_n


def test_friction_that_is_diagnosed_is_explained(diagnosed_as):
    """The law has one state of friction a guide, the simulator two plates between joints."""
    diagnosed_as(FRICTION)
    few = SHORT.rows(np.isin(SHORT.trial, [1, 2, 5, 6]))
    adaptation = adapt(recorded(having(LAB, FRICTION), few), LAB)
    assert adaptation.adapted.unexplained_n < 0.1
    assert adaptation.after.whole.errors.magnitude_coverage95 > 0.9
    assert adaptation.better
    friction = arm_parameters(adaptation.adapted.law.arm).slices["friction"]
    assert_allclose(adaptation.adapted.calibration.mean[friction], 0.15)


def test_what_the_law_does_not_explain_widens_intervals(diagnosed_as):
    """Cables rub more than is diagnosed."""
    diagnosed_as(FRICTION)
    few = SHORT.rows(np.isin(SHORT.trial, [1, 2, 5, 6]))
    more = ListedEffect(effect="capstan_friction", parameters={"coefficient": 0.25})
    adaptation = adapt(recorded(having(LAB, more), few), LAB)
    assert adaptation.adapted.unexplained_n > 0.05
    assert adaptation.after.whole.errors.magnitude_coverage95 > 0.9


def test_intervals_hold_where_what_is_not_explained_has_the_direction_of_the_load(
    diagnosed_as, monkeypatch: pytest.MonkeyPatch
):
    """A joint's friction keeps a part of each load from the cables, and not at random."""
    friction = ListedEffect(effect="joint_friction", at="joint_3", parameters={"torque_n_m": 0.3})
    diagnosed_as(friction)
    made = recorded(having(LAB, friction))
    adaptation = adapt(made, LAB)
    assert adaptation.after.whole.errors.magnitude_coverage95 >= 0.9
    measured = RecordedMachine.unexplained_n2

    def of_the_same_size_in_all_directions(known, rows):
        return np.eye(12) * np.diag(measured(known, rows)).mean()

    monkeypatch.setattr(RecordedMachine, "unexplained_n2", of_the_same_size_in_all_directions)
    by_size = adapt(made, LAB)
    assert by_size.after.whole.errors.magnitude_coverage95 < 0.85


def test_what_the_file_lists_of_tolerances_counts_once(diagnosed_as):
    """The diagnosis states deviations from the drawn arm, a calibration those from the file."""
    diagnosed_as()
    diagnosis = adaptation.diagnose(healthy(), LAB, unseen=(1,))
    tolerances = [
        ListedEffect(effect="cable_tolerance", at="cable_2", parameters={"pretension_n": 0.7}),
        ListedEffect(effect="sensor_tolerance", at="cable_3", parameters={"zero_n": 0.2}),
    ]
    parameters = arm_parameters(LAB)
    mean = parameters.prior_mean
    mean[parameters.slices["pretension"].start + 1] = 0.75
    mean[parameters.slices["sensor_zero"].start + 2] = 0.2
    known = replace(diagnosis.parameters, mean=mean)
    amended = having(LAB, *tolerances)
    calibration = diagnosed_calibration(replace(diagnosis, amended=amended, parameters=known))
    off = calibration.mean - parameters.prior_mean
    assert_allclose(off[parameters.slices["pretension"].start + 1], 0.05)
    off[parameters.slices["pretension"].start + 1] = 0.0
    assert_allclose(off, 0.0, atol=1e-12)
    zeros = calibration.std[parameters.slices["sensor_zero"]]
    assert (zeros >= LAB.tolerances.sensor_zero_n).all()
    assert calibration.arm_identity == amended.identity


def test_where_nothing_is_found_there_is_no_second_estimator(diagnosed_as):
    diagnosed_as()
    adaptation = adapt(healthy(), LAB)
    assert (adaptation.better, adaptation.after, adaptation.adapted) == (False, None, None)
    assert adaptation.diagnosis.verdict.estimator.use == "before"
    assert adaptation.before.whole.errors.magnitude_mae_n < 0.3


def test_a_second_estimator_that_is_no_better_is_not_used(diagnosed_as):
    diagnosed_as(GAIN)
    adaptation = adapt(healthy(), LAB)
    assert not adaptation.better
    assert adaptation.after is not None
    assert adaptation.diagnosis.verdict.estimator.use == "before"
