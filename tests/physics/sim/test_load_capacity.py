"""What an arm bears: sag by statics, greatest loads by their edge; and what its friction hides."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.load_capacity import (
    DIRECTIONS,
    SHOWS_AT_STD,
    WeakArmError,
    hidden_force,
    load_capacity,
    pose_range_deg,
)
from cablesense_sim.loads import LoadError, normal_force_n
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_sim.replay import reading_variance_n2
from tests.helpers.arm_variants import variant
from tests.helpers.effect_arms import bent

ONE = {"segments.count": 1, "segments.mass_kg": 2.0, "cables.stiffness_n_m": 2e4}


def test_one_segment_sags_as_its_weight_over_the_stiffness_of_its_cables() -> None:
    arm = variant(ONE, "cdsm_lab")
    mechanism = mechanism_of(arm)
    stiffness = (mechanism.stiffness_n_m * mechanism.hole_z_m**2).sum()
    moment = 2.0 * 9.81 * float(mechanism.centre_of_mass_m[0])
    capacity = load_capacity(arm)
    assert capacity.sag_deg == pytest.approx(math.degrees(moment / stiffness), rel=0.03)
    contact_m = float(mechanism.contact_m[0])
    assert capacity.sag_m == pytest.approx(math.radians(capacity.sag_deg) * contact_m, rel=0.01)


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


@pytest.mark.parametrize("offset_m", [0.015, 0.005, 0.004])
def test_random_poses_go_no_further_than_guide_plates_allow(offset_m: float) -> None:
    """Pitch and yaw of a joint together bend it by √2 of the range."""
    arm = variant({"segments.plate_offset_m": offset_m}, "cdsm_lab")
    limit_deg = math.degrees(mechanism_of(arm).bend_limit_rad.min())
    expected = min(10.0, limit_deg / math.sqrt(2.0))
    assert pose_range_deg(arm, 10.0, force_n=1.0) == pytest.approx(expected, abs=0.6)


BENT = bent(3, most_deg=4.0)
LOAD_N = 10.0


def rubbing(coefficient: float) -> Arm:
    """The laboratory arm with a quarter turn at the pulleys."""
    numbers = {"coefficient": coefficient, "pulley_wrap_rad": math.pi / 2}
    listed = {"effect": "capstan_friction", "parameters": numbers}
    return variant({"effects": [listed]}, "cdsm_lab")


def noise_n(arm: Arm) -> float:
    """By how much all readings together have to change."""
    return SHOWS_AT_STD * math.sqrt(reading_variance_n2(arm.sensors))


def test_without_friction_the_noise_alone_hides() -> None:
    """The smallest change that shows follows from the slope of the tensions over the force."""
    arm = rubbing(0.0)
    mechanism = mechanism_of(arm)
    angles_deg = np.arange(DIRECTIONS) * 360.0 / DIRECTIONS
    pushes = normal_force_n(mechanism, BENT, 2, angles_deg, 1.0)
    hidden = hidden_force(arm, BENT, LOAD_N)
    for load_n, changes in ((0.0, hidden.touching_n), (LOAD_N, hidden.rising_n)):
        less, more = (
            solve_equilibrium(mechanism, BENT, (load_n + side) * pushes).tensions_n
            for side in (-1e-3, 1e-3)
        )
        by_force = np.linalg.norm(more - less, axis=-1) / 2e-3
        np.testing.assert_allclose(changes[1], noise_n(arm) / by_force, rtol=0.03, atol=0.005)
    np.testing.assert_allclose(hidden.released_n, hidden.touching_n, rtol=0.01, atol=0.005)
    np.testing.assert_allclose(hidden.falling_n, hidden.rising_n, rtol=0.03, atol=0.005)


@pytest.mark.slow
def test_a_slow_push_is_seen_where_it_says() -> None:
    """One arm, pushed up and down again by steps of 20 mN: when does it read anything?"""
    arm = rubbing(0.13)
    step_n = 0.02
    hidden = hidden_force(arm, BENT, LOAD_N)
    mechanism = mechanism_of(arm)
    entries = entries_of(arm)
    push = normal_force_n(mechanism, BENT, 3, 0.0, 1.0)[None]
    one = QuasiStaticArm([mechanism], [entries])
    for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0):
        start = one.step(0.0, held_lengths_m(mechanism, share * BENT)[None], 0.0 * push)
    held = held_lengths_m(mechanism, BENT)[None]

    def walked(first_n: float, last_n: float, before: np.ndarray) -> tuple[float, np.ndarray]:
        """The change at which it shows, and the readings at the end."""
        seen = math.inf
        steps = round(abs(last_n - first_n) / step_n)
        for force_n in np.linspace(first_n, last_n, steps + 1):
            tensions = one.step(0.0, held, force_n * push)
            if np.linalg.norm(tensions - before) >= noise_n(arm):
                seen = min(seen, abs(force_n - first_n))
        return seen, tensions

    touching, loaded = walked(0.0, LOAD_N, start)
    falling, unloaded = walked(LOAD_N, 0.0, loaded)
    released, _ = walked(0.0, LOAD_N, unloaded)
    for name, seen in (("touching", touching), ("falling", falling), ("released", released)):
        expected = getattr(hidden, f"{name}_n")[2, 0]
        assert seen == pytest.approx(expected, rel=0.05, abs=2 * step_n)


def test_a_load_that_is_none_and_a_command_beyond_the_arm_are_refused() -> None:
    for load_n in (0.0, math.nan, math.inf):
        with pytest.raises(LoadError, match="above 0 N"):
            hidden_force(rubbing(0.1), BENT, load_n)
    with pytest.raises(EquilibriumError, match="guide plates"):
        hidden_force(rubbing(0.1), np.full(8, 0.6), LOAD_N)
