"""The arm as the diagnosis simulates it, the amended arm in its file, and states of the past."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from arm_variants import five_by_four, variant
from gap_recordings import LAB, small_recording
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.amended_arm import amended_arm, write_arm
from cablesense_gap.arm_simulator import (
    ArmSimulator,
    counted_rows,
    entries_from,
    has_one_equilibrium,
    removed_on,
    settled,
)
from cablesense_gap.simulator import Term
from cablesense_sim.arm import ArmFileError, ListedEffect, load_arm
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
MASS_KG = Term("payload", "segment_2", "mass_kg")
FRICTION = Term("joint_friction", "joint_1", "torque_n_m")
ROLL_RAD, PITCH_RAD = (Term("base_tilt", "arm", f"{name}_rad") for name in ("roll", "pitch"))
ZERO_N = Term("cable_tolerance", "cable_5", "zero_n")


def simulator(arm=LAB, recording=RECORDING):
    return ArmSimulator(arm, recording)


def having(*listed):
    effects = [{"effect": e, "at": at, "parameters": numbers} for e, at, numbers in listed]
    return variant({"effects": effects}, "cdsm_lab")


def replayed(arm, recording=RECORDING):
    return replay_arm(arm, *recording.inputs)


@pytest.mark.parametrize(
    "terms",
    [
        {},
        {MASS_KG: 0.4},
        {GAIN: 0.1},
        {FRICTION: 0.05},
        {Term("cable_tolerance", "cable_7", "pretension_n"): 0.3, MASS_KG: 0.2},
        {Term("capstan_friction", "arm", "coefficient"): 0.1, OFFSET_N: 2.0},
    ],
    ids=lambda terms: "+".join(term.effect for term in terms) or "nominal",
)
def test_an_assignment_predicts_what_the_amended_file_replays(terms):
    listed = [(t.effect, t.place, {t.parameter: value}) for t, value in terms.items()]
    assert_allclose(simulator().predict([terms])[0], replayed(having(*listed)), atol=1e-6)


def test_variants_are_predicted_together_as_one_by_one():
    arm = simulator()
    variants = [{FRICTION: torque, MASS_KG: 0.2} for torque in (0.0, 0.05, 0.1)]
    together = arm.predict(variants)
    assert together.shape == (3, len(RECORDING), 12)
    for p, one in enumerate(variants):
        assert_allclose(together[p], arm.predict([one])[0], atol=1e-3)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_crosstalk_gain_and_offset_act_in_this_order_whatever_the_order_of_the_terms(order):
    """The zero of a tolerance is not scaled; the amended arm replays the same."""
    found = [(OFFSET_N, 3.0), (GAIN, 0.1), (SHARE, 0.2)]
    values = dict(found[k] for k in order)
    ideal, read = simulator().predict([{}])[0], simulator().predict([values])[0]
    assert_allclose(read[:, 1], 1.1 * (ideal[:, 1] + 0.2 * ideal[:, 0]) + 3.0, atol=1e-6)
    assert_allclose(read[:, 2:], ideal[:, 2:], atol=1e-6)
    assert_allclose(replayed(amended_arm(LAB, values, {})), read, rtol=0.0, atol=1e-9)
    zeroed = simulator().predict([{ZERO_N._replace(place="cable_2"): 0.2, GAIN: 0.1}])[0]
    assert_allclose(zeroed[:, 1], 1.1 * ideal[:, 1] + 0.2, atol=1e-6)


def test_entries_have_defaults_and_one_for_each_place():
    (entry,) = entries_from({Term("cable_creep", "arm", "share"): 0.2})
    defaults = {p.name: p.default for p in known_effects()["cable_creep"].parameters}
    assert entry.values == {**defaults, "share": 0.2}
    other = MASS_KG._replace(place="segment_3")
    entries = entries_from({MASS_KG: 0.1, GAIN: 0.1, other: 0.2})
    payloads = [(e.place, e.values["mass_kg"]) for e in entries if e.effect.name == "payload"]
    assert payloads == [("segment_2", 0.1), ("segment_3", 0.2)]


def test_effects_of_the_arm_file_are_part_of_the_nominal_arm():
    payload = ("payload", "segment_2", {"mass_kg": 0.4})
    worn = simulator(having(payload))
    assert_allclose(worn.predict([{}])[0], replayed(having(payload)), atol=1e-6)
    both = replayed(having(payload, ("sensor_gain", "cable_2", {"gain": 0.1})))
    assert_allclose(worn.predict([{GAIN: 0.1}])[0], both, atol=1e-6)


def test_every_known_effect_is_a_candidate_or_a_tolerance_that_can_be_simulated():
    arm = simulator(recording=RECORDING.rows(slice(0, 2)))
    every = (*arm.candidates, *arm.tolerances)
    assert sorted(c.effect for c in every) == sorted(known_effects())
    assert {c.effect for c in arm.tolerances} == {
        name for name, effect in known_effects().items() if effect.tolerance
    }
    assert {c.effect for c in arm.candidates if c.history_dependent} == HISTORY_DEPENDENT
    for candidate in every:
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


def test_rows_without_an_equilibrium_of_a_variant_are_those_of_the_nominal_arm():
    change = Term("cable_stiffness", "arm", "change")
    arm = simulator(recording=pushed(300.0))
    found = arm.predict([{change: 0.0}, {change: -0.8}])
    nominal = arm.predict([{}])[0]
    assert np.isfinite(found).all()
    assert_allclose(found[0], nominal, atol=1e-6)
    assert np.isclose(found[1], nominal, atol=1e-9).all(axis=-1).any()
    assert np.isnan(simulator(recording=pushed(5e4)).predict([{}])).all()


def listed(arm):
    return [(e.effect, e.at, dict(e.parameters)) for e in arm.effects]


def test_the_amended_arm_lists_one_entry_for_each_effect_and_place_after_the_earlier_ones():
    other = GAIN._replace(place="cable_11")
    values = {ROLL_RAD: 0.02, PITCH_RAD: -0.01, GAIN: 0.03, other: -0.02}
    worn = having(("payload", "segment_1", {"mass_kg": 0.1}))
    assert listed(amended_arm(worn, values, {ZERO_N: 0.04})) == [
        ("payload", "segment_1", {"mass_kg": 0.1}),
        ("base_tilt", "arm", {"roll_rad": 0.02, "pitch_rad": -0.01}),
        ("sensor_gain", "cable_2", {"gain": 0.03}),
        ("sensor_gain", "cable_11", {"gain": -0.02}),
        ("cable_tolerance", "cable_5", {"zero_n": 0.04}),
    ]


def test_without_its_effects_the_amended_arm_is_the_nominal_arm_so_that_models_fit():
    assert amended_arm(LAB, {}, {}).identity == LAB.identity
    amended = amended_arm(LAB, {MASS_KG: 0.2}, {})
    assert amended.identity != LAB.identity
    assert amended.nominal.identity == LAB.identity


@pytest.mark.parametrize("beyond", [-1e3, 1e3])
def test_numbers_beyond_their_range_are_put_at_its_end(beyond, tmp_path):
    friction = (Term("capstan_friction", "arm", name) for name in ("coefficient", "start_cable_4"))
    values = dict.fromkeys((MASS_KG, *friction), beyond)
    amended = amended_arm(LAB, values, {ZERO_N: beyond})
    write_arm(tmp_path / "arm.yaml", amended, "put")
    assert load_arm(tmp_path / "arm.yaml").effects == amended.effects
    assert abs(amended.effects[1].parameters["start_cable_4"]) == 1.0


@pytest.mark.parametrize("mass_kg", [-0.5, 1.0 / 3.0, 10.0])
def test_the_file_reads_back_as_the_same_arm(tmp_path, mass_kg):
    amended = amended_arm(LAB, {MASS_KG: mass_kg, ROLL_RAD: 0.02}, {ZERO_N: mass_kg / 20.0})
    path = tmp_path / "arm.yaml"
    write_arm(path, amended, "found: «base tilt»\n- 'and' more")
    assert load_arm(path) == amended
    assert load_arm(path).identity == amended.identity
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# found: «base tilt»\n# - 'and' more\nname: cdsm_lab\n")
    assert "at: arm" not in text


def test_an_arm_file_is_replaced_and_never_written_over(tmp_path):
    path, former = tmp_path / "arm.yaml", tmp_path / "former.yaml"
    write_arm(path, LAB, "former")
    os.link(path, former)
    write_arm(path, amended_arm(LAB, {ROLL_RAD: 0.02}, {}), "amended")
    assert load_arm(former) == LAB
    with pytest.raises(ArmFileError, match="cannot be written"):
        write_arm(tmp_path / "none" / "arm.yaml", LAB, "")


@pytest.mark.parametrize(("arm", "slack_n"), [(LAB, 2.5), (five_by_four(), 2.5), (TAUT, 5.0)])
def test_one_cable_less_than_a_segment_has_may_be_slack(arm, slack_n):
    """A cable is slack below a twentieth of the arm's own pretension."""
    tensions_n = np.full((arm.cables.per_segment + 2, 1, arm.cable_count), 40.0)
    for slack, row in enumerate(tensions_n):
        row[:, :slack] = 0.99 * slack_n
        row[:, slack : slack + 3] = 1.01 * slack_n
    one = has_one_equilibrium(tensions_n, arm)[:, 0]
    assert one.tolist() == [slack < arm.cables.per_segment for slack in range(len(tensions_n))]


def test_rows_count_by_the_arm_without_its_effects():
    """A sensor zero makes no cable slack, and what a diagnosis adds changes no row's part."""
    recording = small_recording(peak_n=150.0)
    nominal_n = ArmSimulator(LAB, recording).predict([{}])[0]
    counted = counted_rows(LAB, recording, nominal_n)
    assert_array_equal(counted, has_one_equilibrium(nominal_n, LAB))
    assert 0 < counted.sum() < len(recording)
    zeros = {Term("sensor_offset", f"cable_{i}", "offset_n"): -49.0 for i in (1, 2, 3)}
    amended = amended_arm(LAB, {MASS_KG: 0.4, **zeros}, {})
    assert_array_equal(counted_rows(amended, recording, replayed(amended, recording)), counted)


def loose(start: float):
    play = {"play_m": 2e-4, "start": start}
    effect = ListedEffect(effect="actuator_backlash", at="cable_5", parameters=play)
    return LAB.model_copy(update={"effects": [effect]})


@pytest.mark.parametrize("start", [-0.8, 0.6])
def test_the_position_in_a_play_is_found_from_the_first_rows(start):
    recording = small_recording(peak_n=25.0)
    new = replace(recording, tensions_n=replayed(loose(start), recording))
    found = settled(loose(0.0), new, 30)
    assert found.effects[0].parameters["start"] == pytest.approx(start, abs=0.05)
    assert found.effects[0].parameters["play_m"] == 2e-4
    assert_allclose(replayed(found, recording), new.tensions_n, atol=0.1)
    assert settled(LAB, new, 30) is LAB
    unsettled, known = (removed_on(new, LAB, loose(-start), rows, 0.01) for rows in (0, 30))
    assert unsettled < 0.9 < 0.97 < known
