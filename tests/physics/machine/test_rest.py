"""Where machines come to rest is where MuJoCo's own dynamics come to rest, and obeys energy."""

import mujoco
import numpy as np
import pytest

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce, MachineStatics
from tests.helpers.example_machines import bent_command, example_machine

STEPS = 4000
AT_REST = 1e-7
DAMPING_SHARE = 0.3
"""Of critical damping: rest does not depend on it."""


def as_described(machine: Machine) -> SimulatedMachine:
    parameters = MachineParameters(machine)
    return SimulatedMachine(machine, parameters, np.zeros(len(parameters)))


def push_on_last_link(machine: Machine) -> LinkForce:
    """A tenth of the largest force, obliquely on the last link's surface."""
    link = len(machine.links.names) - 1
    place_m = float(machine.links.touched_m[link].mean())
    point_m = np.array([place_m, 0.6 * machine.links.radius_m[link], 0.0])
    largest_n = machine.source.file.touch.largest_n
    return LinkForce(link, point_m, largest_n * np.array([0.02, -0.08, 0.06]))


def settled(machine: Machine, unstretched_m: Array, force: LinkForce, start: Array) -> Array:
    """(n,) where MuJoCo's dynamics stop, with the tendons and servos of the model as it is."""
    model = mujoco.MjModel.from_xml_path(str(machine.source.model_path))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    model.opt.timestep = 5e-4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.eq_solref[:] = [1e-3, 1.0]
    model.eq_solimp[:] = [0.9999, 0.9999, 1e-3, 0.5, 2.0]
    data = mujoco.MjData(model)
    data.qpos[:] = machine.coordinates.positions(start)
    mujoco.mj_forward(model, data)
    tendons = machine.tendons
    moment = MachineStatics(machine).at(start).moment
    stiffness = np.zeros(model.nv)
    stiffness[machine.coordinates.joints] = (moment.T**2) @ tendons.stiffness_n_m
    inertia = np.array([np.diag(_mass_matrix(model, data))]).ravel()
    model.dof_damping[:] += 2.0 * DAMPING_SHARE * np.sqrt(stiffness * inertia)
    data.ctrl[tendons.drawn_by] = tendons.gear * unstretched_m
    links = machine.links
    body = int(links.bodies[force.link])
    for _ in range(STEPS):
        turn = data.xmat[body].reshape(3, 3)
        point_m = links.origin_m[force.link] + links.axes[force.link] @ force.point_m
        data.qfrc_applied[:] = 0.0
        place = data.xpos[body] + turn @ point_m
        nothing = np.zeros(3)
        mujoco.mj_applyFT(model, data, force.force_n, nothing, place, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
        if np.abs(data.qvel).max() < AT_REST:
            break
    return machine.coordinates.independent(data.qpos)


def _mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand", "continuum"])
def test_dynamics_settle_where_statics_rest(name: str) -> None:
    machine = example_machine(name)
    simulated = as_described(machine)
    command = bent_command(machine, seed=3)
    unstretched_m = simulated.unstretched_m(command)
    untouched = simulated.untouched(command)
    force = push_on_last_link(machine)
    touched = simulated.under(command, (force,), untouched.pose)
    moved = np.abs(touched.pose - untouched.pose).max()
    pose = settled(machine, unstretched_m, force, untouched.pose)
    assert np.abs(pose - touched.pose).max() < 2e-3 * moved


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand", "continuum"])
def test_forces_are_the_slopes_of_energy(name: str) -> None:
    """Energy from MuJoCo's heights and springs, and from lengths, without any moment arm."""
    machine = example_machine(name)
    statics = MachineStatics(machine)
    rng = np.random.default_rng(1)
    pose = machine.reference + 0.05 * rng.standard_normal(len(machine.reference))
    stretch_m = machine.tendons.pretension_n / machine.tendons.stiffness_n_m
    unstretched_m = statics.at(machine.reference).length_m - stretch_m

    def energy_j(pose: Array) -> float:
        data = mujoco.MjData(machine.model)
        data.qpos[:] = machine.coordinates.positions(pose)
        mujoco.mj_fwdPosition(machine.model, data)
        mujoco.mj_energyPos(machine.model, data)
        stretched_m = np.maximum(data.ten_length[machine.tendons.ids] - unstretched_m, 0.0)
        stored_j = 0.5 * machine.tendons.stiffness_n_m @ stretched_m**2
        return float(data.energy[0] + stored_j)

    slope = np.empty(len(pose))
    for j in range(len(pose)):
        step = 1e-5 * (np.arange(len(pose)) == j)
        slope[j] = (energy_j(pose + step) - energy_j(pose - step)) / 2e-5
    forces = statics.residual(pose, unstretched_m)
    np.testing.assert_allclose(forces, -slope, atol=2e-6 * np.abs(slope).max())


@pytest.mark.parametrize("name", ["finger", "seven_hinges", "hand", "continuum"])
def test_a_machine_gives_way_alike_in_both_directions(name: str) -> None:
    """Maxwell and Betti: forces of dead weights and springs have a symmetric derivative."""
    machine = example_machine(name)
    simulated = as_described(machine)
    command = bent_command(machine, seed=4)
    pose = simulated.untouched(command).pose
    slope = simulated.built.statics.slope(pose, simulated.unstretched_m(command))
    scale = np.abs(slope).max()
    np.testing.assert_allclose(slope, slope.T, atol=1e-6 * scale)
    assert np.linalg.eigvalsh(-0.5 * (slope + slope.T)).min() > 0.0


def test_drives_give_the_torques_that_inverse_dynamics_ask_for() -> None:
    machine = example_machine("six_axis")
    simulated = as_described(machine)
    read = bent_command(machine, seed=5)
    force = push_on_last_link(machine)
    model = mujoco.MjModel.from_xml_path(str(machine.source.model_path))
    data = mujoco.MjData(model)
    data.qpos[:] = read
    mujoco.mj_forward(model, data)
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    body = int(machine.links.bodies[force.link])
    links = machine.links
    point_m = links.origin_m[force.link] + links.axes[force.link] @ force.point_m
    place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point_m
    pushed = np.zeros(model.nv)
    mujoco.mj_applyFT(model, data, force.force_n, np.zeros(3), place, body, pushed)
    touched = simulated.under(read, (force,), None)
    np.testing.assert_allclose(touched.values, data.qfrc_inverse - pushed, atol=1e-9)


def test_a_soft_machine_finds_rest_far_from_where_the_search_begins() -> None:
    """From straight, for commands of poses bent by up to 15 degrees at each of forty hinges."""
    machine = example_machine("continuum")
    described = as_described(machine)
    statics = MachineStatics(machine)
    for seed in range(10):
        command = bent_command(machine, seed, reach_deg=15.0)
        rest = described.untouched(command)
        residual = statics.residual(rest.pose, described.unstretched_m(command))
        assert np.abs(residual).max() < 1e-6
