"""The MuJoCo model and the URDF are the arm that the file describes."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.effects.registry import amended, checked_entry
from cablesense_sim.model import build_spec, unstretched_length_m
from cablesense_sim.urdf import urdf_xml
from tests.helpers.arm_variants import variant
from tests.helpers.joint_torques import load_torques_n_m


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


def test_mujoco_reads_the_urdf_and_finds_the_same_names_places_and_weight(arm: Arm) -> None:
    """Another reader's forward kinematics and statics."""
    mechanism = mechanism_of(arm)
    text = urdf_xml(arm)
    robot = ElementTree.fromstring(text)
    links = [link.attrib["name"] for link in robot.iter("link")]
    assert links[0] == "base_link"
    assert {f"segment_{n}" for n in range(1, arm.segment_count + 1)} <= set(links)
    assert [joint.attrib["name"] for joint in robot.iter("joint")] == list(arm.joint_names)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    q = np.random.default_rng(1).uniform(-0.4, 0.4, arm.joint_count)
    for name, angle in zip(arm.joint_names, q, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_forward(model, data)
    gravity = load_torques_n_m(mechanism, q)
    np.testing.assert_allclose(-data.qfrc_bias, gravity, atol=1e-4)
    last = data.body(f"segment_{arm.segment_count}")
    pose = kinematics.chain(mechanism, q)
    np.testing.assert_allclose(last.xpos, pose.joint_m[-1], atol=1e-6)
    np.testing.assert_allclose(last.xmat.reshape(3, 3), pose.rotation[-1], atol=1e-9)
