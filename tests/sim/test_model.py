"""The MuJoCo model and the URDF are the arm that the file describes."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from arm_variants import variant
from joint_torques import gravity_torques_n_m

from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.effects.registry import amended, checked_entry
from cablesense_sim.model import build_spec, unstretched_length_m, urdf_xml


def test_masses_and_gravity_are_those_of_the_arm() -> None:
    arm = variant(
        {"segments.mass_kg": [0.4, 0.3, 0.2, 0.1], "gravity_m_s2": [1.0, 2.0, 3.0]}, "cdsm_lab"
    )
    model = build_spec(mechanism_of(arm)).compile()
    masses = [float(model.body(f"segment_{n}").mass[0]) for n in range(1, 5)]
    np.testing.assert_allclose(masses, [0.4, 0.3, 0.2, 0.1])
    np.testing.assert_allclose(model.opt.gravity, [1.0, 2.0, 3.0])
    assert model.body_mass.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["cdsm", "cdsm_lab"])
def test_straight_the_cables_bear_their_pretension(name: str) -> None:
    arm = open_arm(name)
    mechanism = mechanism_of(arm)
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    if not model.nmocap:
        data.qpos[:] = 0
        for i, give in enumerate(mechanism.pretension_n / mechanism.actuator_stiffness_n_m):
            data.joint(f"screw_{i + 1}").qpos = -give
    mujoco.mj_forward(model, data)
    tension = model.tendon_stiffness * (data.ten_length - model.tendon_lengthspring[:, 1])
    np.testing.assert_allclose(tension, 50.0, rtol=1e-6)
    np.testing.assert_allclose(
        unstretched_length_m(mechanism), model.tendon_lengthspring[:, 1], rtol=1e-12
    )


def test_a_slack_cable_does_not_push() -> None:
    mechanism = mechanism_of(open_arm("cdsm_lab"))
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    data.mocap_pos[:, 0] += 0.05  # pay out, so that all cables go slack
    mujoco.mj_forward(model, data)
    assert not data.qfrc_spring.any()


def test_nothing_collides_and_nothing_but_cables_holds() -> None:
    model = build_spec(mechanism_of(open_arm("cdsm"))).compile()
    assert not model.jnt_stiffness.any()
    assert not (model.geom_contype | model.geom_conaffinity).any()
    assert not model.tendon_damping.any()
    assert not model.dof_frictionloss.any()


@pytest.mark.parametrize(
    ("name", "place", "values"),
    [
        ("routing_geometry", "segment_2", {"plates_angle_rad": 0.1, "plates_radius_m": 0.004}),
        ("routing_geometry", "segment_4", {"cables_angle_rad": -0.1}),
        ("joint_elasticity", "arm", {"stiffness_n_m_rad": 20.0}),
        ("joint_elasticity", "joint_3", {"stiffness_n_m_rad": -5.0}),
    ],
)
def test_holes_out_of_line_and_springs_are_those_of_the_statics(
    name: str, place: str, values: dict[str, float]
) -> None:
    arm = open_arm("cdsm_lab")
    mechanism = amended(mechanism_of(arm), [checked_entry(name, place, values, 4, 12)])
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    angles = np.deg2rad([5.0, -4.0, 8.0, 3.0, -6.0, 2.0, 4.0, 7.0])
    data.qpos[:] = angles
    mujoco.mj_forward(model, data)
    lengths = kinematics.cable_lengths_m(mechanism, angles)
    np.testing.assert_allclose(data.ten_length, lengths, atol=1e-12)
    stretch = np.maximum(lengths - unstretched_length_m(mechanism), 0.0)
    jacobian = kinematics.cable_jacobian_m(mechanism, angles)
    spring = np.repeat(mechanism.joint_stiffness_n_m_rad, 2) * angles
    passive = -jacobian.T @ (mechanism.stiffness_n_m * stretch) - spring
    np.testing.assert_allclose(data.qfrc_passive, passive, atol=1e-8)


ARMS = {
    "cdsm": open_arm("cdsm"),
    "tapered": variant(
        {
            "segments.count": 3,
            "segments.length_m": [0.21, 0.15, 0.1],
            "segments.mass_kg": [0.8, 0.6, 0.4],
            "segments.contact_m": 0.05,
        }
    ),
    "single": variant({"segments.count": 1}),
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]


def numbers(element: ElementTree.Element, path: str, attribute: str) -> np.ndarray:
    found = element.find(path)
    assert found is not None
    return np.array(found.attrib[attribute].split(), dtype=float)


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_links_and_joints_have_the_names_of_the_contract(arm: Arm) -> None:
    robot = ElementTree.fromstring(urdf_xml(arm))
    assert robot.attrib["name"] == arm.name
    links = [link.attrib["name"] for link in robot.iter("link")]
    assert len(set(links)) == len(links)
    assert links[0] == "base_link"
    assert {f"segment_{n}" for n in range(1, arm.segment_count + 1)} <= set(links)
    moving = [j.attrib["name"] for j in robot.iter("joint") if j.attrib["type"] == "revolute"]
    assert moving == list(arm.joint_names)
    # a tree: every link but the base is one joint's child, and every parent is a link
    children = [numbers_or_name(joint, "child") for joint in robot.iter("joint")]
    parents = [numbers_or_name(joint, "parent") for joint in robot.iter("joint")]
    assert sorted(children) == sorted(set(links) - {"base_link"})
    assert set(parents) <= set(links)


def numbers_or_name(joint: ElementTree.Element, end: str) -> str:
    found = joint.find(end)
    assert found is not None
    return found.attrib["link"]


def test_its_chain_is_that_of_the_kinematics(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    robot = ElementTree.fromstring(urdf_xml(arm))
    q = np.random.default_rng(0).uniform(-0.4, 0.4, arm.joint_count)
    angles = dict(zip(arm.joint_names, q, strict=True))
    poses = {"base_link": (np.eye(3), np.zeros(3))}
    for joint in robot.iter("joint"):
        rotation, position = poses[numbers_or_name(joint, "parent")]
        assert not numbers(joint, "origin", "rpy").any()
        position = position + rotation @ numbers(joint, "origin", "xyz")
        rotation = rotation @ turn(numbers(joint, "axis", "xyz"), angles[joint.attrib["name"]])
        poses[numbers_or_name(joint, "child")] = rotation, position
    pose = kinematics.chain(mechanism, q)
    for n in range(arm.segment_count):
        rotation, position = poses[f"segment_{n + 1}"]
        np.testing.assert_allclose(rotation, pose.rotation[n], atol=1e-9)
        np.testing.assert_allclose(position, pose.joint_m[n], atol=1e-6)


def test_masses_and_their_centres_are_conserved(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    robot = ElementTree.fromstring(urdf_xml(arm))
    total = 0.0
    for link in robot.iter("link"):
        if link.find("inertial") is None:
            continue
        total += float(numbers(link, "inertial/mass", "value")[0])
        name, _, number = link.attrib["name"].partition("_")
        if name == "segment" and number.isdigit():
            n = int(number) - 1
            centre = numbers(link, "inertial/origin", "xyz")
            np.testing.assert_allclose(centre, [mechanism.centre_of_mass_m[n], 0, 0], atol=1e-6)
        moments = [
            float(numbers(link, "inertial/inertia", key)[0]) for key in ("ixx", "iyy", "izz")
        ]
        assert min(moments) >= 0
        assert sum(moments) >= 2 * max(moments), "no body has such an inertia"
    assert total == pytest.approx(mechanism.mass_kg.sum(), abs=1e-4)


def test_joints_stop_where_plates_touch(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    robot = ElementTree.fromstring(urdf_xml(arm))
    for i, joint in enumerate(robot.iter("joint")):
        limit = mechanism.bend_limit_rad[i // 2]
        assert float(numbers(joint, "limit", "upper")[0]) == pytest.approx(limit, abs=1e-5)
        assert float(numbers(joint, "limit", "lower")[0]) == pytest.approx(-limit, abs=1e-5)
        assert float(numbers(joint, "limit", "effort")[0]) > 0
        assert float(numbers(joint, "limit", "velocity")[0]) > 0


def test_mujoco_reads_it_and_finds_the_same_weight(arm: Arm) -> None:
    """Another reader's forward kinematics and statics."""
    mechanism = mechanism_of(arm)
    model = mujoco.MjModel.from_xml_string(urdf_xml(arm))
    data = mujoco.MjData(model)
    q = np.random.default_rng(1).uniform(-0.4, 0.4, arm.joint_count)
    for name, angle in zip(arm.joint_names, q, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    gravity = gravity_torques_n_m(mechanism, q)
    np.testing.assert_allclose(-data.qfrc_bias, gravity, atol=1e-4)
