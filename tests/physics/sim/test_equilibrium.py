"""Static equilibrium: virtual work, symmetry, MuJoCo's verdict, the search, what is refused."""

import dataclasses

import mujoco
import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_sim import kinematics
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import (
    Equilibrium,
    EquilibriumError,
    solve_equilibrium,
    stiffness_matrix_n_m,
)
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.model import build_spec
from tests.helpers.arm_variants import variant
from tests.helpers.joint_torques import load_torques_n_m
from tests.helpers.random_cases import HARD, SOFT, STIFF, STRAIGHT, Cases, random_cases


@pytest.fixture(scope="module")
def hard() -> Equilibrium:
    return solve_equilibrium(STIFF, *HARD)


def test_two_thousand_hard_cases_come_to_rest(hard: Equilibrium) -> None:
    assert hard.residual_n_m.shape == (2000,)
    assert (hard.residual_n_m < 1e-6).all()
    assert hard.iterations.max() < 20
    slack = (hard.tensions_n == 0).any(axis=-1)
    assert 0.5 < slack.mean() < 1.0, "the cases should have slack cables, and some none"
    assert (hard.tensions_n >= 0).all(), "a cable never pushes"


@pytest.mark.slow
def test_the_arm_never_balances_on_a_saddle() -> None:
    """A joint with a taut cable too few may balance like a pencil; there no arm stays."""
    cases = random_cases(SOFT, 800, degrees=8, contacts=1, largest_n=190)
    rest = solve_equilibrium(SOFT, *cases)
    stiffness = stiffness_matrix_n_m(SOFT, rest.joint_angles_rad, rest.tensions_n, cases.forces_n)
    assert np.linalg.eigvalsh(stiffness).min() > 0


def test_the_stiffness_matrix_is_the_slope_of_the_torques() -> None:
    cases = random_cases(SOFT, 10, degrees=10, contacts=2, largest_n=20)
    rest = solve_equilibrium(SOFT, *cases)
    at_command = kinematics.cable_lengths_m(SOFT, cases.command_rad)
    unstretched = at_command - SOFT.pretension_n / SOFT.stiffness_n_m

    def torques(q: np.ndarray) -> np.ndarray:
        stretch = kinematics.cable_lengths_m(SOFT, q) - unstretched
        tensions = SOFT.stiffness_n_m * np.maximum(stretch, 0)
        cables = np.einsum("bij,bi->bj", kinematics.cable_jacobian_m(SOFT, q), tensions)
        return cables - load_torques_n_m(SOFT, q, cases.forces_n)

    q = rest.joint_angles_rad
    h = 1e-7
    slope = np.stack([(torques(q + d) - torques(q - d)) / (2 * h) for d in h * np.eye(8)], -1)
    matrix = stiffness_matrix_n_m(SOFT, q, rest.tensions_n, cases.forces_n)
    np.testing.assert_allclose(matrix, slope, atol=1e-4 * np.abs(slope).max())
    np.testing.assert_allclose(matrix, np.swapaxes(matrix, -1, -2), atol=1e-9)


def test_the_total_moment_at_the_base_is_that_of_the_loads() -> None:
    """By hand: 20 N upwards at segment 3, straight, weightless; x of its contact is 0.34 m."""
    still = dataclasses.replace(STIFF, gravity_m_s2=np.zeros(3))
    forces = normal_force_n(still, STRAIGHT, 3, 0.0, 20.0)
    tensions = solve_equilibrium(still, STRAIGHT, forces).tensions_n
    moment = (tensions * still.hole_z_m).sum()  # about joint 1, to leading order in the give
    assert moment == pytest.approx(-20.0 * (0.34 - 0.015), rel=1e-3)


def test_a_batch_is_its_rows(hard: Equilibrium) -> None:
    for i in range(0, 2000, 250):
        alone = solve_equilibrium(STIFF, HARD.command_rad[i], HARD.forces_n[i])
        np.testing.assert_allclose(alone.tensions_n, hard.tensions_n[i], atol=1e-5)
        assert alone.residual_n_m.shape == ()
    shaped = solve_equilibrium(
        STIFF, HARD.command_rad[:6].reshape(2, 3, 8), HARD.forces_n[:6].reshape(2, 3, 4, 3)
    )
    assert shaped.iterations.shape == (2, 3)
    np.testing.assert_allclose(shaped.tensions_n.reshape(6, 12), hard.tensions_n[:6], atol=1e-5)


@pytest.mark.parametrize(
    ("command", "forces", "words"),
    [
        (np.zeros(7), None, "8 joint angles"),
        (np.zeros(8), np.zeros((3, 3)), r"\(4, 3\)"),
        (np.zeros((2, 8)), np.zeros((3, 4, 3)), "do not go with"),
        (np.full(8, np.nan), None, "finite"),
        (np.zeros(8), np.full((4, 3), np.inf), "finite"),
        (np.full(8, 10.0), None, "rad, not in degrees"),
        (np.zeros(8), np.full((4, 3), 1e9), "beyond any arm"),
    ],
)
def test_what_is_no_case_is_refused(
    command: np.ndarray, forces: np.ndarray | None, words: str
) -> None:
    with pytest.raises(EquilibriumError, match=words) as caught:
        solve_equilibrium(STIFF, command, forces)
    assert issubclass(EquilibriumError, CableSenseError)
    assert caught.value.failed.size == 0


def test_plates_that_would_touch_are_refused_and_named() -> None:
    with pytest.raises(EquilibriumError, match=r"bend joint 1 .* plates\s+touch at 33\.4"):
        solve_equilibrium(SOFT, STRAIGHT, normal_force_n(SOFT, STRAIGHT, 4, 0.0, 1000.0))


def test_all_failed_cases_are_listed() -> None:
    command = np.zeros((3, 1500, 8))
    forces = np.zeros((3, 1500, 4, 3))
    bad = [7, 1499, 1500, 4000]
    forces.reshape(-1, 4, 3)[bad, 3, 2] = 1000.0
    with pytest.raises(EquilibriumError, match="4 of 4500 cases; case 7:") as caught:
        solve_equilibrium(SOFT, command, forces)
    assert caught.value.failed.tolist() == bad
    assert "[0.0, 0.0, 1000.0]" in str(caught.value)
    good = np.delete(forces.reshape(-1, 4, 3), caught.value.failed, axis=0)
    assert solve_equilibrium(SOFT, STRAIGHT, good).residual_n_m.max() < 1e-7


def left_over_torques_n_m(mechanism: Mechanism, cases: Cases, rest: Equilibrium) -> np.ndarray:
    """What MuJoCo's forward dynamics finds unbalanced, on every degree of freedom."""
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    count = mechanism.segment_count
    bodies = [model.body(f"segment_{n + 1}").id for n in range(count)]
    sites = [model.site(f"contact_{n + 1}").id for n in range(count)]
    residuals = []
    for command, forces, q, tensions in zip(
        *cases, rest.joint_angles_rad, rest.tensions_n, strict=True
    ):
        retraction = mechanism.straight_length_m - kinematics.cable_lengths_m(mechanism, command)
        give = tensions / mechanism.actuator_stiffness_n_m
        for n in range(count):
            data.joint(f"joint_{n + 1}_pitch").qpos = q[2 * n]
            data.joint(f"joint_{n + 1}_yaw").qpos = q[2 * n + 1]
        for i in range(mechanism.cable_count):
            if model.nmocap:
                data.mocap_pos[i, 0] = -mechanism.run_m - retraction[i]
            else:
                data.actuator(f"servo_{i + 1}").ctrl = retraction[i]
                data.joint(f"screw_{i + 1}").qpos = retraction[i] - give[i]
        mujoco.mj_forward(model, data)
        applied = np.zeros(model.nv)
        for body, site, force in zip(bodies, sites, forces, strict=True):
            point = data.site_xpos[site]
            mujoco.mj_applyFT(model, data, force, np.zeros(3), point, body, applied)
        residuals.append(data.qfrc_passive + data.qfrc_actuator + applied - data.qfrc_bias)
    return np.array(residuals)


def test_mujoco_finds_nothing_unbalanced() -> None:
    some = Cases(*(part[:200] for part in HARD))
    assert np.abs(left_over_torques_n_m(STIFF, some, solve_equilibrium(STIFF, *some))).max() < 1e-6
    cases = random_cases(SOFT, 100, degrees=10, contacts=1, largest_n=120)
    rest = solve_equilibrium(SOFT, *cases)
    assert np.abs(rest.joint_angles_rad - cases.command_rad).max() > np.deg2rad(3)
    assert np.abs(left_over_torques_n_m(SOFT, cases, rest)).max() < 1e-6


@pytest.mark.parametrize(("count", "each"), [(1, 3), (6, 5)])
def test_other_arms_come_to_rest_too(count: int, each: int) -> None:
    arm = mechanism_of(
        variant(
            {
                "segments.count": count,
                "cables.per_segment": each,
                "cables.angle_deg.per_cable": 360 / each,
                "cables.angle_deg.per_segment": 360 / (each * count),
            }
        )
    )
    cases = random_cases(arm, 100, degrees=15, contacts=count)
    rest = solve_equilibrium(arm, *cases)
    assert rest.tensions_n.shape == (100, count * each)
    assert np.abs(left_over_torques_n_m(arm, cases, rest)).max() < 1e-6


def test_an_arm_that_buckles_is_refused() -> None:
    """Cables this soft cannot hold it upright against their own pull."""
    weak = dataclasses.replace(SOFT, stiffness_n_m=np.full(12, 1e2), pretension_n=np.full(12, 1e4))
    with pytest.raises(EquilibriumError, match=r"come to no stable rest|plates touch"):
        solve_equilibrium(weak, np.full(8, 0.05))
