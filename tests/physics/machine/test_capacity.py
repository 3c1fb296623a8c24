"""Forces that slacken no tendon: a pair of tendons about a hinge has a closed form."""

import numpy as np
import pytest

from cablesense_sim.machine.capacity import borne_n
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from tests.helpers.example_machines import example_machine, machine_of_two_motors

PRETENSION_N = 20.0


def borne(folder, pretension_n, largest_n):
    machine = machine_of_two_motors(folder, pretension_n, largest_n)
    parameters = MachineParameters(machine)
    simulated = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    return borne_n(simulated, machine.reference)


def test_a_pair_of_tendons_bears_twice_its_pretension_by_the_levers(tmp_path):
    """A moment F L changes both tensions by F L / (2 r); one is slack at F L = 2 r T."""
    (far_n,) = borne(tmp_path, PRETENSION_N, 50.0)
    assert far_n == pytest.approx(2.0 * 0.03 * PRETENSION_N / 0.2, rel=0.1)


def test_no_more_than_the_largest_force_is_looked_for(tmp_path):
    assert borne(tmp_path, PRETENSION_N, 3.0) == pytest.approx([3.0])


def test_slack_tendons_bear_nothing(tmp_path):
    assert borne(tmp_path, 0.0, 50.0) == pytest.approx([0.0])


def test_joint_torques_have_no_tendon_to_slacken():
    machine = example_machine("six_axis")
    parameters = MachineParameters(machine)
    simulated = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    largest_n = machine.source.file.touch.largest_n
    assert borne_n(simulated, machine.reference) == pytest.approx([largest_n] * 4)
