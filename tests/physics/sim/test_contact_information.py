"""What tensions can tell of a contact at best: the information agrees with differences."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.kinematics import segment_rotations
from cablesense_sim.noise_bound import contact_information

VARIANCE_N2 = 0.005
SAMPLES = 20
LARGEST_N = {"cdsm": 150.0, "cdsm_lab": 45.0}


@pytest.mark.parametrize("name", LARGEST_N)
def test_information_agrees_with_differences_of_the_equilibrium(name):
    mechanism = mechanism_of(open_arm(name))
    rng = np.random.default_rng(1)
    bend = np.deg2rad(10.0)
    commands = rng.uniform(-bend, bend, (SAMPLES, mechanism.joint_count))
    segments = rng.integers(2, 5, SAMPLES)
    places_m = rng.uniform(0.02, 0.12, SAMPLES)
    forces_n = rng.uniform(2.0, LARGEST_N[name], (SAMPLES, 1)) * rng.uniform(
        -0.5, 0.5, (SAMPLES, 3)
    )
    axes = segment_rotations(mechanism, commands)[np.arange(SAMPLES), segments - 1]

    def tensions_n(at_m, force_n):
        touched_m = np.tile(mechanism.contact_m, (SAMPLES, 1))
        touched_m[np.arange(SAMPLES), segments - 1] = at_m
        loads = np.zeros((SAMPLES, mechanism.segment_count, 3))
        loads[np.arange(SAMPLES), segments - 1] = (axes @ force_n[..., None])[..., 0]
        touched = replace(mechanism, contact_m=touched_m)
        return solve_equilibrium(touched, commands, loads).tensions_n

    columns = []
    for force_step_n in 1e-3 * np.eye(3):
        ahead = tensions_n(places_m, forces_n + force_step_n)
        behind = tensions_n(places_m, forces_n - force_step_n)
        columns.append((ahead - behind) / 2e-3)
    ahead = tensions_n(places_m + 1e-6, forces_n)
    behind = tensions_n(places_m - 1e-6, forces_n)
    columns.append((ahead - behind) / 2e-6)
    gain = np.stack(columns, axis=-1)
    expected = np.swapaxes(gain, 1, 2) @ gain / VARIANCE_N2
    stated = contact_information(mechanism, commands, segments, places_m, forces_n, VARIANCE_N2)
    np.testing.assert_allclose(stated, expected, rtol=2e-3, atol=2.0)
