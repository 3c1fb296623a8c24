"""An arm's arrays, contact forces on it, and its kinematics in closed and compiled form."""

from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim import equilibrium_search, kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import LoadError, contact_angle_deg, normal_force_n
from cablesense_sim.mechanism import Mechanism, stack
from cablesense_sim.model import build_spec
from tests.helpers.arm_variants import variant
from tests.helpers.joint_torques import axis_torques_n_m, load_torques_n_m

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
    addresses = model.jnt_qposadr[joints]
    dofs = model.jnt_dofadr[joints]
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
    gravity = load_torques_n_m(mechanism, q)
    moved = np.zeros((3, model.nv))
    for i, angles in enumerate(q):
        data.qpos[addresses] = angles
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


def difference(function: Any, q: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Central differences of a function of (..., K) by each of the K, on a new last axis."""
    steps = h * np.eye(q.shape[-1])
    return np.stack([(function(q + s) - function(q - s)) / (2 * h) for s in steps], axis=-1)


def test_signs_are_those_of_the_base_frame() -> None:
    """Positive pitch lowers the tip and lengthens the upper cable; positive yaw turns it left."""
    mechanism = mechanism_of(ARMS["cdsm"])
    down = kinematics.contact_points_m(mechanism, np.array([0.1, 0, 0, 0, 0, 0, 0, 0]))
    turned_left = kinematics.contact_points_m(mechanism, np.array([0, 0.1, 0, 0, 0, 0, 0, 0]))
    assert down[3, 2] < 0
    assert turned_left[3, 1] > 0
    assert mechanism.hole_z_m[0] > 0
    assert kinematics.cable_jacobian_m(mechanism, np.zeros(8))[0, 0] > 0


def test_the_compiled_pose_is_the_same(arm: Arm) -> None:
    mechanism = mechanism_of(arm)
    rng = np.random.default_rng(3)
    angles = rng.uniform(-0.2, 0.2, (4, mechanism.joint_count))
    loads = rng.normal(size=(4, mechanism.segment_count, 3))
    stacked = stack([mechanism] * 4)
    span = kinematics.spans(stacked, angles)
    chain = kinematics.chain(stacked, angles)
    pose = equilibrium_search.posed(equilibrium_search.plates_of(stacked, 4), angles)
    by_turn = np.stack([span.by_pitch, span.by_yaw], axis=-1)
    same = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-12)
    same(pose.span_m, span.length_m)
    same(pose.by_turn_m, by_turn)
    second = difference(lambda x: kinematics.cable_jacobian_m(stacked, x), angles)
    for n in range(arm.segment_count):
        a = 2 * n
        b = 2 * n + 1
        by_turns = np.stack([second[..., i, j] for i, j in ((a, a), (a, b), (b, b))], axis=-1)
        np.testing.assert_allclose(pose.by_turns_m[:, :, n], by_turns, atol=1e-8)
    same(pose.axis, chain.rotation[..., 0])
    same(pose.joint_axis, chain.joint_axis)
    zeros = np.zeros_like(pose.span_m)
    still = np.zeros_like(angles)
    by_span = np.zeros((*zeros.shape, zeros.shape[-1]))
    balance = equilibrium_search.balanced(pose, zeros, by_span, loads, still, still)
    same(-balance.torque_n_m, axis_torques_n_m(chain, loads))

    def torque_n_m(q: np.ndarray) -> np.ndarray:
        return -axis_torques_n_m(kinematics.chain(stacked, q), loads)

    np.testing.assert_allclose(balance.slope_n_m, difference(torque_n_m, angles), atol=1e-8)


MECHANISM = mechanism_of(ARMS["cdsm"])
STRAIGHT = np.zeros(8)


def test_the_holes_lie_at_the_angles_of_the_file() -> None:
    angle = np.rad2deg(np.arctan2(MECHANISM.hole_y_m, MECHANISM.hole_z_m)) % 360
    expected = [(30 * n - 120 * k) % 360 for n in range(4) for k in range(3)]
    np.testing.assert_allclose(angle, expected, atol=1e-9)
    np.testing.assert_allclose(np.hypot(MECHANISM.hole_y_m, MECHANISM.hole_z_m), 0.05)


def test_axial_rigidity_makes_long_cables_softer() -> None:
    soft = mechanism_of(variant({"cables.stiffness_n_m": None, "cables.axial_rigidity_n": 2.3e5}))
    np.testing.assert_allclose(soft.cable_stiffness_n_m[0], 2.3e5 / 0.23)
    np.testing.assert_allclose(
        soft.cable_stiffness_n_m * soft.straight_length_m, 2.3e5, rtol=1e-12
    )
    np.testing.assert_allclose(
        1 / soft.stiffness_n_m, 1 / soft.cable_stiffness_n_m + 1 / 1e8, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("angle_deg", "direction"),
    [(0, [0, 0, 1]), (90, [0, 1, 0]), (180, [0, 0, -1]), (270, [0, -1, 0]), (-90, [0, -1, 0])],
)
def test_the_angle_counts_from_up_to_left(angle_deg: float, direction: list[float]) -> None:
    forces = normal_force_n(MECHANISM, STRAIGHT, 2, angle_deg, 10.0)
    expected = np.zeros((4, 3))
    expected[1] = 10.0 * np.array(direction)
    np.testing.assert_allclose(forces, expected, atol=1e-12)


angles = st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8)


@settings(max_examples=20, deadline=None)
@given(
    command=angles,
    segment=st.integers(1, 4),
    angle_deg=st.floats(-1000.0, 1000.0),
    magnitude_n=st.floats(1e-3, 1e4),
)
def test_there_and_back(
    command: list[float], segment: int, angle_deg: float, magnitude_n: float
) -> None:
    forces = normal_force_n(MECHANISM, command, segment, angle_deg, magnitude_n)
    force = forces[segment - 1]
    assert np.count_nonzero(forces.any(axis=-1)) == 1
    assert np.linalg.norm(force) == pytest.approx(magnitude_n)
    axis = kinematics.segment_rotations(MECHANISM, np.array(command))[segment - 1, :, 0]
    assert axis @ force == pytest.approx(0.0, abs=1e-9 * magnitude_n)
    back = float(contact_angle_deg(MECHANISM, command, segment, force))
    assert 0.0 <= back < 360.0
    assert abs((back - angle_deg + 180.0) % 360.0 - 180.0) < 1e-6


@pytest.mark.parametrize(
    ("segment", "angle_deg", "magnitude_n", "words"),
    [
        (5, 0.0, 1.0, "from 0 .* to 4"),
        (1.5, 0.0, 1.0, "whole number"),
        (1, np.nan, 1.0, "angle_deg"),
        (1, 0.0, -1.0, "magnitude_n"),
        (1, 0.0, np.nan, "magnitude_n"),
        ([1, 9], 0.0, 1.0, "from 0 .* to 4"),
    ],
)
def test_impossible_contacts_are_refused(
    segment: object, angle_deg: float, magnitude_n: float, words: str
) -> None:
    with pytest.raises(LoadError, match=words):
        normal_force_n(MECHANISM, STRAIGHT, segment, angle_deg, magnitude_n)


def test_parallel_forces_on_segments_1_and_2_read_like_one_on_segment_2() -> None:
    """Nothing at the actuators tells them apart: f = f2 + f1 s1 / L at s = s2 f2 / f."""
    mechanism = mechanism_of(ARMS["cdsm"])
    at_joint, slope = kinematics.contact_torques(
        mechanism, np.zeros(mechanism.joint_count), np.eye(3)
    )
    direction = np.array([0.0, 0.6, 0.8])
    first_n, first_m = 12.0, 0.05
    second_n, second_m = 20.0, 0.09
    first = first_n * direction @ (at_joint[0] + first_m * slope[0])
    second = second_n * direction @ (at_joint[1] + second_m * slope[1])
    one_n = second_n + first_n * first_m / mechanism.segment_length_m[0]
    one_m = second_m * second_n / one_n
    one = one_n * direction @ (at_joint[1] + one_m * slope[1])
    np.testing.assert_allclose(one, first + second, atol=1e-12)
