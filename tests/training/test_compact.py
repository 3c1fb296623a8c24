"""Compact kinematics say, pitches first, what `cablesense_sim.kinematics` says."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_torques import gravity_torques_n_m

from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_training.networks.compact import CompactKinematics

CDSM = open_arm("cdsm").model_dump()


@st.composite
def mechanisms(draw):
    """Arms of 1 to 5 segments with 3 to 5 cables each, unequal, under gravity from anywhere."""
    count = draw(st.integers(1, 5))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.08, 0.3, count)
    each = draw(st.integers(3, 5))
    segments = CDSM["segments"] | {
        "count": count,
        "length_m": length.tolist(),
        "mass_kg": rng.uniform(0.0, 3.0, count).tolist(),
        "contact_m": (length * rng.uniform(0.1, 1.0, count)).tolist(),
        "plate_offset_m": rng.uniform(0.01, 0.035),
    }
    cables = CDSM["cables"] | {
        "per_segment": each,
        "routing_radius_m": rng.uniform(0.02, 0.08, count).tolist(),
        "angle_deg": {
            "first": rng.uniform(-90, 90),
            # no two cables through one hole
            "per_segment": rng.choice([-1.0, 1.0]) * rng.uniform(4, 13),
            "per_cable": 360.0 / each,
        },
    }
    gravity = tuple(rng.uniform(-10.0, 10.0, 3))
    return mechanism_of(
        Arm.model_validate(
            CDSM | {"gravity_m_s2": gravity, "segments": segments, "cables": cables}
        )
    )


def _poses(mechanism, seed, rows=3, reach_rad=0.3):
    rng = np.random.default_rng(seed)
    return rng.uniform(-reach_rad, reach_rad, (rows, mechanism.joint_count))


def _column(joint_angles_rad):
    """Pitches, then yaws, as a column."""
    halves = np.concatenate([joint_angles_rad[:, 0::2], joint_angles_rad[:, 1::2]], axis=1)
    return torch.as_tensor(halves[..., None])


def _pitch_first(values):
    """Joint angles along the last axis, pitches first."""
    return np.concatenate([values[..., 0::2], values[..., 1::2]], axis=-1)


@settings(max_examples=40, deadline=None)
@given(mechanisms(), st.integers(0, 2**32 - 1))
def test_spans_and_jacobian_agree_for_any_arm_at_any_pose(mechanism, seed):
    q = _poses(mechanism, seed)
    pose = CompactKinematics(mechanism)(_column(q))
    span = pose.span_m.numpy()[:, 0].swapaxes(1, 2)
    expected = kinematics.spans(mechanism, q).length_m
    passes = mechanism.passes_joint
    np.testing.assert_allclose(span[:, passes], expected[:, passes], atol=1e-12)
    np.testing.assert_array_equal(span[:, ~passes], 1.0)
    jacobian = _pitch_first(kinematics.cable_jacobian_m(mechanism, q))
    np.testing.assert_allclose(pose.jacobian_t_m.numpy(), jacobian.swapaxes(1, 2), atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(mechanisms(), st.integers(0, 2**32 - 1))
def test_frames_levers_and_weight_agree_for_any_arm_at_any_pose(mechanism, seed):
    n = mechanism.segment_count
    commanded, loaded = _poses(mechanism, seed), _poses(mechanism, seed + 1)
    compact = CompactKinematics(mechanism)
    pose = compact(_column(loaded))
    frames = pose.frames.numpy().reshape(-1, 3, n + 1, 3).swapaxes(1, 2)
    np.testing.assert_array_equal(frames[:, 0], np.broadcast_to(np.eye(3), (3, 3, 3)))
    expected = kinematics.segment_rotations(mechanism, loaded)
    np.testing.assert_allclose(frames[:, 1:], expected, atol=1e-12)

    lever, weight = compact.levers(pose, compact.normal_cross(compact(_column(commanded))))
    normals = kinematics.segment_rotations(mechanism, commanded)[..., 1:]
    contact = kinematics.contact_jacobians_m(mechanism, loaded)
    torques = _pitch_first(np.einsum("bsik,bsic->bsck", contact, normals))
    np.testing.assert_allclose(lever.numpy(), torques, atol=1e-12)
    gravity = _pitch_first(gravity_torques_n_m(mechanism, loaded))
    np.testing.assert_allclose(weight.numpy()[..., 0], gravity, atol=1e-11)
