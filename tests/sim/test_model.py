"""The MuJoCo model: named as the contract says, and made of nothing but the mechanism."""

import mujoco
import numpy as np
import pytest
from arm_variants import variant

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.effects.registry import amended, checked_entry
from cablesense_sim.model import build_spec, unstretched_length_m


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
