"""The generated URDF: named as the contract says, and the same chain as the kinematics."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from arm_variants import variant
from joint_torques import gravity_torques_n_m

from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.model import urdf_xml

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
