"""Unloaded tensions are those of the arm's statics, with the effects that it is known to have."""

import numpy as np
import pytest
from arm_variants import variant

from cablesense_base.errors import CableSenseError
from cablesense_online.tare import UnloadedTensions
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

ARM = open_arm("cdsm")
BENT = np.deg2rad([8.0, -5.0, 3.0, 0.0, -9.0, 4.0, 2.0, 7.0])


def test_without_effects_they_are_the_equilibrium():
    expected = solve_equilibrium(mechanism_of(ARM), BENT).tensions_n
    np.testing.assert_array_equal(UnloadedTensions(ARM).predict_n(BENT), expected)


def test_a_payload_pulls_like_its_weight():
    payload = {"effect": "payload", "at": "segment_2", "parameters": {"mass_kg": 0.4}}
    force = np.zeros((4, 3))
    force[1, 2] = -0.4 * 9.81
    expected = solve_equilibrium(mechanism_of(ARM), BENT, force).tensions_n
    assert np.abs(expected - UnloadedTensions(ARM).predict_n(BENT)).max() > 1.0
    found = UnloadedTensions(variant({"effects": [payload]})).predict_n(BENT)
    np.testing.assert_allclose(found, expected, atol=0.05)


def test_actuators_hold_the_lengths_of_the_arm_as_it_was_drawn():
    """Holes further out ask for another length at a bent pose, which no actuator knows of."""
    parameters = {"cables_radius_m": 1e-4}
    holes = {"effect": "routing_geometry", "at": "segment_2", "parameters": parameters}
    unloaded = UnloadedTensions(variant({"effects": [holes]}))
    as_known = solve_equilibrium(unloaded.mechanism, BENT).tensions_n
    change = unloaded.predict_n(BENT) - as_known
    # joints bent by some 0.1 rad, times 0.1 mm, on stiff cables
    assert np.abs(change[3:6]).max() > 1.0
    np.testing.assert_allclose(
        unloaded.predict_n(np.zeros(8)),
        solve_equilibrium(unloaded.mechanism, np.zeros(8)).tensions_n,
        atol=1e-6,
    )


def test_a_pose_without_a_rest_is_refused():
    with pytest.raises(CableSenseError):
        UnloadedTensions(ARM).predict_n(np.full(8, 1.04))
