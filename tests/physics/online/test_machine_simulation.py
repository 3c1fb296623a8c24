"""A simulated machine of MuJoCo, as the sim node runs it: loads, commands, and its health."""

from types import SimpleNamespace as Message

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_online.machine_simulation import MachineSimulation
from cablesense_online.placed_links import PlacedLinks
from cablesense_online.simulation import SimulationSettings
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from tests.helpers.example_machines import example_machine

FORCE_N = np.array([0.3, 0.5, -1.2])


def simulation(name="finger", load_timeout_s=0.0):
    settings = SimulationSettings(
        rate_hz=0.0, joint_speed_rad_s=1.0, load_timeout_s=load_timeout_s, built_seed=-1
    )
    return MachineSimulation(example_machine(name), settings, 0.0)


def wrench(frame, force, torque=(0.0, 0.0, 0.0)):
    vectors = (Message(x=x, y=y, z=z) for x, y, z in (force, torque))
    pair = Message(**dict(zip(("force", "torque"), vectors, strict=True)))
    return Message(header=Message(frame_id=frame), wrench=pair)


def pushed(simulated, place_m):
    """Push the second link at a place that the torque of a message states."""
    felt = simulated._felt
    links = felt.links_at(simulated.joint_positions)
    torque = PlacedLinks(felt.link_frames).load_torque(2, links, FORCE_N, place_m)
    message = wrench("distal", FORCE_N, torque)
    load = simulated.read_load(message, simulated.frames(""))
    simulated.push(load, 0.0)
    return load


def test_a_load_acts_where_the_torque_of_its_message_says():
    machine = example_machine("finger")
    simulated = simulation()
    load = pushed(simulated, 0.021)
    assert load.contact_m == pytest.approx(0.021)
    simulated.advance_to(0.1)
    parameters = MachineParameters(machine)
    statics = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    force = LinkForce(1, np.array([0.021, 0.0, 0.0]), FORCE_N)
    expected = statics.under(machine.reference, [force], None).values
    np.testing.assert_allclose(simulated.reading(None), expected, atol=1e-6)


def test_a_load_lapses_and_what_cannot_be_is_refused():
    simulated = simulation(load_timeout_s=1.0)
    untouched = simulated.reading(None)
    pushed(simulated, 0.01)
    simulated.advance_to(0.5)
    assert np.abs(simulated.reading(None) - untouched).max() > 1.0
    simulated.advance_to(1.5)
    np.testing.assert_allclose(simulated.reading(None), untouched, atol=1e-6)
    with pytest.raises(CableSenseError, match="is not on distal, which is touched"):
        pushed(simulated, 0.06)
    along = simulated._felt.links_at(simulated.joint_positions).axes[1, :, 0]
    with pytest.raises(CableSenseError, match="no place that a torque could state"):
        simulated.read_load(wrench("distal", along, (0.1, 0.0, 0.0)), simulated.frames(""))
    with pytest.raises(CableSenseError, match="for arms of arm files"):
        simulated.offset(np.zeros(4))
    assert simulated.loads == []


def test_measured_joints_are_where_they_are_commanded_and_the_others_where_they_rest():
    measured = simulation("six_axis")
    goal = measured.target + 0.05
    measured.go_to(goal)
    measured.advance_to(5.0)
    np.testing.assert_allclose(measured.joint_positions, goal)
    finger = simulation()
    finger.go_to(np.array([0.0, 0.2, 0.1]))
    finger.advance_to(5.0)
    np.testing.assert_allclose(finger.joint_positions, [0.0, 0.2, 0.1], atol=0.01)
    assert (finger.joint_positions != [0.0, 0.2, 0.1]).any()  # weight, on elastic tendons
