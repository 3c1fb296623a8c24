"""Compact kinematics say what `cablesense_sim.kinematics` says."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_torques import gravity_torques_n_m

from cablesense_sim import kinematics
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import twist_torques
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.kinematics import contact_torques
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


@settings(max_examples=40, deadline=None)
@given(mechanisms(), st.integers(0, 2**32 - 1))
def test_kinematics_agree_for_any_arm_at_any_pose(mechanism, seed):
    n = mechanism.segment_count
    compact = CompactKinematics(mechanism)
    q, commanded = _poses(mechanism, seed), _poses(mechanism, seed + 1)
    pose, there = (compact(torch.as_tensor(each)) for each in (q, commanded))
    drawn_m = held_lengths_m(mechanism, q) - held_lengths_m(mechanism, commanded)
    np.testing.assert_allclose((pose.length_m - there.length_m).numpy(), drawn_m, atol=1e-12)
    jacobian = kinematics.cable_jacobian_m(mechanism, q)
    np.testing.assert_allclose(pose.jacobian_t_m.numpy(), jacobian.swapaxes(1, 2), atol=1e-12)
    frames = pose.frames.numpy().reshape(-1, 3, n + 1, 3).swapaxes(1, 2)
    np.testing.assert_array_equal(frames[:, 0], np.broadcast_to(np.eye(3), (3, 3, 3)))
    axes = kinematics.segment_rotations(mechanism, q)
    np.testing.assert_allclose(frames[:, 1:], axes, atol=1e-12)
    weight = gravity_torques_n_m(mechanism, q)
    np.testing.assert_allclose(compact.weight_n_m(pose).numpy(), weight, atol=1e-11)
    turned = kinematics.segment_rotations(mechanism, commanded)
    expected = *contact_torques(mechanism, q, turned), twist_torques(mechanism, q)
    for found, torques in zip(compact.levers(pose, there.frames), expected, strict=True):
        np.testing.assert_allclose(found.numpy(), torques, atol=1e-12)
