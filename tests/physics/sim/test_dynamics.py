"""The arm in time, quasi-static, and on the way to commands: equilibria, loads, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.course import Course
from cablesense_sim.dynamics import ArmDynamics, ArmQuasiStatics
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.joint_motion import JointMotion, move_duration_s
from cablesense_sim.loads import LoadError
from cablesense_sim.replay import replay_arm
from tests.helpers.arm_variants import variant
from tests.helpers.effect_arms import bent, up_and_down

BENT = np.deg2rad([5.0, -4.0, 8.0, 3.0, -6.0, 2.0, 4.0, 7.0])


@pytest.fixture(scope="module", params=["cdsm", "cdsm_lab"])
def built(request: pytest.FixtureRequest) -> ArmDynamics:
    return ArmDynamics(open_arm(request.param))


@pytest.fixture
def dynamics(built: ArmDynamics) -> ArmDynamics:
    built.reset()
    return built


def test_a_push_moves_the_tensions_to_the_equilibrium_and_its_end_moves_them_back(
    dynamics: ArmDynamics,
) -> None:
    before = dynamics.tensions_n
    force = [0.0, 30.0, 10.0]
    dynamics.load(3, force)
    forces = np.zeros((4, 3))
    forces[2] = force
    np.testing.assert_array_equal(dynamics.forces_n, forces)
    rest = solve_equilibrium(dynamics.mechanism, np.zeros(8))
    np.testing.assert_allclose(before, rest.tensions_n, atol=1e-5)
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


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (np.zeros(7), "8 finite joint angles"),
        (np.full(8, np.nan), "8 finite joint angles"),
        (np.full(8, 0.9), "joint 1 is .* touch at 33.4"),
        ([0, 0, 0, 0, 0.4, 0.5, 0, 0], "joint 3"),
        ([0, 0, 0, 0, 2.0 * np.pi, 0, 0, 0], "joint 3 is 360.0 degrees"),
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
    [(0, [0.0, 0.0, 1.0], "1 to 4"), (1, [0.0, 1.0, np.nan], "three finite")],
)
def test_impossible_loads_are_refused_and_change_nothing(
    dynamics: ArmDynamics, segment: int, force: list[float], words: str
) -> None:
    with pytest.raises(LoadError, match=words):
        dynamics.load(segment, force)
    assert not dynamics.forces_n.any()


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


@pytest.mark.parametrize("names", [("joint_friction",), tuple(KINDS)], ids="+".join)
def test_it_goes_through_a_course_as_the_replay_does(names: tuple[str, ...]) -> None:
    arm = with_effects(*names)
    loads = up_and_down(rows=5)
    commands = np.linspace(0.0, 1.0, len(loads))[:, None] * bent(3, most_deg=6.0)
    times = 0.2 * np.arange(len(loads))
    moving = ArmQuasiStatics(arm)
    tensions = []
    for row, time in enumerate(times):
        if row:
            moving.command(commands[row])
            moving.load(3, loads[row, 2])
            moving.advance(time - moving.time_s)
        tensions.append(moving.tensions_n)
    np.testing.assert_allclose(
        tensions, replay_arm(arm, Course(times, commands, loads)), atol=1e-3
    )


def test_reset_forgets_the_past() -> None:
    moving = ArmQuasiStatics(with_effects(*KINDS))
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


STEP_S = 1e-3


def path(motion, steps):
    """(steps, joints) set-points of a motion, and the motion at the last."""
    at_steps = [motion.after(STEP_S * k) for k in range(1, steps + 1)]
    return np.array([at_step.angle_rad for at_step in at_steps]), at_steps[-1]


def test_arrives_in_time_at_the_peak_speed_and_stays():
    target = np.array([0.4, -0.1])
    motion = JointMotion.at_rest(np.zeros(2), joint_speed_rad_s=0.5).towards(target)
    steps = round(move_duration_s(0.4, 0.5) / STEP_S)
    angles, motion = path(motion, steps + 50)
    speeds = np.abs(np.diff(angles, axis=0)).max() / STEP_S
    assert speeds == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(angles[steps - 2], target, atol=1e-6)
    np.testing.assert_array_equal(angles[-1], target)
    assert not motion.moving


def test_neither_angle_nor_speed_jumps_when_the_target_changes_on_the_way():
    motion = JointMotion.at_rest(np.zeros(1), 0.5).towards(np.array([0.3]))
    before, motion = path(motion, 300)
    after, _ = path(motion.towards(np.array([-0.2])), 3000)
    angles = np.concatenate([before, after])[:, 0]
    acceleration = np.diff(angles, 2) / STEP_S**2
    assert np.abs(acceleration).max() < 10.0  # a jump of the speed by 0.1 rad/s would be 100
    np.testing.assert_array_equal(after[-1], [-0.2])
