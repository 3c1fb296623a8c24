"""The arm as the diagnosis sees it is the arm that everybody else simulates.

The amended arm: what was found stands in the file, and the file reads back as that arm.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from arm_variants import five_by_four, variant
from gap_recordings import LAB, small_recording
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.amended_arm import amended_arm, write_arm
from cablesense_gap.arm_simulator import (
    ArmSimulator,
    counted_rows,
    entries_from,
    has_one_equilibrium,
)
from cablesense_gap.simulator import Term
from cablesense_sim.arm import ArmFileError, load_arm
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.replay import replay_arm

FEW = np.r_[0:10, 20:40, 310:330]
"""Rest, a load cycle with its steps, and some of a sweep."""
RECORDING = small_recording(peak_n=20.0).rows(FEW)
RECORDING = replace(RECORDING, time_s=0.2 * np.arange(len(FEW)))
TAUT = variant({"cables.pretension_n": 100.0})
HISTORY_DEPENDENT = {"cable_creep", "capstan_friction", "joint_friction"}

GAIN = Term("sensor_gain", "cable_2", "gain")
OFFSET_N = Term("sensor_offset", "cable_2", "offset_n")
SHARE = Term("sensor_crosstalk", "cable_1_into_cable_2", "share")
LAG_S = Term("sensor_lag", "cable_2", "time_constant_s")
MASS_KG = Term("payload", "segment_2", "mass_kg")
FRICTION = Term("joint_friction", "joint_1", "torque_n_m")


def simulator(arm=LAB, recording=RECORDING):
    return ArmSimulator(arm, recording)


def replayed(*listed, recording=RECORDING):
    effects = [{"effect": e, "at": at, "parameters": numbers} for e, at, numbers in listed]
    arm = variant({"effects": effects}, "cdsm_lab")
    return replay_arm(arm, recording.time_s, recording.command_rad, recording.forces_n)


def test_without_effects_it_is_the_nominal_arm():
    assert_allclose(simulator().predict([{}])[0], replayed(), atol=1e-6)


@pytest.mark.parametrize(
    "terms",
    [
        {MASS_KG: 0.4},
        {GAIN: 0.1},
        {FRICTION: 0.05},
        {Term("cable_tolerance", "cable_7", "pretension_n"): 0.3, MASS_KG: 0.2},
        {Term("capstan_friction", "arm", "coefficient"): 0.1, OFFSET_N: 2.0},
    ],
    ids=lambda terms: "+".join(term.effect for term in terms),
)
def test_an_assignment_predicts_what_the_amended_file_replays(terms):
    listed = [(t.effect, t.place, {t.parameter: value}) for t, value in terms.items()]
    assert_allclose(simulator().predict([terms])[0], replayed(*listed), atol=1e-6)


def test_variants_are_predicted_side_by_side():
    variants = [{FRICTION: torque, MASS_KG: 0.2} for torque in (0.0, 0.05, 0.1)]
    together = simulator().predict(variants)
    assert together.shape == (3, len(RECORDING), 12)
    for p, one in enumerate(variants):
        assert_allclose(together[p], simulator().predict([one])[0], atol=1e-3)


def test_a_tension_leaks_is_late_is_scaled_and_shifted_in_this_order():
    """Whatever the order in which effects were found."""
    ideal = simulator().predict([{}])[0]
    read = simulator().predict([{OFFSET_N: 3.0, GAIN: 0.1, SHARE: 0.2}])[0]
    assert_allclose(read[:, 1], 1.1 * (ideal[:, 1] + 0.2 * ideal[:, 0]) + 3.0, atol=1e-6)
    assert_allclose(read[:, 2:], ideal[:, 2:], atol=1e-6)


@pytest.mark.parametrize("found", [(OFFSET_N, GAIN), (GAIN, OFFSET_N)], ids=["offset", "gain"])
def test_the_amended_arm_replays_as_the_diagnosis_simulated_it(found):
    values = {term: {GAIN: 0.1, OFFSET_N: 10.0}[term] for term in found}
    run = RECORDING.time_s, RECORDING.command_rad, RECORDING.forces_n
    amended = replay_arm(amended_arm(LAB, values, {}), *run)
    assert_allclose(simulator().predict([values])[0], amended, rtol=0.0, atol=1e-9)


def test_the_zero_that_a_workshop_leaves_is_not_scaled():
    zero_n = Term("cable_tolerance", "cable_2", "zero_n")
    ideal = simulator().predict([{}])[0][:, 1]
    read = simulator().predict([{zero_n: 0.2, GAIN: 0.1}])[0][:, 1]
    assert_allclose(read, 1.1 * ideal + 0.2, atol=1e-6)


def test_numbers_that_are_not_given_are_the_defaults():
    (entry,) = entries_from({Term("cable_creep", "arm", "share"): 0.2})
    defaults = {p.name: p.default for p in known_effects()["cable_creep"].parameters}
    assert entry.values == {**defaults, "share": 0.2}


def test_one_effect_in_two_places_is_two_entries():
    other = Term("payload", "segment_3", "mass_kg")
    entries = entries_from({MASS_KG: 0.1, GAIN: 0.1, other: 0.2})
    payloads = [(e.place, e.values["mass_kg"]) for e in entries if e.effect.name == "payload"]
    assert payloads == [("segment_2", 0.1), ("segment_3", 0.2)]


def test_what_the_arm_file_lists_already_stays():
    listed = ("payload", "segment_2", {"mass_kg": 0.4})
    arm = variant(
        {"effects": [{"effect": listed[0], "at": listed[1], "parameters": listed[2]}]}, "cdsm_lab"
    )
    assert_allclose(simulator(arm).predict([{}])[0], replayed(listed), atol=1e-6)
    both = simulator(arm).predict([{GAIN: 0.1}])[0]
    assert_allclose(both, replayed(listed, ("sensor_gain", "cable_2", {"gain": 0.1})), atol=1e-6)


def test_every_known_effect_is_a_candidate_or_a_tolerance():
    arm = simulator()
    names = [c.effect for c in (*arm.candidates, *arm.tolerances)]
    assert sorted(names) == sorted(known_effects())
    assert all(known_effects()[c.effect].tolerance for c in arm.tolerances)
    assert not any(known_effects()[c.effect].tolerance for c in arm.candidates)


def test_history_dependent_effects_say_so():
    assert {c.effect for c in simulator().candidates if c.history_dependent} == HISTORY_DEPENDENT


def test_every_place_of_every_candidate_can_be_simulated():
    short = RECORDING.rows(slice(0, 2))
    arm = simulator(recording=short)
    for candidate in (*arm.candidates, *arm.tolerances):
        for place in (candidate.places[0], candidate.places[-1]):
            terms = zip(candidate.terms(place), candidate.parameters, strict=True)
            numbers = {term: parameter.default for term, parameter in terms}
            assert np.isfinite(arm.predict([numbers])).all(), (candidate.effect, place)


def test_the_floor_is_noise_and_step_of_the_sensors():
    sensors = LAB.sensors
    expected = np.hypot(sensors.noise_std_n, sensors.step_n / np.sqrt(12.0))
    assert simulator().floor == pytest.approx(expected)


def pushed(force_n):
    """Three rows, the last two with a force to the side of the tip."""
    return replace(
        RECORDING.rows(slice(0, 3)),
        load_segment=np.array([0, 4, 4]),
        load_n=np.outer([0.0, 1.0, 1.0], [0.0, force_n, 0.0]),
    )


def test_where_the_arm_finds_no_rest_there_are_no_numbers():
    assert np.isnan(simulator(recording=pushed(5e4)).predict([{}])).all()


def test_rows_that_a_variant_cannot_bear_are_those_of_the_nominal_arm():
    change = Term("cable_stiffness", "arm", "change")
    arm = simulator(recording=pushed(300.0))
    found = arm.predict([{change: 0.0}, {change: -0.8}])
    nominal = arm.predict([{}])[0]
    assert np.isfinite(found).all()
    assert_allclose(found[0], nominal, atol=1e-6)
    unborne = np.isclose(found[1], nominal, atol=1e-9).all(axis=-1)
    assert unborne.any()


def test_a_second_question_is_answered_as_the_first():
    arm = simulator()
    first = arm.predict([{MASS_KG: 0.3}])
    arm.predict([{MASS_KG: -0.2}])
    assert_allclose(arm.predict([{MASS_KG: 0.3}]), first, atol=1e-6)


def test_a_recording_is_not_changed_by_simulating_it():
    before = RECORDING.tensions_n.copy(), RECORDING.command_rad.copy()
    simulator().predict([{FRICTION: 0.05, OFFSET_N: 2.0}])
    assert_array_equal(RECORDING.tensions_n, before[0])
    assert_array_equal(RECORDING.command_rad, before[1])


MASS_KG_TERM = Term("payload", "segment_3", "mass_kg")
ROLL_RAD, PITCH_RAD = (Term("base_tilt", "arm", f"{name}_rad") for name in ("roll", "pitch"))
GAINS = [Term("sensor_gain", f"cable_{n}", "gain") for n in (2, 11)]
ZERO_N = Term("cable_tolerance", "cable_5", "zero_n")
FRICTION_TERM = Term("capstan_friction", "arm", "coefficient")
PAST = Term("capstan_friction", "arm", "start_cable_4")


def listed(arm):
    return [(e.effect, e.at, dict(e.parameters)) for e in arm.effects]


def test_one_entry_for_each_effect_and_place_with_all_its_numbers():
    values = {ROLL_RAD: 0.02, PITCH_RAD: -0.01, GAINS[0]: 0.03, GAINS[1]: -0.02}
    assert listed(amended_arm(LAB, values, {ZERO_N: 0.04})) == [
        ("base_tilt", "arm", {"roll_rad": 0.02, "pitch_rad": -0.01}),
        ("sensor_gain", "cable_2", {"gain": 0.03}),
        ("sensor_gain", "cable_11", {"gain": -0.02}),
        ("cable_tolerance", "cable_5", {"zero_n": 0.04}),
    ]


def test_what_the_file_lists_already_stays_first():
    worn = variant({"effects": [{"effect": "payload", "at": "segment_1"}]}, "cdsm_lab")
    found = amended_arm(worn, {GAINS[0]: 0.03}, {})
    assert [name for name, *_ in listed(found)] == ["payload", "sensor_gain"]


def test_nothing_found_is_the_nominal_arm():
    assert amended_arm(LAB, {}, {}).identity == LAB.identity


def test_without_its_effects_it_is_the_nominal_arm_so_models_of_that_one_fit():
    amended = amended_arm(LAB, {MASS_KG_TERM: 0.2}, {})
    assert amended.identity != LAB.identity
    assert amended.nominal.identity == LAB.identity


@pytest.mark.parametrize("beyond", [-1e3, 1e3])
def test_numbers_beyond_their_range_are_put_at_its_end(beyond, tmp_path):
    amended = amended_arm(
        LAB,
        {MASS_KG_TERM: beyond, FRICTION_TERM: beyond, PAST: beyond},
        {ZERO_N: beyond},
    )
    write_arm(tmp_path / "arm.yaml", amended, "put")
    assert load_arm(tmp_path / "arm.yaml").effects == amended.effects
    assert abs(amended.effects[1].parameters["start_cable_4"]) == 1.0


@pytest.mark.slow
@settings(deadline=None)
@given(
    mass_kg=st.floats(-0.5, 10.0),
    roll_rad=st.floats(-0.6, 0.6),
    zero_n=st.floats(-0.5, 0.5),
    heading=st.text(st.characters(codec="utf-8", categories=["L", "P", "Zs"]), max_size=60),
)
def test_the_file_reads_back_as_the_same_arm(tmp_path_factory, mass_kg, roll_rad, zero_n, heading):
    amended = amended_arm(LAB, {MASS_KG_TERM: mass_kg, ROLL_RAD: roll_rad}, {ZERO_N: zero_n})
    path = tmp_path_factory.getbasetemp() / "amended.yaml"
    write_arm(path, amended, heading)
    assert load_arm(path) == amended
    assert load_arm(path).identity == amended.identity


def test_the_heading_is_comment_lines_and_the_whole_arm_needs_no_place(tmp_path):
    path = tmp_path / "arm.yaml"
    write_arm(path, amended_arm(LAB, {ROLL_RAD: 0.02}, {}), "found:\nbase tilt")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# found:\n# base tilt\nname: cdsm_lab\n")
    assert "at:" not in text


def test_the_file_predicts_what_the_diagnosis_did(tmp_path):
    values = {MASS_KG_TERM: 0.3, GAINS[0]: 0.03, ZERO_N: 0.1}
    recording = small_recording(peak_n=20.0).rows(slice(0, 60))
    path = tmp_path / "arm.yaml"
    write_arm(path, amended_arm(LAB, values, {}), "x")
    replayed = replay_arm(
        load_arm(path), recording.time_s, recording.command_rad, recording.forces_n
    )
    assert_allclose(replayed, ArmSimulator(LAB, recording).predict([values])[0], atol=1e-6)


@pytest.mark.parametrize(("arm", "slack_n"), [(LAB, 2.5), (five_by_four(), 2.5), (TAUT, 5.0)])
def test_one_cable_less_than_a_segment_has_may_be_slack(arm, slack_n):
    """A cable is slack below a twentieth of the arm's own pretension."""
    for slack in range(arm.cables.per_segment + 2):
        tensions_n = np.full((1, arm.cable_count), 40.0)
        tensions_n[0, :slack] = 0.99 * slack_n
        tensions_n[0, slack : slack + 3] = 1.01 * slack_n
        one = has_one_equilibrium(tensions_n, arm)
        assert one.tolist() == [slack < arm.cables.per_segment]


def test_every_row_is_judged_by_itself_whatever_is_in_front():
    tensions_n = np.full((3, 5, 12), 40.0)
    tensions_n[1, 4, :3] = 0.0
    one = has_one_equilibrium(tensions_n, LAB)
    assert one.shape == (3, 5)
    assert np.argwhere(~one).tolist() == [[1, 4]]


def test_rows_count_by_the_arm_without_its_effects():
    """A zero that is off makes no cable slack, and what a diagnosis adds changes no row's part."""
    recording = small_recording(peak_n=150.0)
    nominal_n = ArmSimulator(LAB, recording).predict([{}])[0]
    counted = counted_rows(LAB, recording, nominal_n)
    assert_array_equal(counted, has_one_equilibrium(nominal_n, LAB))
    assert 0 < counted.sum() < len(recording)
    zeros = {Term("sensor_offset", f"cable_{i}", "offset_n"): -49.0 for i in (1, 2, 3)}
    amended = amended_arm(LAB, {MASS_KG_TERM: 0.4, **zeros}, {})
    predicted_n = replay_arm(amended, recording.time_s, recording.command_rad, recording.forces_n)
    assert_array_equal(counted_rows(amended, recording, predicted_n), counted)


def test_an_arm_file_is_replaced_and_never_written_over(tmp_path):
    path, former = tmp_path / "arm.yaml", tmp_path / "former.yaml"
    write_arm(path, LAB, "former")
    os.link(path, former)
    write_arm(path, amended_arm(LAB, {ROLL_RAD: 0.02}, {}), "amended")
    assert load_arm(former) == LAB
    with pytest.raises(ArmFileError, match="cannot be written"):
        write_arm(tmp_path / "none" / "arm.yaml", LAB, "")
