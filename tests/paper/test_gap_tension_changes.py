"""Changes under hung loads: what they show, what they are blind to, how sensors tell them."""

import numpy as np
import pytest

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.simulator import Term
from cablesense_paper.tension_changes import ChangeSimulator, TensionChanges, internal_n
from cablesense_sim.arm import open_arm
from cablesense_sim.effects.registry import known_effects
from cablesense_training.evaluation.table2 import read_table2

ARM = open_arm("cdsm_table2")
WEIGHT_N = np.array([9.81, 9.81, 9.81, 19.62, 19.62, 19.62])
SEGMENT = np.array([1, 2, 3, 1, 2, 3])
CHANGES = TensionChanges(
    "hung", SEGMENT, WEIGHT_N[:, None] * np.array([0.0, 0.0, -1.0]), np.zeros((6, 9))
)
SIMULATOR = ChangeSimulator(ARM, CHANGES)
NOMINAL_N = SIMULATOR.predict([{}])[0]


def test_a_load_is_carried_by_the_cables_that_reach_it_in_closed_form():
    """Each segment's three cables carry what the joints beyond do not: F L / (3 r) at a time."""
    lever = ARM.segments.length_m / (1.5 * ARM.cables.routing_radius_m) * WEIGHT_N
    top = NOMINAL_N[:, 0]
    np.testing.assert_allclose(top, lever * np.array([0.5, 1.0, 1.0] * 2), rtol=1e-3)
    np.testing.assert_allclose(NOMINAL_N[:, 1:3], -0.5 * np.stack([top, top], -1), atol=5e-3)
    assert np.abs(NOMINAL_N[[0, 3], 3:]).max() < 2e-3


def test_every_load_is_hung_on_the_unloaded_arm():
    course = CHANGES.course(6)
    assert course.load_segment.tolist() == [0, 1, 0, 2, 0, 3] * 2
    assert course.trial.tolist() == np.repeat(np.arange(6), 2).tolist()
    assert not course.load_n[::2].any()
    tensions = ArmSimulator(ARM, course).predict([{}])[0]
    np.testing.assert_allclose(tensions[1::2] - tensions[0], NOMINAL_N, atol=1e-9)


@pytest.mark.parametrize(
    ("term", "value"),
    [
        (Term("sensor_offset", "cable_4", "offset_n"), 20.0),
        (Term("base_tilt", "arm", "roll_rad"), 0.2),
        (Term("pretension_error", "arm", "error_n"), 10.0),
        (Term("payload", "segment_1", "mass_kg"), 0.5),
        (Term("cable_stiffness", "segment_2", "change"), 1.0),
    ],
)
def test_what_is_there_before_and_after_is_not_in_a_change(term, value):
    assert np.abs(SIMULATOR.predict([{term: value}])[0] - NOMINAL_N).max() < SIMULATOR.floor


def test_one_gain_of_all_sensors_is_a_heavier_load():
    gains = {Term("sensor_gain", f"cable_{i}", "gain"): 0.05 for i in range(1, 10)}
    heavier = TensionChanges("heavier", SEGMENT, 1.05 * CHANGES.load_n, CHANGES.changes_n)
    np.testing.assert_allclose(
        SIMULATOR.predict([gains])[0],
        ChangeSimulator(ARM, heavier).predict([{}])[0],
        atol=0.1 * SIMULATOR.floor,
    )


def test_what_needs_the_time_is_no_candidate_and_others_can_be_left_out():
    timed = {name for name, effect in known_effects().items() if effect.needs_time}
    assert timed
    assert not timed & {c.effect for c in SIMULATOR.candidates}
    some = ChangeSimulator(ARM, CHANGES, {"sensor_gain", "cable_creep"})
    assert [c.effect for c in some.candidates] == ["sensor_gain"]
    assert some.tolerances


def test_readings_scatter_about_the_prediction_by_the_floor_and_in_steps():
    rng = np.random.default_rng(0)
    beyond = np.full((6, 9), 1.5)
    read = np.stack([SIMULATOR.measured({}, rng, beyond) for _ in range(60)])
    left = read - NOMINAL_N - beyond
    assert np.sqrt((left**2).mean()) == pytest.approx(SIMULATOR.floor, rel=0.1)
    steps = read / ARM.sensors.step_n
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_most_of_the_gap_to_the_measured_rows_bends_no_joint():
    measured = np.stack([r.tension_difference_n for r in read_table2() if r.source == "physical"])
    gap = measured - NOMINAL_N
    assert np.sqrt((gap**2).mean()) == pytest.approx(1.62, abs=0.02)
    inner = internal_n(ARM, gap)
    assert (inner**2).sum() / (gap**2).sum() == pytest.approx(0.75, abs=0.02)
    assert inner[:, 6].min() > 4.0 * SIMULATOR.floor  # all loads tighten the last three
