"""The arm in time, and from rest to rest: equilibria, commands, loads, what is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from arm_variants import variant
from effect_arms import bent, up_and_down

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.dynamics import LEAST_PERIOD_S, ArmDynamics, RestToRestArm
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.loads import LoadError
from cablesense_sim.replay import replay_arm

BENT = np.deg2rad([5.0, -4.0, 8.0, 3.0, -6.0, 2.0, 4.0, 7.0])


@pytest.fixture(params=["cdsm", "cdsm_lab"])
def dynamics(request: pytest.FixtureRequest) -> ArmDynamics:
    return ArmDynamics(open_arm(request.param))


def test_it_starts_at_rest_and_stays_there(dynamics: ArmDynamics) -> None:
    rest = solve_equilibrium(dynamics.mechanism, np.zeros(8))
    np.testing.assert_allclose(dynamics.tensions_n, rest.tensions_n, atol=1e-5)
    dynamics.advance(0.2)
    np.testing.assert_allclose(dynamics.tensions_n, rest.tensions_n, atol=1e-5)
    np.testing.assert_allclose(dynamics.joint_angles_rad, rest.joint_angles_rad, atol=1e-9)
    assert dynamics.time_s == pytest.approx(0.2)


def test_a_push_moves_the_tensions_to_the_equilibrium_and_its_end_moves_them_back(
    dynamics: ArmDynamics,
) -> None:
    before = dynamics.tensions_n
    force = [0.0, 30.0, 10.0]
    dynamics.load(3, force)
    forces = np.zeros((4, 3))
    forces[2] = force
    np.testing.assert_array_equal(dynamics.forces_n, forces)
    expected = solve_equilibrium(dynamics.mechanism, np.zeros(8), forces)
    dynamics.settle(speed_rad_s=1e-8)
    np.testing.assert_allclose(dynamics.tensions_n, expected.tensions_n, atol=1e-3)
    assert np.abs(dynamics.tensions_n - before).max() > 5.0
    dynamics.load(3, np.zeros(3))
    dynamics.settle(speed_rad_s=1e-8)
    np.testing.assert_allclose(dynamics.tensions_n, before, atol=1e-3)


def test_a_command_moves_the_arm_there(dynamics: ArmDynamics) -> None:
    dynamics.command(BENT)
    np.testing.assert_array_equal(dynamics.command_rad, BENT)
    dynamics.settle(speed_rad_s=1e-8)
    expected = solve_equilibrium(dynamics.mechanism, BENT)
    np.testing.assert_allclose(dynamics.tensions_n, expected.tensions_n, atol=1e-3)
    give = 0.2 if dynamics.arm.name == "cdsm" else 3.0
    assert np.rad2deg(np.abs(dynamics.joint_angles_rad - BENT)).max() < give


def test_reset_rests_unloaded_at_a_command(dynamics: ArmDynamics) -> None:
    dynamics.load(2, [0.0, 0.0, 50.0])
    dynamics.advance(0.05)
    dynamics.reset(BENT)
    assert dynamics.time_s == 0.0
    assert not dynamics.forces_n.any()
    expected = solve_equilibrium(dynamics.mechanism, BENT)
    dynamics.advance(0.05)
    np.testing.assert_allclose(dynamics.tensions_n, expected.tensions_n, atol=1e-4)
    dynamics.reset()
    assert not dynamics.command_rad.any()


def test_swinging_dies_down() -> None:
    """Let go of a push, the arm loses energy: each tenth of a second moves it less."""
    arm = variant({"segments.joint_damping_n_m_s": 0.05}, "cdsm_lab")
    dynamics = ArmDynamics(arm)
    rest = dynamics.joint_angles_rad
    dynamics.load(4, [0.0, 30.0, 0.0])
    dynamics.settle(speed_rad_s=1e-6)
    dynamics.load(4, np.zeros(3))
    swings = []
    for _ in range(5):
        angles = []
        for _ in range(100):
            dynamics.advance(1e-3)
            angles.append(np.abs(dynamics.joint_angles_rad - rest).max())
        swings.append(max(angles))
    assert all(later < earlier for earlier, later in itertools.pairwise(swings))
    assert swings[-1] < 0.5 * swings[0]


def test_cables_never_push(dynamics: ArmDynamics) -> None:
    dynamics.load(1, [0.0, 0.0, -200.0])
    dynamics.load(4, [0.0, 60.0, 0.0])
    lowest = np.inf
    for _ in range(40):
        dynamics.advance(5e-3)
        lowest = min(lowest, dynamics.tensions_n.min())
    assert lowest == 0.0


def test_rigid_and_servo_actuators_come_to_the_same_rest() -> None:
    """The servo so stiff that it hardly differs: what differs is the route, not the rest."""
    tensions = []
    for kp in (np.inf, 1e9):
        dynamics = ArmDynamics(variant({"actuators.kp_n_m": kp}, "cdsm_lab"))
        dynamics.command(BENT)
        dynamics.load(3, [0.0, 25.0, -10.0])
        dynamics.settle(speed_rad_s=1e-8)
        tensions.append(dynamics.tensions_n)
    np.testing.assert_allclose(*tensions, atol=1e-3)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (np.zeros(7), "8 finite joint angles"),
        (np.zeros((1, 8)), "8 finite joint angles"),
        (np.full(8, np.nan), "8 finite joint angles"),
        (np.full(8, 0.9), "joint 1 is .* touch at 33.4"),
        ([0, 0, 0, 0, 0.4, 0.5, 0, 0], "joint 3"),
        ([0, 0, 0, 0, 2.0 * np.pi, 0, 0, 0], "joint 3 is 360.0 degrees"),
        ([0, 0, 0, 0, 3.1, 3.1, 0, 0], "joint 3"),
    ],
)
def test_impossible_commands_are_refused_and_change_nothing(
    dynamics: ArmDynamics, command: object, words: str
) -> None:
    dynamics.command(BENT)
    with pytest.raises(EquilibriumError, match=words):
        dynamics.command(command)
    np.testing.assert_array_equal(dynamics.command_rad, BENT)


@pytest.mark.parametrize(
    ("segment", "force", "words"),
    [
        (0, [0.0, 0.0, 1.0], "1 to 4"),
        (5, [0.0, 0.0, 1.0], "1 to 4"),
        (1, [0.0, 1.0], "three finite"),
        (1, [0.0, 1.0, np.nan], "three finite"),
        (1, [0.0, 1.0, np.inf], "three finite"),
    ],
)
def test_impossible_loads_are_refused_and_change_nothing(
    dynamics: ArmDynamics, segment: int, force: list[float], words: str
) -> None:
    with pytest.raises(LoadError, match=words):
        dynamics.load(segment, force)
    assert not dynamics.forces_n.any()


def test_what_never_settles_says_so() -> None:
    dynamics = ArmDynamics(open_arm("cdsm_lab"))
    dynamics.load(4, [0.0, 30.0, 0.0])
    with pytest.raises(EquilibriumError, match=r"still moves after 0\.01 s"):
        dynamics.settle(longest_s=0.01)


def test_tensions_and_joint_angles_are_of_the_same_moment() -> None:
    """In motion too, the stretch by a tension is that of the pose beside it."""
    dynamics = ArmDynamics(open_arm("cdsm_lab"))
    mechanism = dynamics.mechanism
    dynamics.load(4, [0.0, 30.0, 0.0])
    at_command = kinematics.cable_lengths_m(mechanism, np.zeros(8))
    unstretched = at_command - mechanism.pretension_n / mechanism.stiffness_n_m
    for duration_s in (1e-3, 5e-3, 2e-2):
        dynamics.advance(duration_s)
        lengths = kinematics.cable_lengths_m(mechanism, dynamics.joint_angles_rad)
        expected = mechanism.stiffness_n_m * np.maximum(lengths - unstretched, 0.0)
        np.testing.assert_allclose(dynamics.tensions_n, expected, atol=1e-6)


KINDS = {
    "capstan_friction": {"coefficient": 0.15, "pulley_wrap_rad": 1.5},
    "joint_friction": {"torque_n_m": 0.15},
    "cable_creep": {"share": 0.3, "time_s": 5.0},
}
PLACES = {"joint_friction": "joint_2"}


def with_effects(*names: str):
    listed = [
        {"effect": name, "at": PLACES.get(name, "arm"), "parameters": KINDS[name]}
        for name in names
    ]
    return variant({"effects": listed}, "cdsm_lab")


@pytest.mark.parametrize("names", [*((name,) for name in KINDS), tuple(KINDS)], ids="+".join)
def test_it_goes_through_a_course_as_the_replay_does(names: tuple[str, ...]) -> None:
    arm = with_effects(*names)
    loads = up_and_down(rows=5)
    commands = np.linspace(0.0, 1.0, len(loads))[:, None] * bent(3, most_deg=6.0)
    times = 0.2 * np.arange(len(loads))
    moving = RestToRestArm(arm)
    found = []
    for row, time in enumerate(times):
        if row:
            moving.command(commands[row])
            moving.load(3, loads[row, 2])
            moving.advance(time - moving.time_s)
        found.append(moving.tensions_n)
    np.testing.assert_allclose(found, replay_arm(arm, times, commands, loads), atol=1e-3)


def test_friction_holds_at_rest_for_an_hour() -> None:
    moving = RestToRestArm(with_effects("capstan_friction", "joint_friction"))
    moving.command(bent(3, most_deg=6.0))
    for load in (10.0, 4.0):
        moving.load(3, [0.0, load, 0.0])
        moving.advance(0.2)
        first = moving.tensions_n
    for _ in range(50):
        moving.advance(72.0)
        np.testing.assert_array_equal(moving.tensions_n, first)


def test_it_comes_to_rest_when_looked_at_and_not_more_often_than_needed() -> None:
    moving = RestToRestArm(with_effects("joint_friction"))
    before = moving.tensions_n
    moving.load(2, [0.0, 10.0, 0.0])
    moving.advance(0.4 * LEAST_PERIOD_S)
    np.testing.assert_array_equal(moving.tensions_n, before)
    for _ in range(20):
        moving.advance(0.04 * LEAST_PERIOD_S)
    assert np.abs(moving.tensions_n - before).max() > 1.0


def test_reset_forgets_the_past() -> None:
    moving = RestToRestArm(with_effects(*KINDS))
    first = moving.tensions_n
    moving.command(bent(3, most_deg=6.0))
    moving.load(3, [0.0, 10.0, 0.0])
    moving.advance(1.0)
    assert np.abs(moving.tensions_n - first).max() > 1.0
    assert np.abs(moving.joint_angles_rad).max() > 0.05
    moving.reset()
    np.testing.assert_array_equal(moving.tensions_n, first)
    assert moving.time_s == 0.0
    assert not moving.forces_n.any()
    assert not moving.command_rad.any()


def test_without_a_rest_it_reads_nothing() -> None:
    moving = RestToRestArm(with_effects("joint_friction"))
    moving.load(4, [0.0, 5e4, 0.0])
    moving.advance(0.2)
    assert np.isnan(moving.tensions_n).all()
