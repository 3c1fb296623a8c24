"""Closed-form kinematics against MuJoCo's, finite differences, and the compiled form."""

from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest
from arm_variants import variant
from joint_torques import gravity_torques_n_m, load_torques_n_m

from cablesense_sim import kinematics, rest_pose
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.mechanism import Mechanism, stack
from cablesense_sim.model import build_spec

TAPERED = {
    "segments.count": 3,
    "segments.length_m": [0.2, 0.15, 0.1],
    "segments.contact_m": [0.15, 0.03, 0.1],
    "segments.mass_kg": [0.8, 0.6, 0.4],
    "segments.plate_offset_m": 0.02,
    "cables.per_segment": 4,
    "cables.angle_deg.first": 17,
    "cables.angle_deg.per_cable": 90,
    "cables.routing_radius_m": [0.06, 0.05, 0.04],
    "gravity_m_s2": [1.0, -2.0, -9.0],
}
ARMS = {
    "cdsm": variant({}),
    "tapered": variant(TAPERED),
    "single": variant({"segments.count": 1, "cables.run_m": 0.0}),
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]


def poses(mechanism: Mechanism, count: int, degrees: float = 30.0) -> np.ndarray:
    rng = np.random.default_rng(7)
    return np.deg2rad(rng.uniform(-degrees, degrees, (count, mechanism.joint_count)))


def test_mujoco_agrees(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name).id for name in arm.joint_names]
    at, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    cables = [model.tendon(name).id for name in arm.cable_names]
    segments = range(1, arm.segment_count + 1)
    bodies = [model.body(f"segment_{n}").id for n in segments]
    sites = [model.site(f"contact_{n}").id for n in segments]
    q = poses(mechanism, 25)
    lengths = kinematics.cable_lengths_m(mechanism, q)
    jacobian = kinematics.cable_jacobian_m(mechanism, q)
    rotations = kinematics.segment_rotations(mechanism, q)
    centres = kinematics.joint_positions_m(mechanism, q)
    points = kinematics.contact_points_m(mechanism, q)
    contact = kinematics.contact_jacobians_m(mechanism, q)
    gravity = gravity_torques_n_m(mechanism, q)
    moved = np.zeros((3, model.nv))
    for i, angles in enumerate(q):
        data.qpos[at] = angles
        mujoco.mj_forward(model, data)
        dense = np.zeros((model.ntendon, model.nv))
        mujoco.mju_sparse2dense(
            dense, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
        )
        np.testing.assert_allclose(lengths[i], data.ten_length[cables], atol=1e-10)
        np.testing.assert_allclose(jacobian[i], dense[cables][:, dofs], atol=1e-10)
        np.testing.assert_allclose(rotations[i].reshape(-1, 9), data.xmat[bodies], atol=1e-10)
        np.testing.assert_allclose(centres[i], data.xpos[bodies], atol=1e-10)
        np.testing.assert_allclose(points[i], data.site_xpos[sites], atol=1e-10)
        np.testing.assert_allclose(gravity[i], -data.qfrc_bias[dofs], atol=1e-10)
        for n, site in enumerate(sites):
            mujoco.mj_jacSite(model, data, moved, None, site)
            np.testing.assert_allclose(contact[i, n], moved[:, dofs], atol=1e-10)


def test_load_torques_are_gravity_and_the_contact_jacobian(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    q = poses(mechanism, 20)
    forces = np.random.default_rng(1).normal(0, 50, (20, arm.segment_count, 3))
    torques = load_torques_n_m(mechanism, q, forces)
    by_jacobian = np.einsum("bncj,bnc->bj", kinematics.contact_jacobians_m(mechanism, q), forces)
    gravity = gravity_torques_n_m(mechanism, q)
    np.testing.assert_allclose(torques, gravity + by_jacobian, atol=1e-10)


def difference(function: Any, q: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Central differences of a function of (..., K) by each of the K, on a new last axis."""
    steps = h * np.eye(q.shape[-1])
    return np.stack([(function(q + s) - function(q - s)) / (2 * h) for s in steps], axis=-1)


def test_first_and_second_derivatives_are_those_of_the_lengths(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    q = poses(mechanism, 10)
    jacobian = kinematics.cable_jacobian_m(mechanism, q)
    by_difference = difference(lambda x: kinematics.cable_lengths_m(mechanism, x), q)
    np.testing.assert_allclose(jacobian, by_difference, atol=1e-9)
    second = difference(lambda x: kinematics.cable_jacobian_m(mechanism, x), q)
    span = kinematics.spans(mechanism, q)
    expected = np.zeros_like(second)
    for n in range(arm.segment_count):
        a, b = 2 * n, 2 * n + 1
        expected[..., a, a] = span.by_pitch_pitch[..., n]
        expected[..., b, b] = span.by_yaw_yaw[..., n]
        expected[..., a, b] = expected[..., b, a] = span.by_pitch_yaw[..., n]
    np.testing.assert_allclose(second, expected, atol=1e-9)


def test_contact_jacobian_is_the_derivative_of_the_points(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    q = poses(mechanism, 10)
    by_difference = difference(lambda x: kinematics.contact_points_m(mechanism, x), q)
    contact = kinematics.contact_jacobians_m(mechanism, q)
    np.testing.assert_allclose(contact, by_difference, atol=1e-9)


def test_a_span_is_the_distance_of_its_holes() -> None:
    """By hand: one joint, plates one offset before and after it, a hole at (y, z) in both."""
    mechanism = mechanism_of(ARMS["single"])
    pitch, yaw = 0.3, -0.2
    turn = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    ) @ np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    span = kinematics.spans(mechanism, np.array([pitch, yaw])).length_m[:, 0]
    for i in range(3):
        hole = np.array([0.0, mechanism.hole_y_m[i], mechanism.hole_z_m[i]])
        offset = np.array([0.015, 0.0, 0.0])
        before, after = hole - offset, turn @ (hole + offset)
        assert span[i] == pytest.approx(np.linalg.norm(after - before), abs=1e-15)


def test_signs_are_those_of_the_base_frame() -> None:
    """Positive pitch lowers the tip and lengthens the upper cable; positive yaw turns it left."""
    mechanism = mechanism_of(ARMS["cdsm"])
    down = kinematics.contact_points_m(mechanism, np.array([0.1, 0, 0, 0, 0, 0, 0, 0]))
    left = kinematics.contact_points_m(mechanism, np.array([0, 0.1, 0, 0, 0, 0, 0, 0]))
    assert down[3, 2] < 0
    assert left[3, 1] > 0
    assert mechanism.hole_z_m[0] > 0
    assert kinematics.cable_jacobian_m(mechanism, np.zeros(8))[0, 0] > 0


def test_the_bend_is_the_angle_between_neighbours(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    q = poses(mechanism, 10)
    axes = kinematics.segment_rotations(mechanism, q)[..., 0]
    base = np.broadcast_to([1.0, 0.0, 0.0], (10, 1, 3))
    before = np.concatenate([base, axes[:, :-1]], axis=1)
    cosine = (before * axes).sum(-1)
    np.testing.assert_allclose(np.cos(kinematics.bend_rad(q)), cosine, atol=1e-12)


def test_touching_plates_leave_finite_numbers() -> None:
    mechanism = mechanism_of(ARMS["single"])
    limit = mechanism.bend_limit_rad[0]
    span = kinematics.spans(mechanism, np.array([-limit, 0.0]))  # where the upper hole touches
    assert span.length_m[0, 0] == pytest.approx(0.0, abs=1e-8)
    assert all(np.isfinite(part).all() for part in span)


def test_the_compiled_pose_is_the_same(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    rng = np.random.default_rng(3)
    angles = rng.uniform(-0.2, 0.2, (4, mechanism.joint_count))
    loads = rng.normal(size=(4, mechanism.segment_count, 3))
    stacked = stack([mechanism] * 4)
    span, chain = kinematics.spans(stacked, angles), kinematics.chain(stacked, angles)
    pose = rest_pose.posed(rest_pose.plates_of(stacked, 4), angles)
    by_turn = np.stack([span.by_pitch, span.by_yaw], axis=-1)
    by_turns = np.stack([span.by_pitch_pitch, span.by_pitch_yaw, span.by_yaw_yaw], axis=-1)
    same = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-12)
    same(pose.span_m, span.length_m)
    same(pose.by_turn_m, by_turn)
    same(pose.by_turns_m, by_turns)
    same(pose.axis, chain.rotation[..., 0])
    same(pose.joint_axis, chain.joint_axis)
    same(rest_pose.load_torques_n_m(pose, loads), kinematics.axis_torques_n_m(chain, loads))
    none = np.zeros_like(pose.span_m)
    still = np.zeros_like(angles)
    by_span = np.zeros((*none.shape, none.shape[-1]))
    balance = rest_pose.balanced(pose, none, by_span, loads, still, still)

    def torque_n_m(q: np.ndarray) -> np.ndarray:
        return -kinematics.axis_torques_n_m(kinematics.chain(stacked, q), loads)

    np.testing.assert_allclose(balance.held_slope_n_m, difference(torque_n_m, angles), atol=1e-8)
