"""The plant's history-dependent rests: chains that stick at their guides, joints, and creep."""

from dataclasses import replace

import numpy as np
import pytest
from friction_law import searched

from cablesense_plants.arm.body import Body, PlantError
from cablesense_plants.arm.friction import (
    Creep,
    PathState,
    PlantFriction,
    QuasiStaticPath,
    piece_compliance_m_n,
)
from cablesense_plants.arm.statics import cable_lengths_m, follow_path, spans, turns
from tests.helpers.plant_arm import BODY, NOMINAL

RUN_M = NOMINAL.run_m
POSE = np.deg2rad([8.0, -4.0, 6.0, 5.0, -7.0, 3.0, 4.0, -6.0])
UP_DOWN = np.concatenate([np.linspace(0, 1, 9), np.linspace(1, 0, 9)[1:]])


def load_n(share: float) -> np.ndarray:
    load = np.zeros((4, 3))
    load[2] = 0.0, 6.0 * share, -10.0 * share
    return load


def paid_out_m(command: np.ndarray) -> np.ndarray:
    return (cable_lengths_m(BODY, command[None]) - cable_lengths_m(BODY, np.zeros((1, 8))))[0]


def states_along(
    friction: PlantFriction, creep: Creep, shares: np.ndarray, command: np.ndarray = POSE
) -> list[PathState]:
    path = QuasiStaticPath(BODY, friction, creep, RUN_M)
    paid = paid_out_m(command)
    states = [path.start(command, paid, load_n(shares[0]))]
    for share in shares[1:]:
        states.append(path.advance(states[-1], paid, load_n(share), 0.2))
    return states


def friction(**changes: object) -> PlantFriction:
    cables = {"coefficient": np.full(12, 0.15)} if "joint_nm" not in changes else {}
    return PlantFriction(**cables, **changes)


def sensed_n(states: list[PathState]) -> np.ndarray:
    return np.array([state.tension_n[:, 0] for state in states])


def test_without_friction_it_is_the_path_of_rests() -> None:
    command = np.tile(POSE, (len(UP_DOWN), 1))
    load = np.array([load_n(share) for share in UP_DOWN])
    paid = np.tile(paid_out_m(POSE), (len(UP_DOWN), 1))
    expected = follow_path(BODY, command, paid, load)
    sensed = sensed_n(states_along(PlantFriction(), Creep(), UP_DOWN))
    np.testing.assert_allclose(sensed, expected, atol=1e-4)


@pytest.mark.parametrize(
    "law",
    [
        friction(breakaway=1.4, pulley_rad=1.0),
        friction(presliding_m=2e-5),
        friction(rounded=True, presliding_m=1e-4, pulley_rad=1.0),
    ],
    ids=["breakaway", "bristles", "rounded"],
)
def test_tension_falls_over_a_guide_by_no_more_than_capstan_friction(law: PlantFriction) -> None:
    """Equation: exp(-mu theta) <= T2 / T1 <= exp(mu theta), met with equality while it slides."""
    worst = 0.0
    for state in states_along(law, Creep(), UP_DOWN):
        angles = state.angles_rad[None]
        bends = spans(BODY, angles, turns(BODY, angles), with_bends=True).bend_rad[0]
        wrap = np.concatenate([np.full((1, 12), law.pulley_rad), bends.reshape(8, 12)]).T
        tension = state.tension_n
        assert (tension > 0.0).all()
        ratio = np.abs(np.log(tension[:, 1:] / tension[:, :-1]))
        limit = 0.15 * wrap
        assert (ratio <= law.breakaway * limit + 1e-7).all()
        slides = state.sliding != 0.0
        np.testing.assert_allclose(ratio[slides], limit[slides], atol=1e-7)
        worst = max(worst, (ratio[limit > 1e-3] / limit[limit > 1e-3]).max())
    assert worst > (0.75 if law.rounded else 0.95)


@pytest.mark.slow
def test_cables_do_what_a_search_over_all_patterns_finds() -> None:
    """With the wraps and the lengths of the pieces of the arm's first two segments."""
    law = friction(pulley_rad=1.0)
    shares = np.concatenate([4.0 * UP_DOWN, 2.0 * UP_DOWN[1:], -3.0 * UP_DOWN[1:]])
    states = states_along(law, Creep(), shares)
    angles = np.array([state.angles_rad for state in states])
    across = spans(BODY, angles, turns(BODY, angles), with_bends=True)
    bends = across.bend_rad.reshape(len(shares), -1, 12)
    compliance = piece_compliance_m_n(BODY, RUN_M, law.actuator_share)
    for cable in range(6):
        pieces = 3 if cable < 3 else 5
        grip = 0.15 * np.column_stack([np.ones(len(shares)), bends[:, : pieces - 2, cable]])
        longer = np.zeros((len(shares), pieces))
        longer[:, 2::2] = across.length_m[:, : pieces // 2, cable]
        stretch = states[0].tension_n[cable, 0] * compliance[cable, :pieces]
        stretch = stretch + longer - longer[0]
        best_fit = searched(1.0 / compliance[cable, :pieces], grip, stretch)
        tension = np.array([state.tension_n[cable, :pieces] for state in states]).clip(0.0)
        np.testing.assert_allclose(tension, best_fit, atol=1e-4)
        assert np.ptp(tension) > 1.0


def test_a_run_that_sticks_keeps_its_tension_while_the_load_comes_off() -> None:
    """Nothing passes the pulley at first, and the actuators stand: no reading changes at all."""
    states = states_along(friction(pulley_rad=np.pi / 2), Creep(), UP_DOWN)
    tension = sensed_n(states)
    far = np.array([state.tension_n[:, 2] for state in states])
    falling = slice(8, 11)
    assert np.ptp(far[falling], axis=0).max() > 3.0
    assert np.ptp(tension[falling], axis=0).max() < 1e-8
    passed = np.array([state.fed_m[:, 0] for state in states[falling]])
    assert np.ptp(passed, axis=0).max() < 1e-12


def test_joint_friction_holds_no_more_than_its_torque() -> None:
    law = friction(joint_nm=np.full((4, 2), 0.2))
    path = QuasiStaticPath(BODY, PlantFriction(), Creep(), RUN_M)
    residuals = []
    for state in states_along(law, Creep(), UP_DOWN):
        balance = path.balance(state, state.angles_rad, None)
        residuals.append(np.abs(balance.torque_nm))
    assert np.max(residuals) <= 0.2 + 1e-6
    assert np.max(residuals) > 0.19


@pytest.mark.slow
def test_settled_cables_creep_under_a_load_alone_and_recover() -> None:
    creep = Creep(np.full((1, 12), 0.2e-5), np.array([5.0]), 1.0)
    shares = np.concatenate([np.zeros(10), np.ones(150), np.zeros(250)])
    tension = sensed_n(states_along(PlantFriction(), creep, shares))
    np.testing.assert_allclose(tension[9], tension[0], atol=1e-6)
    firmly = sensed_n(states_along(PlantFriction(), Creep(), shares[:12]))
    np.testing.assert_allclose(tension[10], firmly[10], atol=0.05)
    crept = np.abs(tension[159] - firmly[11]).max()
    assert crept > 0.03
    remaining_n = np.abs(tension - tension[159]).max(axis=1)
    assert remaining_n[10 + 25] / remaining_n[10] == pytest.approx(
        np.exp(-1.0), abs=0.06
    )  # one time constant later
    np.testing.assert_allclose(tension[-1], tension[0], atol=0.02)


def test_hardening_cables_with_friction_are_refused() -> None:
    body: Body = replace(BODY, exponent=1.5)
    with pytest.raises(PlantError, match="harden"):
        QuasiStaticPath(body, PlantFriction(), Creep(), RUN_M)
