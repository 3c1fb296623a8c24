"""The amended arm: what was found stands in the file, and the file reads back as that arm."""

from __future__ import annotations

import os

import pytest
from arm_variants import variant
from gap_recordings import LAB, small_recording
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cablesense_gap.arm_simulator import ArmSimulator, amended_arm, write_arm
from cablesense_gap.simulator import Term
from cablesense_sim.arm import ArmFileError, load_arm
from cablesense_sim.replay import replay_arm

MASS_KG = Term("payload", "segment_3", "mass_kg")
ROLL_RAD, PITCH_RAD = (Term("base_tilt", "arm", f"{name}_rad") for name in ("roll", "pitch"))
GAINS = [Term("sensor_gain", f"cable_{n}", "gain") for n in (2, 11)]
ZERO_N = Term("cable_tolerance", "cable_5", "zero_n")
FRICTION = Term("capstan_friction", "arm", "coefficient")
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
    amended = amended_arm(LAB, {MASS_KG: 0.2}, {})
    assert amended.identity != LAB.identity
    assert amended.nominal.identity == LAB.identity


@pytest.mark.parametrize("beyond", [-1e3, 1e3])
def test_numbers_beyond_their_range_are_put_at_its_end(beyond, tmp_path):
    amended = amended_arm(LAB, {MASS_KG: beyond, FRICTION: beyond, PAST: beyond}, {ZERO_N: beyond})
    write_arm(tmp_path / "arm.yaml", amended, "put")
    assert load_arm(tmp_path / "arm.yaml").effects == amended.effects
    assert abs(amended.effects[1].parameters["start_cable_4"]) == 1.0


@given(
    mass_kg=st.floats(-0.5, 10.0),
    roll_rad=st.floats(-0.6, 0.6),
    zero_n=st.floats(-0.5, 0.5),
    heading=st.text(st.characters(codec="utf-8", categories=["L", "P", "Zs"]), max_size=60),
)
def test_the_file_reads_back_as_the_same_arm(tmp_path_factory, mass_kg, roll_rad, zero_n, heading):
    amended = amended_arm(LAB, {MASS_KG: mass_kg, ROLL_RAD: roll_rad}, {ZERO_N: zero_n})
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
    values = {MASS_KG: 0.3, GAINS[0]: 0.03, ZERO_N: 0.1}
    course = small_recording(peak_n=20.0).rows(slice(0, 60))
    path = tmp_path / "arm.yaml"
    write_arm(path, amended_arm(LAB, values, {}), "x")
    replayed = replay_arm(load_arm(path), course.time_s, course.command_rad, course.forces_n)
    assert_allclose(replayed, ArmSimulator(LAB, course).predict([values])[0], atol=1e-6)


def test_an_arm_file_is_replaced_and_never_written_over(tmp_path):
    path, former = tmp_path / "arm.yaml", tmp_path / "former.yaml"
    write_arm(path, LAB, "former")
    os.link(path, former)
    write_arm(path, amended_arm(LAB, {ROLL_RAD: 0.02}, {}), "amended")
    assert load_arm(former) == LAB
    with pytest.raises(ArmFileError, match="cannot be written"):
        write_arm(tmp_path / "none" / "arm.yaml", LAB, "")
