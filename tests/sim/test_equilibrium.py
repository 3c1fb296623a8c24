"""Where the arm rests: by virtual work, superposition and symmetry; what is refused."""

import dataclasses

import numpy as np
import pytest
from arm_variants import variant
from random_cases import HARD, SOFT, STIFF, STRAIGHT, random_cases

from cablesense_base.errors import CableSenseError
from cablesense_sim import kinematics
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import (
    Equilibrium,
    EquilibriumError,
    solve_equilibrium,
    stiffness_matrix_n_m,
    tension_sensitivity,
)
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism


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


def test_tensions_balance_loads_by_virtual_work(hard: Equilibrium) -> None:
    q = hard.joint_angles_rad
    jacobian = kinematics.cable_jacobian_m(STIFF, q)
    cables = np.einsum("bij,bi->bj", jacobian, hard.tensions_n)
    loads = np.einsum("bncj,bnc->bj", kinematics.contact_jacobians_m(STIFF, q), HARD.forces_n)
    weight = kinematics.gravity_torques_n_m(STIFF, q)
    np.testing.assert_allclose(cables, weight + loads, atol=1e-6)


def test_the_arm_never_balances_on_a_saddle() -> None:
    """A joint with a taut cable too few may balance like a pencil; there no arm stays."""
    cases = random_cases(SOFT, 6000, degrees=8, contacts=1, largest_n=190)
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
        return cables - kinematics.load_torques_n_m(SOFT, q, cases.forces_n)

    q, h = rest.joint_angles_rad, 1e-7
    slope = np.stack([(torques(q + d) - torques(q - d)) / (2 * h) for d in h * np.eye(8)], -1)
    matrix = stiffness_matrix_n_m(SOFT, q, rest.tensions_n, cases.forces_n)
    np.testing.assert_allclose(matrix, slope, atol=1e-4 * np.abs(slope).max())
    np.testing.assert_allclose(matrix, np.swapaxes(matrix, -1, -2), atol=1e-9)


def test_weightless_and_unloaded_the_pretension_is_everywhere() -> None:
    still = dataclasses.replace(STIFF, gravity_m_s2=np.zeros(3))
    rest = solve_equilibrium(still, STRAIGHT)
    # three cables 120 degrees apart, equally tight, leave no moment
    np.testing.assert_allclose(rest.tensions_n, 50.0, atol=1e-9)
    np.testing.assert_allclose(rest.joint_angles_rad, 0.0, atol=1e-12)


def test_the_total_moment_at_the_base_is_that_of_the_loads() -> None:
    """By hand: 20 N upwards at segment 3, straight, weightless; x of its contact is 0.34 m."""
    still = dataclasses.replace(STIFF, gravity_m_s2=np.zeros(3))
    forces = normal_force_n(still, STRAIGHT, 3, 0.0, 20.0)
    tensions = solve_equilibrium(still, STRAIGHT, forces).tensions_n
    moment = (tensions * still.hole_z_m).sum()  # about joint 1, to leading order in the give
    assert moment == pytest.approx(-20.0 * (0.34 - 0.015), rel=1e-3)


def test_small_loads_superpose() -> None:
    a = normal_force_n(STIFF, STRAIGHT, 2, 40.0, 1.0)
    b = normal_force_n(STIFF, STRAIGHT, 4, 250.0, 1.5)
    tensions = solve_equilibrium(STIFF, STRAIGHT, np.stack([0 * a, a, b, a + b])).tensions_n
    none, by_a, by_b, by_both = tensions
    assert tensions.min() > 0
    np.testing.assert_allclose(by_both - none, by_a + by_b - 2 * none, atol=1e-3)


def test_weightless_and_straight_the_arm_looks_the_same_every_third_of_a_turn() -> None:
    still = dataclasses.replace(STIFF, gravity_m_s2=np.zeros(3))
    angle = np.arange(0.0, 360.0, 10.0)
    for segment, newtons in ((1, 150.0), (3, 20.0), (4, 60.0)):
        forces = normal_force_n(still, STRAIGHT, segment, angle, newtons)
        before = solve_equilibrium(still, STRAIGHT, forces).tensions_n
        turned = normal_force_n(still, STRAIGHT, segment, angle - 120.0, newtons)
        after = solve_equilibrium(still, STRAIGHT, turned).tensions_n
        cables = before.reshape(-1, 4, 3)
        # cable k + 1 lies where cable k lies turned by -120 degrees
        permuted = np.roll(cables, 1, axis=-1).reshape(-1, 12)
        # universal joints do not quite look the same, by the square of a bend of 1e-4 rad
        np.testing.assert_allclose(after, permuted, atol=0.05)


def test_left_and_right_are_mirror_images() -> None:
    holes = {
        "cables.angle_deg.per_segment": 0,
        "cables.routing_radius_m": [0.05, 0.048, 0.046, 0.044],
    }
    arm = mechanism_of(variant(holes, "cdsm_lab"))
    cases = random_cases(arm, 50, degrees=8, contacts=2, largest_n=60)
    rest = solve_equilibrium(arm, *cases)
    mirrored = solve_equilibrium(
        arm, cases.command_rad * np.tile([1, -1], 4), cases.forces_n * [1, -1, 1]
    )
    # cable 0 lies on the mirror plane, 1 and 2 on either side of it
    swapped = rest.tensions_n.reshape(-1, 4, 3)[..., [0, 2, 1]].reshape(-1, 12)
    np.testing.assert_allclose(mirrored.tensions_n, swapped, atol=1e-5)
    back = mirrored.joint_angles_rad * np.tile([1, -1], 4)
    np.testing.assert_allclose(back, rest.joint_angles_rad, atol=1e-9)


@pytest.mark.parametrize("mechanism", [STIFF, SOFT], ids=["cdsm", "cdsm_lab"])
def test_sensitivity_is_the_slope_of_the_tensions(mechanism: Mechanism) -> None:
    cases = random_cases(mechanism, 6, degrees=8, contacts=2, largest_n=60)
    rest = solve_equilibrium(mechanism, *cases)
    gain = tension_sensitivity(mechanism, rest.joint_angles_rad, rest.tensions_n, cases.forces_n)
    assert gain.shape == (6, 12, 4, 3)
    h = 1e-3
    for n in range(4):
        for axis in range(3):
            push = np.zeros((4, 3))
            push[n, axis] = h
            up, down = (
                solve_equilibrium(mechanism, cases.command_rad, cases.forces_n + s * push)
                for s in (1, -1)
            )
            slope = (up.tensions_n - down.tensions_n) / (2 * h)
            np.testing.assert_allclose(gain[..., n, axis], slope, atol=2e-3)
    assert not gain[rest.tensions_n == 0].any()


def test_very_stiff_cables_are_no_harder() -> None:
    stiffest = mechanism_of(variant({"cables.stiffness_n_m": 1e9, "actuators.kp_n_m": 1e11}))
    rest = solve_equilibrium(stiffest, *random_cases(stiffest, 200, degrees=20, contacts=4))
    assert rest.iterations.max() < 20


def test_large_arms_with_wide_and_close_plates_come_to_rest() -> None:
    """Their spans are small differences of large squares, which rounding blurs most."""
    large = mechanism_of(
        variant(
            {
                "segments.length_m": 1.7,
                "segments.contact_m": 0.3,
                "segments.plate_offset_m": 0.04,
                "cables.routing_radius_m": 1.0,
                "cables.stiffness_n_m": 2e7,
                "actuators.kp_n_m": np.inf,
            }
        )
    )
    rest = solve_equilibrium(large, *random_cases(large, 100, degrees=2, contacts=2))
    assert rest.residual_n_m.max() < 1e-5
    assert rest.iterations.max() < 20


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


def test_one_command_serves_many_loads() -> None:
    forces = normal_force_n(STIFF, STRAIGHT, 2, np.arange(0.0, 360.0, 90.0), 30.0)
    assert solve_equilibrium(STIFF, STRAIGHT, forces).tensions_n.shape == (4, 12)
    assert solve_equilibrium(STIFF, np.zeros((5, 1, 8)), forces).tensions_n.shape == (5, 4, 12)


def test_an_empty_batch_is_at_rest() -> None:
    rest = solve_equilibrium(STIFF, np.zeros((0, 8)), np.zeros((0, 4, 3)))
    assert rest.tensions_n.shape == (0, 12)
    assert rest.joint_angles_rad.shape == (0, 8)


def test_the_input_stays_as_it_was() -> None:
    command, forces = HARD.command_rad[:5].copy(), HARD.forces_n[:5].copy()
    solve_equilibrium(STIFF, command, forces)
    np.testing.assert_array_equal(command, HARD.command_rad[:5])
    np.testing.assert_array_equal(forces, HARD.forces_n[:5])


@pytest.mark.parametrize(
    ("command", "forces", "words"),
    [
        (np.zeros(7), None, "8 joint angles"),
        (0.0, None, "8 joint angles"),
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
