"""Creep: relaxation of a held cable and recovery after a load, each with its closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_arms import MECHANISM, entry, small

from cablesense_sim.effects.effect import ArmRest
from cablesense_sim.effects.registry import EffectEntry, side_by_side
from cablesense_sim.quasi_static import QuasiStaticArm

CREEP = entry("cable_creep", share=0.2, time_s=10.0)


def rest(time_s: float, tensions_n: np.ndarray) -> ArmRest:
    nothing = np.zeros((1, 12, 4))
    tensions = np.broadcast_to(tensions_n, (1, 12))
    return ArmRest(time_s, np.zeros((1, 8)), nothing, np.zeros((1, 12, 4, 2)), tensions)


def creeping(entry_: EffectEntry, tensions_n: float = 50.0, **values: float):
    """Its creep, having begun at 0 s under equal tensions."""
    chosen = small(entry_, **values)
    creep = chosen.effect.transmission(chosen.place, side_by_side([chosen]))
    assert creep is not None
    creep.begin(MECHANISM, rest(0.0, np.full(12, tensions_n)))
    return creep


def test_under_a_constant_load_it_grows_exponentially_to_its_share_of_the_stretch() -> None:
    creep = creeping(CREEP)
    for time in (0.0, 5.0, 10.0, 40.0, 400.0):
        expected = 0.2 * 50.0 / MECHANISM.stiffness_n_m * (1.0 - np.exp(-time / 10.0))
        np.testing.assert_allclose(creep.lengthening_m(time)[0], expected, atol=1e-15)


def test_after_the_load_it_recovers_as_slowly() -> None:
    creep = creeping(CREEP, tensions_n=50.0, settled=1.0, begun=1.0)  # at home under 50 N
    creep.settle(rest(0.0, np.full(12, 80.0)))
    creep.settle(rest(25.0, np.full(12, 50.0)))
    grown = 0.2 * 30.0 / MECHANISM.stiffness_n_m * (1.0 - np.exp(-2.5))
    for later in (0.0, 10.0, 500.0):
        np.testing.assert_allclose(
            creep.lengthening_m(25.0 + later)[0], grown * np.exp(-later / 10.0), atol=1e-15
        )


def test_three_elements_share_it_evenly() -> None:
    creep = creeping(CREEP, spread=5.0)
    parts = [np.exp(-12.0 / t) for t in (2.0, 10.0, 50.0)]
    expected = 0.2 * 50.0 / MECHANISM.stiffness_n_m * (1.0 - np.mean(parts))
    np.testing.assert_allclose(creep.lengthening_m(12.0)[0], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("settled", "begun", "at_first", "at_last"),
    [(0.0, 0.0, 0.0, 1.0), (0.0, 1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0), (0.5, 0.5, 0.25, 0.5)],
)
def test_what_was_over_before(
    settled: float, begun: float, at_first: float, at_last: float
) -> None:
    """In parts of the creep under pretension, which the cables carry all along."""
    creep = creeping(CREEP, settled=settled, begun=begun)
    whole = 0.2 * 50.0 / MECHANISM.stiffness_n_m
    np.testing.assert_allclose(creep.lengthening_m(0.0)[0], at_first * whole, atol=1e-15)
    np.testing.assert_allclose(creep.lengthening_m(1e4)[0], at_last * whole, atol=1e-15)


@pytest.mark.slow
def test_a_held_cable_relaxes_to_one_part_in_one_and_its_share() -> None:
    """Weightless and straight nothing turns: T = T0 (1 + s exp(-(1 + s) t / tau)) / (1 + s)."""
    weightless = replace(MECHANISM, gravity_m_s2=np.zeros(3))
    period, share = 0.05, 0.2
    arm = QuasiStaticArm([weightless], [[CREEP]])
    times = period * np.arange(601)
    found = np.stack([arm.step(t, np.zeros((1, 12)), np.zeros((4, 3)))[0] for t in times])
    expected = 50.0 * (1.0 + share * np.exp(-(1.0 + share) * times / 10.0)) / (1.0 + share)
    # tensions are taken as held between rests, which is off by up to half a period's change
    np.testing.assert_allclose(found, np.repeat(expected[:, None], 12, axis=1), atol=0.03)
    np.testing.assert_allclose(found[0], 50.0, atol=1e-4)
