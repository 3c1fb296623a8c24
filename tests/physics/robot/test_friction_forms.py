"""Friction as drives have it: hidden by LuGre's law in small steps, and named with its law."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cablesense_gap.report.text import cause
from cablesense_gap.robot.amending import known_robot_effects
from cablesense_gap.robot.friction_forms import FRICTION, PART_OF
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.motion import Stribeck, Trajectory
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_plants.robot.bristles import Bristles
from tests.helpers.two_link import RATE_HZ, motion, recorded, torques, write_model

STEPS = 20
"""Of the bristles between two rows."""
SOFT = Bristles(np.array(0.08), np.array(0.8), np.array(0.3), presliding_rad=np.array(0.02))
HARD = Bristles(np.array(0.08), np.array(0.8), np.array(0.5), presliding_rad=np.array(2e-5))


def bent_n_m(bristles, time_s, position):
    """Torque (T,) of bristles along a path (T,), by small steps."""
    step_s = (time_s[1] - time_s[0]) / STEPS
    within_s = (np.arange(STEPS) + 0.5) * step_s
    speeds = CubicSpline(time_s, position)(time_s[:-1, None] + within_s, 1)
    bend = np.zeros(())
    torque = np.zeros(len(time_s))
    for row, speeds_in_row in enumerate(speeds, start=1):
        for speed in speeds_in_row:
            bend, torque[row] = bristles.stepped(bend, speed, step_s)
    return torque


def elbow_recording(robot, lost_n_m, trials=4):
    """The pendulum with a torque of its own at the elbow."""
    rng = np.random.default_rng(4)
    columns = []
    for trial in range(trials):
        time_s, position, speed, acceleration = motion(rng)
        torque = torques(position, speed, acceleration)
        torque[:, 1] += lost_n_m(time_s, position[:, 1], speed[:, 1], torque[:, 1])
        columns.append((time_s, np.full(len(time_s), trial), position, torque))
    time_s, trial, position, torque = (np.concatenate(each) for each in zip(*columns, strict=True))
    return RobotRecording(
        "planted",
        time_s,
        trial,
        position + 1e-4 * rng.standard_normal(position.shape),
        torque + 0.005 * rng.standard_normal(torque.shape),
        np.full((len(time_s), robot.model.nu), np.nan),
    )


def of_bristles(bristles):
    return lambda time_s, position, _speed, _torque: bent_n_m(bristles, time_s, position)


def test_every_number_of_friction_has_its_part_of_a_law_or_explicitly_none(tmp_path):
    robot = load_robot(write_model(tmp_path))
    lost_n_m = of_bristles(SOFT)
    scale = prepared(elbow_recording(robot, lost_n_m, trials=2), robot).scale
    effects = [known_robot_effects()[name] for name in FRICTION]
    numbers = {
        parameter.name
        for effect in effects
        for parameter in (*effect.parameters(robot, scale), *effect.richer(robot, scale))
    }
    assert numbers == PART_OF.keys()


@pytest.mark.slow
def test_forward_in_time_the_law_is_of_those_that_the_comparison_has(tmp_path):
    robot = load_robot(write_model(tmp_path))
    path = recorded(tmp_path / "recording.csv", seed=4, trials=2, friction=(0.2, 0.1))
    verdict = diagnose(read_robot_recording(path, robot), robot, forward=True).verdict
    assert verdict.effects == ("joint_friction",)
    assert {form.law for form in verdict.forms.values()} == {"Coulomb"}


def by_load(_time_s, _position, speed, torque):
    return 0.25 * np.abs(torque) * np.sign(speed)


def test_bristles_bend_as_in_small_steps():
    time_s = np.arange(0.0, 6.0, 1.0 / RATE_HZ)
    position = 0.6 * np.sin(1.7 * time_s) + 0.2 * np.sin(3.1 * time_s)
    speed = np.gradient(position, time_s)
    trial = np.zeros(len(time_s), int)
    nothing = np.zeros((len(time_s), 1))
    moved = position[:, None], speed[:, None], nothing
    trajectory = Trajectory(time_s, trial, *moved, nothing, nothing, nothing)
    share = trajectory.slid(0, 0.02, Stribeck(0.8, 0.3))
    assert 0.08 * share == pytest.approx(bent_n_m(SOFT, time_s, position), abs=0.004)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "effect", "laws"),
    [
        (of_bristles(SOFT), "joint_friction", {"LuGre"}),
        (of_bristles(HARD), "joint_friction", {"Stribeck"}),
        (by_load, "load_friction", {"by the load", "by the load, with presliding"}),
    ],
)
def test_friction_is_named_with_its_law(tmp_path, lost, effect, laws):
    robot = load_robot(write_model(tmp_path))
    verdict = diagnose(elbow_recording(robot, lost), robot).verdict
    assert verdict.effects == (effect,)
    assert verdict.where.joints == ("elbow",)
    form = verdict.forms["elbow"]
    assert form.law in laws
    assert form.determined
    assert form.left_n[form.law] < 2.0
    if effect == "joint_friction":
        assert cause(verdict, effect) == f"dry friction at elbow by the {form.law} model"


HOIST = """<mujoco model="hoist"><worldbody><body name="load">
<joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
</body></worldbody></mujoco>"""


@pytest.mark.slow
def test_losses_of_a_hoist_that_only_lifts_are_not_told_from_a_torque_constant(tmp_path):
    path = tmp_path / "hoist.xml"
    path.write_text(HOIST)
    robot = load_robot(path)
    rng = np.random.default_rng(0)
    rows = []
    for trial in range(6):
        time_s = np.arange(0.0, 4.0, 1.0 / RATE_HZ)
        w = 2.0 * np.pi * rng.uniform(0.6, 1.2)
        place_m = 0.3 * time_s - 0.02 * np.sin(w * time_s)
        force_n = 2.0 * (9.81 + 0.02 * w**2 * np.sin(w * time_s))
        rows.append((time_s, np.full(len(time_s), trial), place_m, 1.25 * force_n))
    time_s, trial, place_m, force_n = (np.concatenate(each) for each in zip(*rows, strict=True))
    recording = RobotRecording(
        "hoist",
        time_s,
        trial,
        place_m[:, None] + 1e-5 * rng.standard_normal((len(time_s), 1)),
        force_n[:, None] + 0.05 * rng.standard_normal((len(time_s), 1)),
        np.empty((len(time_s), 0)),
    )
    verdict = diagnose(recording, robot, force=True).verdict
    group = {name for joined in verdict.ambiguity_group for name in joined.split("+")}
    assert {"load_friction", "torque_scale"} <= group
