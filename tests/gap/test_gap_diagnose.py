"""From a recording of the arm to a verdict: the whole way, on a short course."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_base.errors import CableSenseError
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.diagnose import Diagnosis, diagnose
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.simulator import Assignment, Term
from cablesense_sim.replay import replay_arm
from cablesense_sim.sensors import read_tensions_n

COURSE = small_recording(peak_n=25.0)
MASS_KG = 0.5


def made(truth: Assignment, seed: int = 0) -> Recording:
    """The course as read off an arm with what is true of it, and what a workshop leaves."""
    simulator, rng = ArmSimulator(LAB, COURSE), np.random.default_rng(seed)
    left = {
        term: float(rng.normal(0.0, parameter.typical))
        for tolerance in simulator.tolerances
        for place in tolerance.places
        for term, parameter in zip(tolerance.terms(place), tolerance.parameters, strict=True)
    }
    ideal = simulator.predict([{**left, **truth}])[0]
    return replace(COURSE, tensions_n=read_tensions_n(ideal, LAB.sensors, rng))


@cache
def loaded() -> Diagnosis:
    return diagnose(made({Term("payload", "segment_3", "mass_kg"): MASS_KG}), LAB)


@pytest.mark.slow  # the full library, from which to choose
def test_a_payload_is_found_where_it_is():
    verdict = loaded().verdict
    assert verdict.effects == ("payload",)
    assert verdict.probability > 0.5
    assert verdict.where.segments == ("segment_3",)
    assert verdict.where.cables == verdict.where.joints == ()
    # its middle is known as well as the arm's own masses, which scatter by half a percent
    assert verdict.parameters["payload.mass_kg"].value == pytest.approx(MASS_KG, rel=0.06)


@pytest.mark.slow
def test_what_it_leaves_is_the_noise():
    gap = loaded().verdict.gap
    assert gap.before_n > 20.0 * gap.floor_n
    assert gap.after_n < 1.2 * gap.floor_n
    assert gap.removed_fraction > 0.98
    assert gap.ci95[0] <= gap.removed_fraction <= gap.ci95[1]


@pytest.mark.slow
def test_the_amended_arm_reads_as_is_said():
    """Tolerances go in linearly in the one, and bend the arm in the other: less than the noise."""
    found = loaded()
    replayed = replay_arm(found.amended, COURSE.time_s, COURSE.command_rad, COURSE.forces_n)
    difference_n = replayed - found.predicted_after_n
    assert np.sqrt((difference_n**2).mean()) < found.verdict.gap.floor_n


@pytest.mark.slow
def test_the_candidates_are_of_one_truth():
    candidates = loaded().verdict.ranked
    assert sum(c.probability for c in candidates) == pytest.approx(1.0)
    assert candidates[0].effects == loaded().verdict.effects
    assert {("none",), ("unknown",)} <= {c.effects for c in candidates}


@pytest.mark.slow
def test_what_a_workshop_leaves_is_no_effect():
    verdict = diagnose(made({}, seed=1), LAB).verdict
    assert verdict.effects == ("none",)
    assert verdict.parameters == {}


def test_a_load_that_the_nominal_arm_cannot_bear_is_refused_in_a_line():
    load_n = COURSE.load_n.copy()
    load_n[25:40] = [0.0, 1500.0, 0.0]
    with pytest.raises(CableSenseError, match="guide plates touch"):
        diagnose(replace(COURSE, load_n=load_n), LAB)
