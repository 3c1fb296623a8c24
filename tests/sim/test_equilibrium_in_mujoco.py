"""The rest found in closed form is one in MuJoCo too: its torques, its energy, its end in time."""

import mujoco
import numpy as np
import pytest
from arm_variants import variant
from random_cases import HARD, SOFT, STIFF, STRAIGHT, Cases, random_cases

from cablesense_sim import kinematics
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import Equilibrium, solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.model import build_spec


def left_over_torques_n_m(mechanism: Mechanism, cases: Cases, rest: Equilibrium) -> np.ndarray:
    """What MuJoCo's forward dynamics finds unbalanced, on every degree of freedom."""
    model = build_spec(mechanism).compile()
    data = mujoco.MjData(model)
    count = mechanism.segment_count
    bodies = [model.body(f"segment_{n + 1}").id for n in range(count)]
    sites = [model.site(f"contact_{n + 1}").id for n in range(count)]
    left = []
    for command, forces, q, tensions in zip(
        *cases, rest.joint_angles_rad, rest.tensions_n, strict=True
    ):
        retraction = mechanism.straight_length_m - kinematics.cable_lengths_m(mechanism, command)
        give = tensions / mechanism.actuator_stiffness_n_m
        for n in range(count):
            data.joint(f"joint_{n + 1}_pitch").qpos = q[2 * n]
            data.joint(f"joint_{n + 1}_yaw").qpos = q[2 * n + 1]
        for i in range(mechanism.cable_count):
            if model.nmocap:
                data.mocap_pos[i, 0] = -mechanism.run_m - retraction[i]
            else:
                data.actuator(f"servo_{i + 1}").ctrl = retraction[i]
                data.joint(f"screw_{i + 1}").qpos = retraction[i] - give[i]
        mujoco.mj_forward(model, data)
        applied = np.zeros(model.nv)
        for body, site, force in zip(bodies, sites, forces, strict=True):
            point = data.site_xpos[site]
            mujoco.mj_applyFT(model, data, force, np.zeros(3), point, body, applied)
        left.append(data.qfrc_passive + data.qfrc_actuator + applied - data.qfrc_bias)
    return np.array(left)


def test_mujoco_finds_nothing_unbalanced() -> None:
    left = left_over_torques_n_m(STIFF, HARD, solve_equilibrium(STIFF, *HARD))
    assert left.shape == (2000, 20)
    assert np.abs(left).max() < 1e-6


def test_mujoco_finds_nothing_unbalanced_on_the_compliant_arm() -> None:
    cases = random_cases(SOFT, 300, degrees=10, contacts=1, largest_n=120)
    rest = solve_equilibrium(SOFT, *cases)
    assert np.abs(rest.joint_angles_rad - cases.command_rad).max() > np.deg2rad(3)
    assert np.abs(left_over_torques_n_m(SOFT, cases, rest)).max() < 1e-6


@pytest.mark.parametrize("count", [1, 2, 6])
@pytest.mark.parametrize("each", [3, 5])
def test_other_arms_come_to_rest_too(count: int, each: int) -> None:
    arm = mechanism_of(
        variant(
            {
                "segments.count": count,
                "cables.per_segment": each,
                "cables.angle_deg.per_cable": 360 / each,
                "cables.angle_deg.per_segment": 360 / (each * count),
            }
        )
    )
    cases = random_cases(arm, 100, degrees=15, contacts=count)
    rest = solve_equilibrium(arm, *cases)
    assert rest.tensions_n.shape == (100, count * each)
    assert np.abs(left_over_torques_n_m(arm, cases, rest)).max() < 1e-6


def test_the_arm_rests_where_its_energy_is_least() -> None:
    """Energies are MuJoCo's: springs and weight; the loads are dead ones."""
    cases = random_cases(SOFT, 60, degrees=10, contacts=2, largest_n=80)
    rest = solve_equilibrium(SOFT, *cases)
    spec = build_spec(SOFT)
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)

    def energy_j(q: np.ndarray, forces: np.ndarray) -> float:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        return float(data.energy[0] - (data.site_xpos[sites] * forces).sum())

    sites = [model.site(f"contact_{n}").id for n in range(1, 5)]
    for command, forces, q in zip(*cases, rest.joint_angles_rad, strict=True):
        lengths = kinematics.cable_lengths_m(SOFT, command)
        data.mocap_pos[:, 0] = -SOFT.run_m - (SOFT.straight_length_m - lengths)
        least = energy_j(q, forces)
        for size in (1e-4, 1e-3, 1e-2):
            assert energy_j(q + size * rng.normal(size=8), forces) > least


@pytest.mark.parametrize(("name", "degrees", "newtons"), [("cdsm", 15, 200), ("cdsm_lab", 8, 80)])
def test_time_stepping_comes_to_rest_in_the_same_place(
    name: str, degrees: float, newtons: float
) -> None:
    arm = open_arm(name)
    mechanism = mechanism_of(arm)
    cases = random_cases(mechanism, 4, degrees=degrees, contacts=3, largest_n=newtons)
    rest = solve_equilibrium(mechanism, *cases)
    dynamics = ArmDynamics(arm)
    for i in range(4):
        dynamics.reset(cases.command_rad[i])
        for n in range(4):
            dynamics.load(n + 1, cases.forces_n[i, n])
        dynamics.settle(speed_rad_s=1e-9 if name == "cdsm" else 1e-8)
        np.testing.assert_allclose(dynamics.tensions_n, rest.tensions_n[i], atol=1e-3)


def test_only_the_stiffness_in_series_counts_at_rest() -> None:
    """A compliant actuator gives the tensions of a rigid one with a softer cable."""
    servo = variant({"cables.stiffness_n_m": 1e5, "actuators.kp_n_m": 1.5e5}, "cdsm_lab")
    rigid = variant({"cables.stiffness_n_m": 1e5}, "cdsm_lab")
    force = normal_force_n(SOFT, STRAIGHT, 3, 70.0, 40.0)[2]
    tensions = []
    for arm in (servo, rigid):
        dynamics = ArmDynamics(arm)
        dynamics.load(3, force)
        dynamics.settle(speed_rad_s=1e-8)
        tensions.append(dynamics.tensions_n)
    np.testing.assert_allclose(*tensions, atol=1e-3)
