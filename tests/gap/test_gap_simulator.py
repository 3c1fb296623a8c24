"""What a diagnosis knows of a mechanism."""

from __future__ import annotations

from gap_course import size

from cablesense_gap.simulator import Candidate, Term


def test_a_term_is_called_by_effect_place_and_parameter():
    assert str(Term("sensor_gain", "cable_3", "gain")) == "sensor_gain.cable_3.gain"


def test_a_candidate_has_all_its_numbers_in_each_place():
    tilt = Candidate("tilt", ("arm", "base"), (size("roll"), size("pitch")))
    assert tilt.terms("base") == (Term("tilt", "base", "roll"), Term("tilt", "base", "pitch"))


def test_what_is_not_said_to_remember_does_not():
    assert not Candidate("tilt", ("arm",), (size("roll"),)).remembers
