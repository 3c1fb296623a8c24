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
    PlantError,
)
from cablesense_gap.plant.geometry import cable_lengths_m, spans, turns
from cablesense_gap.plant.quasi_static import (
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
    return Friction(**cables, **changes)


def sensed_n(states: list[State]) -> np.ndarray:
    return np.array([state.tension_n[0] for state in states])


FRICTIONS = [
    friction(),
    friction(rounded=True, reach_m=1e-4),
    friction(spread=True),
    friction(rounded=True, reach_m=1e-4, spread=True, pulley_rad=1.0),
    friction(joint_nm=np.full((4, 2), 0.2)),
    friction(joint_nm=np.full((4, 2), 0.2), joint_rounded=True, joint_reach_rad=1e-3),
]


@given(
    moves=st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=12),
    rounded=st.booleans(),
    start=st.floats(-1.0, 1.0),
)
def test_friction_stays_within_its_bounds_and_does_not_depend_on_time(
    moves: list[float], rounded: bool, start: float
) -> None:
    state = np.array([start])
    for move in moves:
        new, slope = friction_state(rounded, state, np.array([move]), 0.5)
        assert abs(new[0]) <= 1.0
        assert slope[0] >= 0.0
        assert (new[0] - state[0]) * move >= -1e-9
        halves = friction_state(rounded, state, np.array([0.5 * move]), 0.5)[0]
        twice = friction_state(rounded, halves, np.array([0.5 * move]), 0.5)[0]
        assert twice[0] == pytest.approx(new[0], abs=1e-12)
        state = new
    assert friction_state(rounded, state, np.zeros(1), 0.5)[0][0] == state[0]


def test_without_friction_it_is_the_path_of_rests() -> None:
    command = np.tile(POSE, (len(UP_DOWN), 1))
    paid = cable_lengths_m(BODY, command) - cable_lengths_m(BODY, np.zeros((1, 8)))
    load = np.zeros((len(UP_DOWN), 4, 3))
    load[:, 2] = UP_DOWN[:, None] * np.array([0.0, 6.0, -10.0])
    expected = follow_path(BODY, command, paid, load).tensions_n
    found = sensed_n(states_along(Friction(), Creep(), UP_DOWN))
    np.testing.assert_allclose(found, expected, atol=1e-4)


@pytest.mark.parametrize("law", FRICTIONS)
def test_loading_and_unloading_differ_and_the_difference_stays(law: Friction) -> None:
    rest = np.full(20, UP_DOWN[-1])
    tension = sensed_n(states_along(law, Creep(), np.concatenate([UP_DOWN, rest])))
    loop = np.abs(tension[4] - tension[12]).max()
    assert loop > 0.2
    left = tension[len(UP_DOWN) - 1]
    assert np.abs(left - tension[0]).max() > 0.05
    np.testing.assert_allclose(tension[len(UP_DOWN) :], np.tile(left, (20, 1)), atol=1e-4)


@pytest.mark.parametrize("law", FRICTIONS[:4])
def test_tension_falls_over_a_guide_by_no_more_than_capstan_friction(law: Friction) -> None:
    """Equation: exp(-mu theta) <= T2 / T1 <= exp(mu theta), met with equality while it slides."""
    worst = 0.0
    for state in states_along(law, Creep(), UP_DOWN):
        angles = state.angles_rad[None]
        bends = spans(BODY, angles, turns(BODY, angles), with_bends=True).bend_rad[0]
        wrap = np.concatenate([np.full((1, 12), law.pulley_rad), bends.reshape(8, 12)])
        tension = state.tension_n
        assert (tension > 0.0).all()
        ratio = np.abs(np.log(tension[1:] / tension[:-1]))
        limit = 0.15 * wrap
        assert (ratio <= limit + 1e-7).all()
        worst = max(worst, (ratio[limit > 1e-3] / limit[limit > 1e-3]).max())
    assert worst > (0.75 if law.rounded else 0.95)


def test_joint_friction_holds_no_more_than_its_torque() -> None:
    law = friction(joint_nm=np.full((4, 2), 0.2))
    path = QuasiStaticPath(BODY, Friction(), Creep(), RUN_M)
    left = []
    for state in states_along(law, Creep(), UP_DOWN):
        paid = (cable_lengths_m(BODY, POSE[None]) - cable_lengths_m(BODY, np.zeros((1, 8))))[0]
        wanted = path.straight_m + paid
        at = path.balance(state, state.angles_rad, state.tension_n, wanted, state.loads_n)
        left.append(np.abs(at.torque_nm))
    assert np.max(left) <= 0.2 + 1e-6
    assert np.max(left) > 0.19


def test_stretch_is_shared_out_whole() -> None:
    for spread in (False, True):
        pieces = piece_compliance_m_n(BODY, RUN_M, spread)
        np.testing.assert_allclose(pieces.sum(axis=0), 1e-5)
    assert (pieces[5:, 0] == 0.0).all()  # nothing of cable 1 lies beyond the first joint


@pytest.mark.slow
def test_settled_cables_creep_under_a_load_alone_and_recover() -> None:
    creep = Creep(np.full((1, 12), 0.2e-5), np.array([5.0]), 1.0)
    shares = np.concatenate([np.zeros(10), np.ones(150), np.zeros(250)])
    tension = sensed_n(states_along(Friction(), creep, shares))
    np.testing.assert_allclose(tension[9], tension[0], atol=1e-6)
    firmly = sensed_n(states_along(Friction(), Creep(), shares[:12]))
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
    tension = sensed_n(states_along(Friction(), creep, np.zeros(100)))
    assert (tension[-1] < tension[0]).mean() > 0.7
    assert tension[-1].sum() < 0.95 * tension[0].sum()


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10_000), spread=st.booleans(), rounded=st.booleans())
def test_rough_arms_find_rest_too(seed: int, spread: bool, rounded: bool) -> None:
    rng = np.random.default_rng(seed)
    reach = 1e-4 if rounded else 5e-6
    law = friction(rounded=rounded, reach_m=reach, spread=spread, pulley_rad=1.5)
    rough = replace(law, coefficient=np.full(12, 0.3))
    states = states_along(rough, Creep(), rng.uniform(0.0, 1.0, 6), rng.uniform(-0.12, 0.12, 8))
    assert np.isfinite(sensed_n(states)).all()


def test_hardening_cables_with_friction_are_refused() -> None:
    body: Body = replace(BODY, exponent=1.5)
    with pytest.raises(PlantError, match="harden"):
        QuasiStaticPath(body, Friction(), Creep(), RUN_M)
