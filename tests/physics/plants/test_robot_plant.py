"""The simulator behind the planted robots, against closed forms, conservation and MuJoCo."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from robot_sets import (
    GUIDED,
    GUIDES,
    KINDS,
    PRETENSION_N,
    SERVOS,
    Rubbing,
    drawn,
    pulls_n,
    servo_file,
)
from typer.testing import CliRunner

from cablesense_plants.__main__ import app
from cablesense_plants.cases import PlantError
from cablesense_plants.robot.cases import draw_case, usual_kind
from cablesense_plants.robot.causes import LISTED
from cablesense_plants.robot.motion import (
    ReferenceMotion,
    prescribed_n_m,
    reference,
    simulate,
    stacked_references,
    written,
)
from cablesense_plants.robot.robots import LinkChain, read_chain, stacked

TILTED = """<mujoco><worldbody><body pos="0 0 0.3" euler="10 0 20">
  <inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>
  <body name="upper" pos="0.1 0 0.2" quat="1 1 0 0">
    <joint name="shoulder" axis="0 1 1" pos="0 0 0.05" armature="0.02" damping="0.3"/>
    <geom type="capsule" fromto="0 0 0 0.3 0.1 0" size="0.04" mass="2"/>
    <body name="lower" pos="0.3 0.1 0" euler="0 40 0"><joint name="elbow" axis="0 0 1"/>
      <geom type="box" size="0.1 0.05 0.02" pos="0.1 0 0" mass="1"/>
      <body pos="0.2 0 0" euler="30 0 0"><geom size="0.03" pos="0.1 0 0" mass="0.4"/></body>
    </body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("kind", [*KINDS, "tilted"])
def test_torques_are_those_of_mujoco_without_effects(kind):
    file = KINDS[kind].path.read_text() if kind in KINDS else TILTED
    model = mujoco.MjModel.from_xml_string(file)
    chain, sizes, _, _ = read_chain(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(5):
        motion = rng.normal(size=(3, model.nv))
        data.qpos[:], data.qvel[:], data.qacc[:] = motion
        mujoco.mj_inverse(model, data)
        joint_torques = sizes["armature"] * motion[2] + sizes["damping"] * motion[1]
        torques = chain.torques_n_m(*motion) + joint_torques + sizes["stiffness"] * motion[0]
        assert torques == pytest.approx(data.qfrc_inverse, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ('name="elbow" axis="0 0 1"', 'name="elbow" type="slide"', "elbow.*row of hinges"),
        ('name="elbow"', 'name="elbow" stiffness="1" springref="10"', "at rest at zero"),
        ('<body name="lower"', '<body><joint name="side"/><geom size="1"/></body><body', "elbow"),
    ],
)
def test_a_robot_that_a_plant_cannot_be_is_refused(old, new, fault):
    with pytest.raises(PlantError, match=fault):
        read_chain(mujoco.MjModel.from_xml_string(TILTED.replace(old, new)))


def test_a_robot_of_the_user_is_run_within_its_range_and_hides_what_is_asked(tmp_path):
    limited = TILTED.replace('name="elbow"', 'name="elbow" range="-20 60"')
    kind = usual_kind(tmp_path / "robot.xml", mujoco.MjModel.from_xml_string(limited))
    angle = reference(kind, np.random.default_rng(1)).angle[:, 1]
    assert np.rad2deg([angle.min(), angle.max()]) == pytest.approx([-8, 48], abs=12)
    case = draw_case(kind, ["payload"], 1, 1, [LISTED])
    assert case.answer.effects == "payload"
    assert case.answer.where in {"upper", "lower"}
    assert case.answer.gap_over_floor > 5.0


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["slide.xml"], "joint e: .*row of hinges"),
        (["robot.xml", "--only", "rust"], "no effect 'rust' of a robot; known are base_tilt"),
    ],
)
def test_a_model_or_an_effect_that_cannot_be_hidden_is_one_line(words, fault, tmp_path):
    (tmp_path / "robot.xml").write_text(TILTED)
    (tmp_path / "slide.xml").write_text(TILTED.replace('name="elbow"', 'type="slide" name="e"'))
    asked = ["--count", "1", "--out", str(tmp_path / "out"), "--model"]
    given = [*asked, str(tmp_path / words[0]), *words[1:]]
    with pytest.raises(PlantError, match=fault):
        CliRunner().invoke(app, given, catch_exceptions=False)


def test_a_pendulum_swings_with_its_period_and_keeps_its_energy():
    mass = 2.0
    length = 0.4
    angle = 0.05
    chain = LinkChain(
        axis=np.array([[0.0, 1.0, 0.0]]),
        origin_m=np.zeros((1, 3)),
        mass_kg=np.array([mass]),
        centre_m=np.array([[0.0, 0.0, -length]]),
        inertia_kg_m2=np.zeros((1, 3, 3)),
        gravity_m_s2=np.array([0.0, 0.0, -9.81]),
    )
    angles = np.array([angle])
    (acceleration,) = chain.accelerations(angles, np.zeros(1), np.zeros(1), np.zeros((1, 1)))
    assert acceleration == pytest.approx(-9.81 / length * np.sin(angle))
    with_payload = chain.with_mass(0, mass, np.array([0.0, 0.0, -3.0 * length]))
    (loaded,) = with_payload.accelerations(angles, np.zeros(1), np.zeros(1), np.zeros((1, 1)))
    assert loaded == pytest.approx(acceleration * 4.0 / 10.0)  # mgl and ml² of both


@pytest.mark.slow  # simulates for a while, until joints are fast
def test_a_controlled_robot_needs_the_torques_of_what_it_is_asked_for():
    kind = KINDS["two_links"]
    nominal, *_ = kind.nominal()
    rough = replace(nominal, dry=20.0 * kind.noise_n_m, presliding_rad=np.full(2, 1e-4))
    asked = ReferenceMotion(*(part[:1000] for part in reference(kind, np.random.default_rng(3))))
    robots = stacked([nominal, rough])
    motion = simulate(kind, robots, stacked_references([asked, asked]))
    needed = prescribed_n_m(kind, nominal, asked) / kind.noise_n_m
    taken = motion.drive_n_m[::8] / kind.noise_n_m
    assert np.sqrt(((taken[:, 0] - needed) ** 2).mean()) < 1.0
    speed = asked.speed[::8]
    fast = np.abs(speed) > 0.3 * np.abs(speed).max(0)
    extra = (taken[:, 1] - taken[:, 0])[fast] * np.sign(speed[fast])
    assert np.median(extra) == pytest.approx(20.0, rel=0.1)
    first, _ = written(kind, robots, motion, [1, 2])
    assert np.diff(first["time_s"]) == pytest.approx(1.0 / kind.rate_hz)


@pytest.mark.slow
def test_position_servos_move_a_robot_as_those_of_mujoco(tmp_path):
    """But for the lag of the drives' current, 2 ms."""
    kind = SERVOS["two_links"]
    whole = reference(kind, np.random.default_rng(3))
    asked = ReferenceMotion(*(part[:1500, None] for part in whole))
    motion = simulate(kind, stacked([kind.nominal()[0]]), asked)
    model = mujoco.MjModel.from_xml_path(str(servo_file(kind, tmp_path)))
    model.opt.timestep = 1e-3
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    courses = []
    data.qpos[:] = asked.angle[0, 0]
    for data.ctrl[:] in asked.angle[:, 0]:
        courses.append(data.qpos.copy())
        mujoco.mj_step(model, data)
    off_rad = np.abs(motion.joint[:, 0] - courses).max()
    assert off_rad < 0.1 * np.abs(motion.joint - asked.angle).max()
    assert np.ptp(courses, axis=0).min() > 0.3


def test_tendons_pull_as_those_of_mujoco():
    model = mujoco.MjModel.from_xml_path(str(GUIDED.path))
    data = mujoco.MjData(model)
    angles = np.random.default_rng(2).uniform(-0.2, 1.2, (5, 2))
    for angle, moment in zip(angles, GUIDES.moments_m(angles), strict=True):
        data.qpos[:] = angle
        data.ctrl[:] = [3.0, 1.0, 2.0, 5.0]
        mujoco.mj_forward(model, data)
        assert data.ctrl @ moment == pytest.approx(data.qfrc_actuator, rel=1e-9)
        torque = np.array([0.02, -0.01])
        pulls = pulls_n(moment, torque)
        assert pulls @ moment == pytest.approx(torque)
        assert pulls.min() == pytest.approx(PRETENSION_N)


def test_a_tendon_that_is_drawn_over_its_guides_loses_by_their_angles():
    friction = np.array([[0.4, 0.0, 0.0, 0.0]])
    guides = GUIDES
    torque = np.array([[0.05, 0.0]])
    for turned, way in ((0.2, 1.0), (-0.2, -1.0)):
        rubbing = Rubbing(guides, friction, np.array([[0.5, 0.5]]))
        for share in np.linspace(0.0, 1.0, 200):
            angle = np.array([[0.5 + share * turned, 0.5]])
            lost = rubbing.lost_n_m(angle, torque)
        points, _ = guides.pose(angle)
        ways = np.diff(points[0, 0])
        wrap = np.abs(np.angle(ways[1:] / ways[:-1])).sum()
        moment = guides.moments_m(angle)
        whole = pulls_n(moment, torque)[0, 0] * moment[0, 0]
        assert lost[0] == pytest.approx(whole * (1.0 - np.exp(-way * 0.4 * wrap)), rel=3e-3)


def test_cases_are_the_same_again_and_hide_what_they_say():
    cases = drawn(2, 7)
    again = drawn(2, 7)
    assert [c.answer for c in cases] == [c.answer for c in again]
    for case in cases:
        hides = case.answer.effects != "none"
        assert hides == (case.answer.gap_over_floor > 4.0)
