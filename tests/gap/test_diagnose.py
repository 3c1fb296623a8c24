"""From a recording of the arm to a verdict: the whole way, and its folds, sizes and places."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_problem import CHANNELS, TRIAL, explanation, rate, size
from gap_recordings import LAB, RATE_HZ, small_recording

from cablesense_base import CableSenseError
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem, Diagnosis, diagnose, folds_of, places_of
from cablesense_gap.explained import (
    NEGLIGIBLE,
    estimates,
    gap_size,
    rmse_interval_n,
    significant_values,
)
from cablesense_gap.pipeline import FOLDS, problem_of
from cablesense_gap.recordings import thinning
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.report.page import report_page
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.replay import read_tensions_n, replay_arm

PROTOCOL = small_recording(peak_n=25.0)
MASS_KG = 0.5


def made(truth: Assignment, seed: int = 0) -> Recording:
    """The protocol as recorded on an arm with these effects and manufacturing tolerances."""
    simulator, rng = ArmSimulator(LAB, PROTOCOL), np.random.default_rng(seed)
    left = {
        term: float(rng.normal(0.0, parameter.typical))
        for tolerance in simulator.tolerances
        for place in tolerance.places
        for term, parameter in zip(tolerance.terms(place), tolerance.parameters, strict=True)
    }
    ideal = simulator.predict([{**left, **truth}])[0]
    return replace(PROTOCOL, tensions_n=read_tensions_n(ideal, LAB.sensors, rng))


@cache
def loaded() -> Diagnosis:
    return diagnose(made({Term("payload", "segment_3", "mass_kg"): MASS_KG}), LAB)


def test_trials_that_are_not_to_be_seen_count_nowhere():
    problem = problem_of(ArmSystem(LAB, PROTOCOL, unseen=(2, 5)))
    assert set(PROTOCOL.trial[problem.used]) == set(PROTOCOL.trial) - {2, 5}
    others = np.delete(problem.fold, [2, 5])
    assert set(others) == set(range(FOLDS))


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
    replayed = replay_arm(found.amended, PROTOCOL.time_s, PROTOCOL.command_rad, PROTOCOL.forces_n)
    difference_n = replayed - found.predicted_after_n
    assert np.sqrt((difference_n**2).mean()) < found.verdict.gap.floor_n


@pytest.mark.slow
def test_the_candidates_are_of_one_truth():
    candidates = loaded().verdict.ranked
    assert sum(c.probability for c in candidates) == pytest.approx(1.0)
    assert candidates[0].effects == loaded().verdict.effects
    assert {("none",), ("unknown",)} <= {c.effects for c in candidates}


@pytest.mark.slow
def test_a_long_recording_is_diagnosed_on_some_of_its_rows(monkeypatch):
    monkeypatch.setattr(thinning, "MOST_ROWS", len(PROTOCOL))
    short = made({Term("payload", "segment_3", "mass_kg"): MASS_KG})
    often = 20
    long = replace(
        short.rows(np.repeat(np.arange(len(short)), often)),
        time_s=np.arange(often * len(short)) / (often * RATE_HZ),
    )
    found = diagnose(long, LAB)
    assert found.verdict.effects == ("payload",)
    assert found.verdict.where.segments == ("segment_3",)
    assert found.verdict.rows == often * len(short)
    assert found.verdict.rows_used == len(found.recording) <= len(short)
    assert f"of {found.verdict.rows:,} rows used" in " ".join(report_page(found).split())
    assert loaded().verdict.rows_used == loaded().verdict.rows == len(short)


@pytest.mark.slow
def test_what_a_workshop_leaves_is_no_effect():
    verdict = diagnose(made({}, seed=1), LAB).verdict
    assert verdict.effects == ("none",)
    assert verdict.parameters == {}


def test_perfect_sensors_are_refused_before_the_search():
    sensors = LAB.sensors.model_copy(update={"noise_std_n": 0.0, "step_n": 0.0})
    with pytest.raises(CableSenseError, match="noise_std_n and step_n of its sensors are both 0"):
        diagnose(PROTOCOL, LAB.model_copy(update={"sensors": sensors}))


def test_a_load_that_the_nominal_arm_cannot_bear_is_refused_in_a_line():
    load_n = PROTOCOL.load_n.copy()
    load_n[25:40] = [0.0, 1500.0, 0.0]
    with pytest.raises(CableSenseError, match="guide plates touch"):
        diagnose(replace(PROTOCOL, load_n=load_n), LAB)


def test_few_rows_that_the_nominal_arm_cannot_bear_are_left_out_and_said():
    recording = made({Term("payload", "segment_3", "mass_kg"): MASS_KG})
    load_n = recording.load_n.copy()
    load_n[26:28] = [0.0, 1500.0, 0.0]
    found = diagnose(replace(recording, load_n=load_n), LAB)
    assert found.verdict.effects == ("payload",)
    assert found.verdict.rows_used == len(recording) - 2
    assert any(text.startswith("rows 27 to 28: ") for text in found.findings)


def trials(kinds: list[tuple[int, bool]], rows: int = 4) -> Recording:
    """A recording of trials, each with a segment that is loaded, and moving or not."""
    count = rows * len(kinds)
    command = np.zeros((count, 8))
    command[:, 0] = np.tile(np.linspace(0.0, 0.1, rows), len(kinds))
    command[np.repeat([not moves for _, moves in kinds], rows)] = 0.0
    segment = np.repeat([segment for segment, _ in kinds], rows)
    return Recording(
        name="trials",
        time_s=0.2 * np.arange(count),
        trial=np.repeat(np.arange(len(kinds)), rows),
        command_rad=command,
        load_segment=segment,
        load_n=np.outer(segment > 0, [0.0, 0.0, -5.0]),
        tensions_n=np.full((count, 12), 50.0),
    )


def test_every_trial_has_a_fold_and_the_folds_are_alike_in_size():
    fold = folds_of(small_recording())
    assert len(fold) == 10
    assert set(fold) == set(range(FOLDS))
    assert np.ptp(np.bincount(fold)) <= 1


def test_trials_of_one_kind_are_in_folds_of_their_own():
    kinds = [(0, True), (1, False), (2, False), (0, False)] * FOLDS
    fold = folds_of(trials(kinds))
    for kind in set(kinds):
        assert sorted(fold[[k == kind for k in kinds]]) == list(range(FOLDS))


def test_what_few_trials_there_are_are_held_out_one_by_one():
    assert sorted(folds_of(trials([(1, False), (0, True)]))) == [0, 1]


def test_numbers_of_trials_may_have_gaps():
    recorded = small_recording()
    renumbered = replace(recorded, trial=7 * recorded.trial + 3)
    assert folds_of(renumbered).tolist() == folds_of(recorded).tolist()


@pytest.mark.parametrize("moves", [False, True])
def test_a_load_counts_however_short_it_is(moves: bool):
    """A cycle begins and ends without a load; its kind is that of its loaded rows."""
    recorded = trials([(3, moves)] * 4 + [(0, moves)] * 4)
    brief = recorded.load_segment.copy()
    brief[::4] = 0
    shortened = replace(recorded, load_segment=brief)
    assert folds_of(shortened).tolist() == folds_of(recorded).tolist()


CABLES, ROWS, TRIALS = 3, 40, 20
TRIALS_OF = np.repeat(np.arange(TRIALS), ROWS)
RNG = np.random.default_rng(3)
WHITE = RNG.normal(size=(len(TRIALS_OF), CABLES))


def test_sizes_are_root_mean_squares():
    by_cable = np.array([0.5, 1.0, 2.0])
    before_n, after_n = (
        np.tile(by_cable, (len(TRIALS_OF), 1)),
        np.full((len(TRIALS_OF), CABLES), 0.1),
    )
    found = gap_size(before_n, after_n, TRIALS_OF, floor_n=0.1)
    assert found.before_n == pytest.approx(np.sqrt((by_cable**2).mean()))
    assert found.by_cable_n == pytest.approx(tuple(by_cable))
    assert (found.after_n, found.floor_n) == (pytest.approx(0.1), 0.1)
    assert found.removed_fraction == pytest.approx(1.0)
    assert found.ci95 == pytest.approx((1.0, 1.0))


def test_half_of_what_can_be_removed_is_a_half():
    ones = np.ones((len(TRIALS_OF), CABLES))
    assert gap_size(1.1 * ones, 0.6 * ones, TRIALS_OF, 0.1).removed_fraction == pytest.approx(0.5)


def test_a_gap_that_grew_is_below_zero_and_nothing_to_remove_is_none():
    ones = np.ones((len(TRIALS_OF), CABLES))
    assert gap_size(1.0 * ones, 1.5 * ones, TRIALS_OF, 0.1).removed_fraction < 0.0
    assert gap_size(0.05 * ones, 0.02 * ones, TRIALS_OF, 0.1).removed_fraction == 0.0


def test_trials_that_differ_widen_the_interval():
    """As many rows, as large a gap; what counts is how far trials agree."""
    alike = 1.0 + 0.1 * WHITE
    by_trial = np.repeat(RNG.uniform(0.2, 1.8, TRIALS), ROWS)[:, None] * alike
    narrow, wide = (gap_size(2.0 * alike, r, TRIALS_OF, 0.01).ci95 for r in (alike, by_trial))
    assert wide[1] - wide[0] > 5.0 * (narrow[1] - narrow[0])


def test_the_same_residuals_give_the_same_interval():
    one, other = (gap_size(2.0 * WHITE, WHITE, TRIALS_OF, 0.1) for _ in range(2))
    assert one == other


def test_trials_whose_rows_do_not_count_say_nothing():
    """Where only two of three trials are left, a draw must not meet the empty one alone."""
    few = np.isin(TRIALS_OF, [1, 4])
    found = gap_size(2.0 * WHITE[few], WHITE[few], TRIALS_OF[few], 0.1)
    assert np.isfinite(found.ci95).all()
    squares, count = np.array([0.0, 8.0, 18.0]), np.array([0.0, 2.0, 2.0])
    assert rmse_interval_n(squares, count) == pytest.approx((2.0, 3.0))


def test_the_interval_of_a_size_holds_it_as_often_as_it_says():
    held = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        squares = (rng.normal(size=(30, 50)) ** 2).sum(1)
        low, high = rmse_interval_n(squares, np.full(30, 50.0))
        held += low <= 1.0 <= high
    assert 0.85 < held / 200 < 0.99


LEAK = Candidate("leak", ("a", "b", "c"), (size("amount"), rate()))
HEAVY = Candidate("heavy", ("a",), (size("amount"),))
SHAPE = (len(TRIAL), CHANNELS)


def amount(place: str, effect: str = "leak") -> Term:
    return Term(effect, place, "amount")


def changing(by_term: dict[Term, float]):
    """An explanation whose terms each change the readings by so much (root mean square)."""
    values = dict.fromkeys(by_term, 1.0)
    return replace(
        explanation(*sorted({term.effect for term in by_term})),
        values=values,
        deviations=dict.fromkeys(by_term, 0.2),
        columns=np.array([np.full(SHAPE, change) for change in by_term.values()]),
    )


def test_places_that_change_next_to_nothing_are_left_out():
    found = changing({amount("a"): 1.0, amount("b"): 2.0 * NEGLIGIBLE, amount("c"): 0.01})
    assert list(significant_values(found, (LEAK,))) == [amount("a"), amount("b")]


def test_a_place_keeps_its_shapes_and_loses_them_with_its_size():
    rates = Term("leak", "a", "rate"), Term("leak", "b", "rate")
    found = changing({amount("a"): 1.0, rates[0]: 0.0, amount("b"): 0.01, rates[1]: 5.0})
    assert list(significant_values(found, (LEAK,))) == [amount("a"), rates[0]]


def test_each_effect_is_measured_by_its_own_foremost_place():
    """A second effect may be far smaller than the first: that is for the belief to say."""
    found = changing({amount("a"): 100.0, amount("a", "heavy"): 0.5})
    assert set(significant_values(found, (LEAK, HEAVY))) == set(found.values)


def test_tolerances_alone_name_nothing():
    assert significant_values(changing({}), (LEAK,)) == {}


def test_places_go_by_kind_and_number():
    terms = [
        Term("x", place, "y") for place in ("cable_10", "cable_2", "segment_3", "joint_1", "arm")
    ]
    found = places_of(dict.fromkeys(terms, 1.0), ("moving",))
    assert found.cables == ("cable_2", "cable_10")
    assert (found.segments, found.joints) == (("segment_3",), ("joint_1",))
    assert found.regimes == ("moving",)


def test_of_a_leak_the_channel_is_named_that_it_comes_from():
    leak = Term("sensor_crosstalk", "cable_7_into_cable_2", "share")
    assert places_of({leak: 0.1}, ()).cables == ("cable_7",)


def test_numbers_have_units_and_intervals_and_the_place_where_there_are_several():
    values = {amount("a", "heavy"): 2.0, amount("a"): 1.0, amount("b"): -1.0}
    found = estimates(values, dict.fromkeys(values, 0.5), (LEAK, HEAVY))
    assert list(found) == ["heavy.a.amount", "leak.a.amount", "leak.b.amount"]
    assert found["heavy.a.amount"].ci95 == pytest.approx((1.5, 2.5))
    assert found["leak.b.amount"].unit == "1"


def test_the_package_offers_the_diagnosis_by_short_names():
    """Whatever was imported before: no module takes the place of the function."""
    import cablesense_gap

    assert cablesense_gap.diagnose is diagnose
    assert all(getattr(cablesense_gap, name) is not None for name in cablesense_gap.__all__)
    with pytest.raises(AttributeError, match="nonsense"):
        cablesense_gap.nonsense  # noqa: B018
