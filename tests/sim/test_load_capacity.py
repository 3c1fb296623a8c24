"""What an arm bears: sag by statics, greatest loads by their edge, and the ranges that follow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from arm_variants import variant

from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.load_capacity import WeakArmError, load_capacity
from cablesense_sim.loads import normal_force_n

ONE = {"segments.count": 1, "segments.mass_kg": 2.0, "cables.stiffness_n_m": 2e4}


def test_one_segment_sags_as_its_weight_over_the_stiffness_of_its_cables() -> None:
    arm = variant(ONE, "cdsm_lab")
    mechanism = mechanism_of(arm)
    stiffness = (mechanism.stiffness_n_m * mechanism.hole_z_m**2).sum()
    moment = 2.0 * 9.81 * float(mechanism.centre_of_mass_m[0])
    found = load_capacity(arm)
    assert found.sag_deg == pytest.approx(math.degrees(moment / stiffness), rel=0.03)
    contact_m = float(mechanism.contact_m[0])
    assert found.sag_m == pytest.approx(math.radians(found.sag_deg) * contact_m, rel=0.01)


def test_a_little_less_than_the_greatest_load_is_borne_and_a_little_more_is_not() -> None:
    arm = variant(ONE, "cdsm_lab")
    mechanism = mechanism_of(arm)
    (greatest,) = load_capacity(arm).greatest_n
    angles = np.arange(12) * 30.0
    for size, borne in ((0.99 * greatest, True), (1.03 * greatest, False)):
        forces = normal_force_n(mechanism, np.zeros(2), 1, angles, size)
        try:
            solve_equilibrium(mechanism, np.zeros((12, 2)), forces)
            assert borne
        except EquilibriumError:
            assert not borne


def test_a_sensor_at_the_end_of_its_range_ends_the_load() -> None:
    free, held = (variant({**ONE, "sensors.range_n": r}, "cdsm_lab") for r in (None, [0, 90]))
    assert load_capacity(held).greatest_n < 0.5 * load_capacity(free).greatest_n


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"segments.mass_kg": 60.0}, r"cannot stand.*lower segments.mass_kg"),
        ({"sensors.range_n": [0.0, 20.0]}, r"bears no contact.*sensors.range_n"),
    ],
)
def test_an_arm_that_can_bear_nothing_is_refused(changes: dict[str, object], what: str) -> None:
    with pytest.raises(WeakArmError, match=what):
        load_capacity(variant(changes, "cdsm_lab"))
