"""The plant's history-dependent rests: friction that holds at rest, its bounds, and creep."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_arm import BODY, NOMINAL

from cablesense_gap.plant.body import (
    Body,
    Creep,
    Friction,
    Onset,
    PlantError,
    no_creep,
    no_friction,
)
from cablesense_gap.plant.geometry import cable_lengths_m, spans, turns
from cablesense_gap.plant.quasi_static import (
    Balances,
    QuasiStaticPath,
    State,
    friction_state,
    piece_compliance_m_n,
)
from cablesense_gap.plant.rest import follow_path

RUN_M = NOMINAL.run_m
POSE = np.deg2rad([8.0, -4.0, 6.0, 5.0, -7.0, 3.0, 4.0, -6.0])
UP_DOWN = np.concatenate([np.linspace(0, 1, 9), np.linspace(1, 0, 9)[1:]])


def states_along(
    friction: Friction, creep: Creep, shares: np.ndarray, command: np.ndarray = POSE
) -> list[State]:
    path = QuasiStaticPath(BODY, friction, creep, RUN_M)
    paid = (cable_lengths_m(BODY, command[None]) - cable_lengths_m(BODY, np.zeros((1, 8))))[0]
    load = np.zeros((4, 3))
    load[2] = 0.0, 6.0, -10.0
    states = [path.start(command, paid, shares[0] * load)]
    for share in shares[1:]:
        states.append(path.advance(states[-1], paid, share * load, 0.2))
    return states


def friction(**changes: object) -> Friction:
    cables = {"coefficient": np.full(12, 0.15)} if "joint_nm" not in changes else {}
    return replace(no_friction(BODY), **cables, **changes)


def felt_n(states: list[State]) -> np.ndarray:
    return np.array([state.tension_n[0] for state in states])


FRICTIONS = [
    friction(),
    friction(onset=Onset.ROUNDED, reach_m=1e-4),
    friction(spread=True),
    friction(onset=Onset.ROUNDED, reach_m=1e-4, spread=True, pulley_rad=1.0),
    friction(joint_nm=np.full((4, 2), 0.2)),
    friction(joint_nm=np.full((4, 2), 0.2), joint_onset=Onset.ROUNDED, joint_reach_rad=1e-3),
]


@given(
    moves=st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=12),
    onset=st.sampled_from(list(Onset)),
    start=st.floats(-1.0, 1.0),
)
def test_friction_stays_within_its_bounds_and_does_not_depend_on_time(
    moves: list[float], onset: Onset, start: float
) -> None:
    state = np.array([start])
    for move in moves:
        new, slope = friction_state(onset, state, np.array([move]), 0.5)
        assert abs(new[0]) <= 1.0
        assert slope[0] >= 0.0
        assert (new[0] - state[0]) * move >= -1e-9
        halves = friction_state(onset, state, np.array([0.5 * move]), 0.5)[0]
        twice = friction_state(onset, halves, np.array([0.5 * move]), 0.5)[0]
        assert twice[0] == pytest.approx(new[0], abs=1e-12)
        state = new
    assert friction_state(onset, state, np.zeros(1), 0.5)[0][0] == state[0]


def test_without_friction_it_is_the_path_of_rests() -> None:
    command = np.tile(POSE, (len(UP_DOWN), 1))
    paid = cable_lengths_m(BODY, command) - cable_lengths_m(BODY, np.zeros((1, 8)))
    load = np.zeros((len(UP_DOWN), 4, 3))
    load[:, 2] = UP_DOWN[:, None] * np.array([0.0, 6.0, -10.0])
    expected = follow_path(BODY, command, paid, load).tensions_n
    found = felt_n(states_along(no_friction(BODY), no_creep(BODY), UP_DOWN))
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("law", FRICTIONS)
def test_loading_and_unloading_differ_and_the_difference_stays(law: Friction) -> None:
    rest = np.full(20, UP_DOWN[-1])
    tension = felt_n(states_along(law, no_creep(BODY), np.concatenate([UP_DOWN, rest])))
    loop = np.abs(tension[4] - tension[12]).max()
    assert loop > 0.2
    left = tension[len(UP_DOWN) - 1]
    assert np.abs(left - tension[0]).max() > 0.05
    np.testing.assert_allclose(tension[len(UP_DOWN) :], np.tile(left, (20, 1)), atol=1e-4)


@pytest.mark.parametrize("law", FRICTIONS[:4])
def test_tension_falls_over_a_guide_by_no_more_than_capstan_friction(law: Friction) -> None:
    """Equation: exp(-mu theta) <= T2 / T1 <= exp(mu theta), met with equality while it slides."""
    worst = 0.0
    for state in states_along(law, no_creep(BODY), UP_DOWN):
        angles = state.angles_rad[None]
        bends = spans(BODY, angles, turns(BODY, angles), with_bends=True).bend_rad[0]
        wrap = np.concatenate([np.full((1, 12), law.pulley_rad), bends.reshape(8, 12)])
        tension = state.tension_n
        assert (tension > 0.0).all()
        ratio = np.abs(np.log(tension[1:] / tension[:-1]))
        limit = 0.15 * wrap
        assert (ratio <= limit + 1e-7).all()
        worst = max(worst, (ratio[limit > 1e-3] / limit[limit > 1e-3]).max())
    assert worst > (0.95 if law.onset is Onset.SHARP else 0.75)


def test_joint_friction_holds_no_more_than_its_torque() -> None:
    law = friction(joint_nm=np.full((4, 2), 0.2))
    balances = Balances(BODY, no_friction(BODY), RUN_M)
    left = []
    for state in states_along(law, no_creep(BODY), UP_DOWN):
        paid = (cable_lengths_m(BODY, POSE[None]) - cable_lengths_m(BODY, np.zeros((1, 8))))[0]
        wanted = balances.straight_m + paid
        at = balances.at(state, state.angles_rad, state.tension_n, wanted, state.loads_n)
        left.append(np.abs(at.torque_nm))
    assert np.max(left) <= 0.2 + 1e-6
    assert np.max(left) > 0.19


def test_stretch_is_shared_out_whole() -> None:
    for spread in (False, True):
        pieces = piece_compliance_m_n(BODY, RUN_M, spread)
        np.testing.assert_allclose(pieces.sum(axis=0), 1e-5)
    assert (pieces[5:, 0] == 0.0).all()  # nothing of cable 1 lies beyond the first joint


def test_settled_cables_creep_under_a_load_alone_and_recover() -> None:
    creep = Creep(np.full((1, 12), 0.2e-5), np.array([5.0]), 1.0)
    shares = np.concatenate([np.zeros(10), np.ones(150), np.zeros(250)])
    tension = felt_n(states_along(no_friction(BODY), creep, shares))
    np.testing.assert_allclose(tension[9], tension[0], atol=1e-6)
    firmly = felt_n(states_along(no_friction(BODY), no_creep(BODY), shares[:12]))
    np.testing.assert_allclose(tension[10], firmly[10], atol=0.05)
    crept = np.abs(tension[159] - firmly[11]).max()
    assert crept > 0.03
    left = np.abs(tension - tension[159]).max(axis=1)
    assert left[10 + 25] / left[10] == pytest.approx(
        np.exp(-1.0), abs=0.06
    )  # one time constant later
    np.testing.assert_allclose(tension[-1], tension[0], atol=0.02)


def test_new_cables_lose_tension() -> None:
    creep = Creep(np.full((1, 12), 0.2e-5), np.array([2.0]), 0.0)
    tension = felt_n(states_along(no_friction(BODY), creep, np.zeros(100)))
    assert (tension[-1] < tension[0]).mean() > 0.7
    assert tension[-1].sum() < 0.95 * tension[0].sum()


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10_000), spread=st.booleans(), onset=st.sampled_from(list(Onset)))
def test_rough_arms_find_rest_too(seed: int, spread: bool, onset: Onset) -> None:
    rng = np.random.default_rng(seed)
    reach = 5e-6 if onset is Onset.SHARP else 1e-4
    law = friction(onset=onset, reach_m=reach, spread=spread, pulley_rad=1.5)
    rough = replace(law, coefficient=np.full(12, 0.3))
    states = states_along(
        rough, no_creep(BODY), rng.uniform(0.0, 1.0, 6), rng.uniform(-0.12, 0.12, 8)
    )
    assert np.isfinite(felt_n(states)).all()


def test_hardening_cables_with_friction_are_refused() -> None:
    body: Body = replace(BODY, exponent=1.5)
    with pytest.raises(PlantError, match="harden"):
        QuasiStaticPath(body, no_friction(body), no_creep(body), RUN_M)
