"""Changes under hung loads, the part of them that bends no joint, and one number that explains."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.arm import open_arm
from cablesense_sim.effects.effect import Parameter
from cablesense_sim.effects.registry import known_effects
from cablesense_training.evaluation.table2 import read_table2
from examples.paper.tension_changes import (
    ChangeSimulator,
    OneNumber,
    TensionChanges,
    explain,
    internal_n,
    moments_n_m,
    scan,
)

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
    protocol = CHANGES.protocol(6)
    assert protocol.load_segment.tolist() == [0, 1, 0, 2, 0, 3] * 2
    assert protocol.trial.tolist() == np.repeat(np.arange(6), 2).tolist()
    assert not protocol.load_n[::2].any()
    tensions = ArmSimulator(ARM, protocol).predict([{}])[0]
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


OBLIQUE = TensionChanges(
    "oblique", SEGMENT[:3], np.array([[0.0, 5.0, -10.0]] * 3), np.zeros((3, 9))
)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-30.0, 30.0), min_size=9, max_size=9))
def test_the_internal_part_carries_nothing_and_the_rest_has_none(changes):
    change = np.array([changes])
    inner = internal_n(ARM, change)
    np.testing.assert_allclose(moments_n_m(ARM, inner), 0.0, atol=1e-9)
    np.testing.assert_allclose(internal_n(ARM, change - inner), 0.0, atol=1e-9)
    assert (inner * (change - inner)).sum() == pytest.approx(0.0, abs=1e-6)


def test_moments_are_those_of_the_load_about_each_joint():
    moments = moments_n_m(ARM, ChangeSimulator(ARM, OBLIQUE).predict([{}])[0])
    length, contact = ARM.segments.length_m, ARM.segments.contact_m
    joint = np.arange(3)
    lever = np.maximum((SEGMENT[:3, None] - 1 - joint) * length + contact, 0.0)
    np.testing.assert_allclose(np.abs(moments[:, ::2]), 10.0 * lever, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(np.abs(moments[:, 1::2]), 5.0 * lever, rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("effect", [("cable_stiffness", "change", 0.7),
                                    ("contact_offset", "offset_m", 0.02)])  # fmt: skip
@pytest.mark.parametrize("place", ["segment_1", "segment_2", "segment_3"])
def test_neither_springs_nor_contact_points_make_internal_forces(effect, place):
    name, parameter, value = effect
    tensions = ArmSimulator(ARM, OBLIQUE.protocol(6)).predict(
        [{Term(name, place, parameter): value}]
    )[0]
    assert np.abs(internal_n(ARM, tensions[1::2] - tensions[::2])).max() < 0.02


GAIN, PLAY = Term("gain", "arm", "gain"), Term("play", "arm", "play_m")
ROWS = np.arange(1.0, 7.0)
BY_ROW = np.arange(6)


class Lever:
    """Six rows of two channels; the gain scales both, play takes from the last row alone."""

    floor = 0.01
    tolerances = ()
    candidates = (
        Candidate("gain", ("arm",), (Parameter("gain", "1", -0.5, 0.5, 0.1, "scale"),)),
        Candidate(
            "play",
            ("arm", "joint_1"),
            (
                Parameter("play_m", "m", 0.0, 2.0, 0.1, "lost"),
                Parameter("start", "1", -1.0, 1.0, 0.5, "past", role="shape", trials=(-0.5, 0.5)),
            ),
        ),
    )

    def predict(self, variants):
        return np.stack([self._one(variant) for variant in variants])

    def _one(self, variant):
        readings = np.stack([ROWS, -2.0 * ROWS], axis=-1) * (1.0 + variant.get(GAIN, 0.0))
        if variant.get(PLAY, 0.0) > 1.5:
            return np.full_like(readings, np.nan)
        readings[-1] -= max(variant.get(PLAY, 0.0) - 0.5, 0.0)
        return readings


LEVER = Lever()
NOMINAL = LEVER.predict([{}])[0]
GAIN_NUMBER = OneNumber((GAIN,), -0.5, 0.5)
PLAY_NUMBER = OneNumber((PLAY,), 0.0, 2.0)


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.45, 0.45))
def test_a_planted_gain_is_found_on_rows_that_were_held_out(planted):
    found = explain(scan(LEVER, GAIN_NUMBER), LEVER.predict([{GAIN: planted}])[0], BY_ROW)
    assert found.value == pytest.approx(planted, abs=0.013)
    gap = np.sqrt(((planted * NOMINAL) ** 2).mean())
    assert found.held_out_rmse <= max(0.1, 0.3 * gap)


def test_an_effect_that_only_begins_at_some_size_is_not_missed():
    scanned = scan(LEVER, PLAY_NUMBER)
    assert scanned.values[-1] <= 1.5  # beyond, nothing can be simulated
    assert scanned.rms_n(NOMINAL).max() > 0.2
    found = explain(scanned, LEVER.predict([{PLAY: 1.2}])[0], BY_ROW)
    assert found.value == pytest.approx(1.2, abs=0.05)
    # the one row that shows it is not predicted by the others, in which it is absent
    assert found.rmse < 0.05
    np.testing.assert_allclose(found.squares[:-1], 0.0, atol=0.01)
    assert found.squares[-1] == pytest.approx(2 * 0.7**2, rel=0.01)
