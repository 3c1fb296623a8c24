"""From a recording of the arm to a verdict: the whole way, its folds and places."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_gap.amended_arm import amended_arm, judged_earlier, listed_values, without_effects
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem, Diagnosis, diagnose, parts_of
from cablesense_gap.reference import Reference
from cablesense_gap.report.text import earlier_sentence
from cablesense_gap.simulator import Assignment, Term, parameters_of
from cablesense_gap.system import FOLDS, problem_of
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import read_tensions_n, replay_arm
from tests.helpers.gap_problem import hypothesis
from tests.helpers.gap_recordings import (
    LAB,
    placed_recording,
    propose_no_experiment,
    small_recording,
)

PROTOCOL = small_recording(peak_n=25.0)
MASS = Term("payload", "segment_3", "mass_kg")
MASS_KG = 0.5
READ = ("Topics are those of a bag.",)
"""What is said of a recording that nothing is wrong with."""


def made(truth: Assignment, seed: int = 0, course: Recording = PROTOCOL) -> Recording:
    """The course as recorded on an arm with these effects and manufacturing tolerances."""
    simulator = ArmSimulator(LAB, course)
    rng = np.random.default_rng(seed)
    tolerances = parameters_of(simulator.tolerances)
    scatter = {term: float(rng.normal(0.0, each.typical)) for term, each in tolerances.items()}
    ideal = simulator.predict([{**scatter, **truth}])[0]
    return replace(course, tensions_n=read_tensions_n(ideal, LAB.sensors, rng))


@pytest.fixture(autouse=True)
def no_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The proposal of the next experiment has tests of its own."""
    propose_no_experiment(monkeypatch)


@cache
def loaded() -> Diagnosis:
    """With a payload, and two rows whose load the nominal arm cannot bear."""
    recording = made({MASS: MASS_KG})
    load_n = recording.load_n.copy()
    load_n[26:28] = [0.0, 1500.0, 0.0]
    return diagnose(replace(recording, load_n=load_n, notes=READ), LAB)


def test_withheld_trials_count_nowhere():
    problem = problem_of(ArmSystem(LAB, PROTOCOL, unseen=(2, 5)))
    assert set(PROTOCOL.trial[problem.used]) == set(PROTOCOL.trial) - {2, 5}
    others = np.delete(problem.fold, [2, 5])
    assert set(others) == set(range(FOLDS))


def test_a_long_trial_is_held_out_in_parts_and_others_whole():
    numbers = np.where(PROTOCOL.trial < 4, 0, PROTOCOL.trial)
    long = numbers == 0
    assert long.mean() > 1.0 / FOLDS
    part, fold = parts_of(replace(PROTOCOL, trial=numbers))
    assert np.ptp(np.bincount(fold[part][long], minlength=FOLDS)) <= 1
    assert (np.diff(part[long]) != 0).sum() == FOLDS - 1
    assert len(set(zip(numbers[~long], part[~long], strict=True))) == len(set(numbers[~long]))


@pytest.mark.slow  # the full library, from which to choose
def test_a_payload_is_found_where_it_is():
    verdict = loaded().verdict
    assert verdict.effects == ("payload",)
    assert verdict.probability > 0.5
    assert verdict.where.segments == ("segment_3",)
    assert verdict.where.cables == verdict.where.joints == ()
    # its middle is known as well as the arm's own masses, which scatter by half a percent
    assert verdict.parameters["payload.mass_kg"].value == pytest.approx(MASS_KG, rel=0.06)
    assert verdict.gap.before_n > 20.0 * verdict.gap.floor_n
    assert verdict.gap.after_n < 1.2 * verdict.gap.floor_n
    assert verdict.gap.ci95[0] <= verdict.gap.removed_fraction <= verdict.gap.ci95[1]
    assert sum(c.probability for c in verdict.ranked) == pytest.approx(1.0)
    assert verdict.ranked[0].effects == verdict.effects
    assert {("none",), ("unknown",)} <= {c.effects for c in verdict.candidates}


def test_where_tensions_show_the_moment_alone_it_is_stated_and_no_mass_below_zero():
    """The recorded readings fix mass times lever; any lever within the segment is possible."""
    mass, middle = (Term("payload", "segment_1", n) for n in ("mass_kg", "beyond_middle"))
    values = {mass: 0.2, middle: 0.0}
    alone = np.array([-0.2 / 0.5 / 0.3, 1.0 / 0.3])  # keeps the product; in typical sizes
    known = replace(
        hypothesis("payload"),
        values=values,
        deviations=dict(zip(values, 1.96 * 0.3 * np.abs(alone) * [0.3, 0.3], strict=True)),
        covariance=0.3**2 * np.outer(alone, alone),
    )
    numbers = ArmSystem(LAB, PROTOCOL).numbers(known, values)
    length_m = mechanism_of(LAB).segment_length_m[0]
    moment = numbers["payload.moment_kg_m"]
    stated = numbers["payload.mass_kg"]
    assert moment.value == pytest.approx(0.2 * 0.5 * length_m)
    np.testing.assert_allclose(moment.ci95, moment.value, rtol=1e-6)
    low, high = stated.ci95
    assert low == pytest.approx(moment.value / length_m)
    assert high > 5.0 * stated.value


@pytest.mark.slow
def test_the_amended_arm_reads_as_the_recorded_one():
    """Fitted tolerances are linear, and bend the arm: the difference is less than the noise."""
    diagnosis = loaded()
    replayed = replay_arm(diagnosis.amended, diagnosis.recording.course)
    left_n = diagnosis.recording.tensions_n - replayed
    assert np.sqrt((left_n**2).mean()) < 1.5 * diagnosis.verdict.gap.floor_n


@pytest.mark.slow
def test_manufacturing_tolerances_are_no_effect():
    verdict = diagnose(made({}, seed=1), LAB).verdict
    assert (verdict.effects, verdict.parameters) == (("none",), {})


@pytest.mark.slow  # simulates every effect twice
def test_a_reference_teaches_what_the_nominal_arm_lacks():
    """Cables that are stiffer the more they carry, on an arm with tolerances of its own."""
    healthy, again = (
        ArmSystem(LAB, replace(r, tensions_n=r.tensions_n + 4e-3 * (nominal_n - 50.0) ** 2))
        for r in (made({}), made({}, course=small_recording(peak_n=20.0)))
        for nominal_n in (replay_arm(LAB, r.course),)
    )
    reference = Reference(healthy)
    assert reference.left.left_n < 0.5 * reference.left.before_n
    system = again.with_listed(reference.tolerances)
    usual = reference.expected(system, problem_of(system))
    before_n, left_n = (
        np.sqrt(((again.readings - each)[again.counted] ** 2).mean())
        for each in (again.nominal_n, system.nominal_n + usual.mean)
    )
    assert left_n < 0.5 * before_n
    assert left_n < 1.5 * usual.floor


@pytest.mark.slow
def test_a_reference_with_exchanged_plugs_is_refused():
    recording = made({})
    order = [0, 4, 2, 3, 1, *range(5, 12)]
    exchanged = replace(recording, tensions_n=recording.tensions_n[:, order])
    with pytest.raises(RecordingError, match="tension_2_n reads cable_5"):
        diagnose(recording, LAB, reference=exchanged)


@pytest.mark.slow
def test_an_offset_of_loads_at_three_places_is_recovered():
    """Twelve millimetres on every segment."""
    placed = placed_recording(peak_n=25.0)
    offset = Term("contact_offset", "arm", "offset_m")
    verdict = diagnose(made({offset: 0.012}, course=placed), LAB).verdict
    assert verdict.effects == ("contact_offset",)
    offset_m = verdict.parameters["contact_offset.offset_m"]
    assert offset_m.value == pytest.approx(0.012, abs=0.0015)  # places scatter by 0.3 mm


def test_perfect_sensors_and_a_load_that_the_arm_cannot_bear_are_refused_in_a_line():
    sensors = LAB.sensors.model_copy(update={"noise_std_n": 0.0, "step_n": 0.0})
    with pytest.raises(CableSenseError, match="noise_std_n and step_n of its sensors are both 0"):
        diagnose(PROTOCOL, LAB.model_copy(update={"sensors": sensors}))
    load_n = PROTOCOL.load_n.copy()
    load_n[PROTOCOL.load_segment > 0] = [0.0, 1500.0, 0.0]
    with pytest.raises(CableSenseError, match="guide plates touch"):
        diagnose(replace(PROTOCOL, load_n=load_n), LAB)


@pytest.mark.slow
def test_few_rows_that_the_nominal_arm_cannot_bear_are_left_out_and_reported():
    diagnosis = loaded()
    assert diagnosis.verdict.rows_used == len(PROTOCOL) - 2
    assert any(text.startswith("rows 27 to 28: ") for text in diagnosis.warnings)
    assert diagnosis.notes == READ
    assert not set(READ) & set(diagnosis.warnings)


OFFSET = Term("contact_offset", "segment_4", "offset_m")
GAIN = Term("sensor_gain", "cable_2", "gain")
ZERO = Term("sensor_tolerance", "cable_5", "zero_n")
LISTED = amended_arm(LAB, {MASS: 0.4, OFFSET: 0.02, GAIN: 0.1}, {ZERO: 0.04})


@pytest.mark.slow  # fits with the simulator
def test_effects_that_the_arm_file_lists_stand_have_changed_or_are_not_needed():
    """The arm has more payload today, the same offset, and a repaired sensor."""
    true = ArmSimulator(LAB, PROTOCOL).predict([{MASS: 0.55, OFFSET: 0.02, ZERO: 0.04}])[0]
    read = read_tensions_n(true, LAB.sensors, np.random.default_rng(0))
    recording = replace(PROTOCOL, tensions_n=read)
    arm, judged = judged_earlier(problem_of(ArmSystem(without_effects(LISTED), recording)), LISTED)
    earlier = {each.effect: each for each in judged}
    outcomes = {"contact_offset": "stands", "payload": "changed", "sensor_gain": "not needed"}
    assert {name: each.outcome for name, each in earlier.items()} == outcomes
    payload = earlier["payload"]
    assert (payload.places, payload.was) == (("segment_3",), {"segment_3.mass_kg": 0.4})
    assert payload.now["segment_3.mass_kg"].value == pytest.approx(0.55, rel=0.05)
    text = earlier_sentence(payload)
    assert "on segment 3" in text
    assert "(was 0.4)" in text
    # the diagnosis continues with the needed effects and their new numbers
    values = listed_values(arm)
    assert set(values) == {MASS, OFFSET}
    assert values[MASS] == pytest.approx(0.55, rel=0.05)


def test_the_package_offers_the_diagnosis_by_a_short_name():
    """No module takes the place of the function, whatever was imported before."""
    import cablesense_gap

    assert cablesense_gap.diagnose is diagnose
