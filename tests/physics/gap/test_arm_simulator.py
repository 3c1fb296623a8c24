"""The arm as the diagnosis simulates it, the amended arm in its file, and states of the past."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blind_sets import NARROW
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.amended_arm import amended_arm, write_arm
from cablesense_gap.arm_simulator import ArmSimulator, counted_rows, settled
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.simulator import Term, parameters_of
from cablesense_gap.system import problem_of
from cablesense_recording.recording import returns
from cablesense_sim.arm import ListedEffect, load_arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import replay_arm
from tests.helpers.arm_variants import variant
from tests.helpers.gap_recordings import LAB, small_recording

FEW = np.r_[0:10, 20:40, 310:330]
"""Rest, a load cycle with its steps, and some of a sweep."""
RECORDING = small_recording(peak_n=20.0).rows(FEW)
RECORDING = replace(RECORDING, time_s=0.2 * np.arange(len(FEW)))
HISTORY_DEPENDENT = {"cable_creep", "capstan_friction", "joint_friction"}

GAIN = Term("sensor_gain", "cable_2", "gain")
OFFSET_N = Term("sensor_offset", "cable_2", "offset_n")
SHARE = Term("sensor_crosstalk", "cable_1_into_cable_2", "share")
MASS_KG = Term("payload", "segment_2", "mass_kg")
FRICTION = Term("joint_friction", "joint_1", "torque_n_m")
ROLL_RAD = Term("base_tilt", "arm", "roll_rad")
ZERO_N = Term("sensor_tolerance", "cable_5", "zero_n")


def simulator(arm=LAB, recording=RECORDING):
    return ArmSimulator(arm, recording)


def having(*listed):
    effects = [{"effect": e, "at": at, "parameters": numbers} for e, at, numbers in listed]
    return variant({"effects": effects}, "cdsm_lab")


def replayed(arm, recording=RECORDING):
    return replay_arm(arm, recording.course)


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
    changes = [(OFFSET_N, 3.0), (GAIN, 0.1), (SHARE, 0.2)]
    values = dict(changes[k] for k in order)
    ideal = simulator().predict([{}])[0]
    read = simulator().predict([values])[0]
    assert_allclose(read[:, 1], 1.1 * (ideal[:, 1] + 0.2 * ideal[:, 0]) + 3.0, atol=1e-6)
    assert_allclose(read[:, 2:], ideal[:, 2:], atol=1e-6)
    assert_allclose(replayed(amended_arm(LAB, values, {})), read, rtol=0.0, atol=1e-9)
    zeroed = simulator().predict([{ZERO_N._replace(place="cable_2"): 0.2, GAIN: 0.1}])[0]
    assert_allclose(zeroed[:, 1], 1.1 * ideal[:, 1] + 0.2, atol=1e-6)


def test_effects_of_the_arm_file_are_part_of_the_nominal_arm():
    payload = ("payload", "segment_2", {"mass_kg": 0.4})
    worn = simulator(having(payload))
    assert_allclose(worn.predict([{}])[0], replayed(having(payload)), atol=1e-6)
    both = replayed(having(payload, ("sensor_gain", "cable_2", {"gain": 0.1})))
    assert_allclose(worn.predict([{GAIN: 0.1}])[0], both, atol=1e-6)


def test_every_known_effect_is_a_candidate_or_a_tolerance_that_can_be_simulated():
    arm = simulator(open_arm("cdsm_lab"), RECORDING.rows(slice(0, 2)))
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
    predicted = arm.predict([{change: 0.0}, {change: -0.8}])
    nominal = arm.predict([{}])[0]
    assert np.isfinite(predicted).all()
    assert_allclose(predicted[0], nominal, atol=1e-6)
    assert np.isclose(predicted[1], nominal, atol=1e-9).all(axis=-1).any()
    assert np.isnan(simulator(recording=pushed(5e4)).predict([{}])).all()


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


def test_rows_count_by_the_arm_without_its_effects():
    """A sensor zero makes no cable slack, and what a diagnosis adds changes no row's part."""
    recording = small_recording(peak_n=150.0)
    nominal_n = ArmSimulator(LAB, recording).predict([{}])[0]
    counted = counted_rows(LAB, recording, nominal_n)
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
    at_start = settled(loose(0.0), new, 30)
    assert at_start.effects[0].parameters["start"] == pytest.approx(start, abs=0.05)
    assert at_start.effects[0].parameters["play_m"] == 2e-4
    assert_allclose(replayed(at_start, recording), new.tensions_n, atol=0.1)
    assert settled(LAB, new, 30) is LAB


@pytest.mark.parametrize("peak_n", [1.0, 20.0])
def test_cables_that_hardly_slip_do_not_return_either(peak_n):
    """Light loads do not turn strong friction round, but the poses before them do."""
    recording = small_recording(peak_n=peak_n)
    strong = {Term("capstan_friction", "arm", "coefficient"): 0.6}
    (rubbing,), (nominal,) = (simulator(recording=recording).predict([v]) for v in (strong, {}))
    past_n, rows = returns(replace(recording, tensions_n=rubbing), 0.0)
    # the search tries friction where the past may be 0.05 of a residual
    assert past_n > 0.08 * np.sqrt(np.mean((rubbing - nominal)[rows] ** 2))


def test_rows_in_which_a_segment_may_have_turned_to_either_side_do_not_count():
    """A search that begins with the arm on one side finds another rest than from the other."""
    loads_n = np.array([0.0, 60.0, 61.0, 121.0, 180.0])
    recording = replace(
        RECORDING.rows(slice(0, 5)),
        load_segment=np.array([0, 1, 1, 1, 1]),
        load_n=np.outer(loads_n, [0.0, 0.0, -1.0]),
        command_rad=np.zeros((5, 8)),
    )
    counted = []
    for side in (-0.03, 0.03):
        begun = np.tile([0.0, side], (5, 4))
        rest = solve_equilibrium(
            mechanism_of(LAB), 0.0 * begun, recording.course.forces_n, start_rad=begun
        )
        counted.append(rest.tensions_n)
    same = np.isclose(*counted, atol=1e-3).all(axis=1)
    assert_array_equal(same, loads_n < 100.0)
    away = same & np.append(same[1:], True)  # the load may turn it earlier than the nominal arm
    assert_array_equal(counted_rows(LAB, recording, counted[0]), away)
    assert counted_rows(LAB, recording.rows(slice(0, 2)), counted[0][:2]).all()


def test_rows_in_which_a_little_more_load_would_turn_a_segment_do_not_count():
    """Tolerances decide there which way the arm goes; the rest is the only one all the same."""
    soft = variant(
        {
            "segments.count": 2,
            "segments.length_m": [0.175, 0.114],
            "segments.mass_kg": 0.142,
            "segments.plate_offset_m": 0.017,
            "segments.contact_m": [0.088, 0.098],
            "cables.per_segment": 3,
            "cables.routing_radius_m": 0.023,
            "cables.stiffness_n_m": 7430.0,
            "cables.pretension_n": 16.4,
            "cables.angle_deg": {"first": 0.0, "per_segment": 60.0, "per_cable": -120.0},
        },
        "cdsm_lab",
    )
    loads_n = np.linspace(0.0, 4.0, 401)
    each = np.zeros(len(loads_n), dtype=int)
    recording = replace(
        RECORDING.rows(each),
        time_s=0.1 * np.arange(len(each)),
        load_segment=each + 2,
        load_n=np.outer(loads_n, [0.0, 0.126, -0.992]),
        command_rad=np.tile([-0.023, 0.067, -0.012, 0.06], (len(each), 1)),
        tensions_n=np.full((len(each), 6), 16.4),
    )
    tensions_n = replayed(soft, recording)
    counted = counted_rows(soft, recording, tensions_n)
    steepest = int(np.abs(np.diff(tensions_n, axis=0)).max(1).argmax())
    assert np.abs(np.diff(tensions_n[[steepest, steepest + 1]], axis=0)).max() > 10.0
    assert not counted[steepest : steepest + 2].all()
    assert counted[np.abs(loads_n - loads_n[steepest]) > 0.3].all()
    start_rad = recording.command_rad[:1]
    kept = np.zeros(len(loads_n), dtype=bool)
    for row in reversed(range(len(loads_n))):  # the load falls, the arm stays turned for a while
        rest = solve_equilibrium(
            mechanism_of(soft),
            recording.command_rad[row:][:1],
            recording.course.forces_n[row:][:1],
            start_rad=start_rad,
        )
        start_rad = rest.joint_angles_rad
        kept[row] = np.abs(rest.tensions_n - tensions_n[row]).max() > 1e-3
    assert kept.any()
    assert not (kept & counted).any()


def test_no_row_of_a_buckled_arm_counts():
    """Its cables pull more than they hold upright: it may lean to either side in every row."""
    buckled = variant(
        {
            "segments.count": 3,
            "segments.length_m": [0.176, 0.185, 0.106],
            "segments.mass_kg": 0.31,
            "segments.plate_offset_m": 0.019,
            "segments.contact_m": [0.088, 0.092, 0.053],
            "cables.per_segment": 3,
            "cables.routing_radius_m": 0.023,
            "cables.stiffness_n_m": 17200.0,
            "cables.pretension_n": 87.4,
            "cables.angle_deg": {"first": 0.0, "per_segment": 40.0, "per_cable": -120.0},
        },
        "cdsm_lab",
    )
    each = np.zeros(40, dtype=int)
    recording = replace(
        RECORDING.rows(each),
        time_s=0.1 * np.arange(len(each)),
        load_segment=each,
        load_n=np.zeros((len(each), 3)),
        command_rad=np.outer(np.deg2rad(np.linspace(-15.0, 15.0, len(each))), np.eye(6)[5]),
        tensions_n=np.full((len(each), 9), 87.4),
    )
    assert not counted_rows(buckled, recording, replayed(buckled, recording)).any()


@pytest.mark.parametrize("seed", [1, 2])
def test_tolerances_of_a_very_stiff_arm_are_found(seed):
    """A tenth of their standard deviation takes cables slack in bent poses."""
    stiff = variant(
        {
            # a hole that is off by 0.1 mm would change a tension by 900 N
            "tolerances": {**NARROW.model_dump(), "hole_around_m": 2e-5},
            "segments.count": 2,
            "segments.length_m": [0.082, 0.089],
            "segments.plate_offset_m": 0.013,
            "segments.contact_m": [0.041, 0.044],
            "cables.per_segment": 4,
            "cables.routing_radius_m": 0.059,
            "cables.stiffness_n_m": 9.3e6,
            "cables.pretension_n": 55.0,
            "cables.angle_deg": {"first": 0.0, "per_segment": 45.0, "per_cable": -90.0},
        },
        "cdsm_lab",
    )
    poses_rad = np.random.default_rng(1).uniform(-0.25, 0.25, (6, 4))
    segment = np.tile(np.repeat([0, 1, 2], [8, 6, 6]), 6)
    loads_n = np.random.default_rng(2).uniform(-40.0, 40.0, (120, 3)) * [0.1, 1.0, 1.0]
    recording = replace(
        small_recording().rows(slice(0, 120)),
        trial=np.repeat(np.arange(6), 20),
        command_rad=np.repeat(poses_rad, 20, axis=0),
        load_segment=segment,
        load_n=np.where(segment[:, None] > 0, loads_n, 0.0),
        tensions_n=np.zeros((120, 8)),
    )
    system = ArmSystem(stiff, recording)
    std = {t: p.typical for t, p in parameters_of(system.tolerances).items()}
    rng = np.random.default_rng(seed)
    planted = {t: s * float(rng.standard_normal()) for t, s in std.items()}
    noise_n = system.floor * rng.standard_normal(recording.tensions_n.shape)
    readings_n = system.predict([planted])[0] + noise_n
    problem = problem_of(ArmSystem(stiff, replace(recording, tensions_n=readings_n)))
    fit = refine(problem, {}, [[]])
    off = problem.coefficients_of(fit.nuisance) - problem.coefficients_of(planted)
    change = np.sqrt((problem.nuisance_columns[:, problem.used] ** 2).sum(axis=(1, 2)))
    shown = change > 10.0 * system.floor
    assert shown.sum() > 15
    assert_allclose(off[shown], 0.0, atol=0.5)
