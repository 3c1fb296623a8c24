"""Creep of cables and dry friction of joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim import kinematics
from cablesense_sim.effects.effect import ArmEquilibrium
from cablesense_sim.effects.registry import EffectEntry, side_by_side
from cablesense_sim.quasi_static import QuasiStaticArm
from tests.helpers.effect_arms import MECHANISM, entry, small, up_and_down
from tests.helpers.joint_torques import load_torques_n_m

CREEP = entry("cable_creep", share=0.2, time_s=10.0)


def rest(time_s: float, tensions_n: np.ndarray) -> ArmEquilibrium:
    nothing = np.zeros((1, 12, 4))
    tensions = np.broadcast_to(tensions_n, (1, 12))
    return ArmEquilibrium(time_s, np.zeros((1, 8)), nothing, np.zeros((1, 12, 4, 2)), tensions)


def creeping(entry_: EffectEntry, tensions_n: float = 50.0, **values: float):
    """Its creep, having begun at 0 s under equal tensions."""
    chosen = small(entry_, **values)
    creep = chosen.effect.transmission(chosen.place, side_by_side([chosen]))
    assert creep is not None
    creep.begin(MECHANISM, rest(0.0, np.full(12, tensions_n)))
    return creep


def test_under_a_constant_load_it_grows_exponentially_to_its_share_of_the_stretch() -> None:
    """One element, and three around the same time that share it evenly."""
    for spread, times_s in ((1.0, [10.0]), (5.0, [2.0, 10.0, 50.0])):
        creep = creeping(CREEP, spread=spread)
        for time in (0.0, 5.0, 40.0, 400.0):
            share = 0.2 * np.mean([1.0 - np.exp(-time / each) for each in times_s])
            expected = share * 50.0 / MECHANISM.stiffness_n_m
            np.testing.assert_allclose(creep.lengthening_m(time)[0], expected, atol=1e-15)


@pytest.mark.slow
def test_a_held_cable_relaxes_to_one_part_in_one_and_its_share() -> None:
    """Weightless and straight nothing turns: T = T0 (1 + s exp(-(1 + s) t / tau)) / (1 + s)."""
    weightless = replace(MECHANISM, gravity_m_s2=np.zeros(3))
    period = 0.05
    share = 0.2
    arm = QuasiStaticArm([weightless], [[CREEP]])
    times = period * np.arange(301)
    tensions = np.stack([arm.step(t, np.zeros((1, 12)), np.zeros((4, 3)))[0] for t in times])
    expected = 50.0 * (1.0 + share * np.exp(-(1.0 + share) * times / 10.0)) / (1.0 + share)
    # tensions are taken to change evenly between rests
    np.testing.assert_allclose(tensions, np.repeat(expected[:, None], 12, axis=1), atol=1e-3)
    np.testing.assert_allclose(tensions[0], 50.0, atol=1e-4)


@pytest.mark.parametrize(("settled", "moved"), [(1.0, False), (0.5, True)])
def test_what_settled_did_so_under_the_weight(settled: float, moved: bool) -> None:
    arm = QuasiStaticArm([MECHANISM], [[small(CREEP, settled=settled)]])
    now, later = (arm.step(t, np.zeros((1, 12)), np.zeros((4, 3)))[0] for t in (0.0, 100.0))
    assert np.ptp(now) > 1.0
    assert (np.abs(later - now).max() > 0.1) == moved
    assert moved or np.allclose(later, now, atol=1e-6)


FRICTION = entry("joint_friction", "joint_2", torque_n_m=0.15)


def dry(entry_: EffectEntry = FRICTION, start: float = 0.0, **values: float):
    """Its friction, having come to rest straight."""
    numbers = {**entry_.values, "start_pitch": start, "start_yaw": start, **values}
    friction = entry_.effect.transmission(
        entry_.place, {name: np.array([v]) for name, v in numbers.items()}
    )
    assert friction is not None
    friction.begin(MECHANISM, at(np.zeros(8)))
    friction.settle(at(np.zeros(8)))
    return friction


def at(angles_rad: np.ndarray) -> ArmEquilibrium:
    nothing = np.zeros((1, 12, 4))
    return ArmEquilibrium(
        0.0, angles_rad[None], nothing, np.zeros((1, 12, 4, 2)), np.zeros((1, 12))
    )


def course_of(friction, turns_rad: np.ndarray) -> np.ndarray:
    """Torque about the pitch of joint 2 at rest after rest."""
    torques = []
    for turn in turns_rad:
        angles = np.where(np.arange(8) == 2, turn, 0.0)
        torque, _ = friction.joint_torque_n_m(angles[None])
        friction.settle(at(angles))
        np.testing.assert_array_equal(torque[0, [0, 1, 4, 5, 6, 7]], 0.0)
        torques.append(torque[0, 2])
    return np.array(torques)


def test_it_gives_before_it_breaks_away_and_then_stays() -> None:
    turns = np.array([0.0, 1e-4, 2e-4, 3e-4, 5e-4, 0.01, 0.01 - 3e-4, 0.01 - 6e-4, 0.0])
    shares = np.array([0.0, 1 / 3, 2 / 3, 1.0, 1.0, 1.0, 0.0, -1.0, -1.0])
    np.testing.assert_allclose(course_of(dry(), turns), 0.15 * shares, atol=1e-12)


@pytest.mark.slow
@given(st.lists(st.floats(-0.01, 0.01), min_size=1, max_size=12), st.floats(-1.0, 1.0))
@settings(max_examples=10, deadline=None)
def test_never_more_than_the_limit_and_never_a_gift_of_energy(
    turns: list[float], start: float
) -> None:
    path = np.array([0.0, *turns])
    # it gives along the way: with steps as fine as its own give the work is well summed
    fine = np.interp(np.linspace(0.0, len(path) - 1.0, 80 * len(path)), range(len(path)), path)
    torque = course_of(dry(start=start), fine)
    assert np.abs(torque).max() <= 0.15 + 1e-12
    work = (0.5 * (torque[1:] + torque[:-1]) * np.diff(fine)).sum()
    stored = 0.5 * 0.15 * 3e-4
    assert work >= -stored - 1e-9


@pytest.mark.parametrize("numbers", [[1, 2, 3, 4]])
def test_a_slipping_joint_carries_its_limit_of_the_load(numbers: list[int]) -> None:
    """Between J'T and the load's torque lies the limit, against the motion, and nothing else."""
    dry_joints = [entry("joint_friction", f"joint_{n}", torque_n_m=0.15) for n in numbers]
    where = [axis for n in numbers for axis in (2 * n - 2, 2 * n - 1)]
    arm = QuasiStaticArm([MECHANISM], [dry_joints])
    before = None
    for load in up_and_down(segment=4):
        tensions = arm.step(0.0, np.zeros((1, 12)), load)[0]
        angles = arm.joint_angles_rad[0]
        torque = load_torques_n_m(MECHANISM, angles, load)
        missing = torque - kinematics.cable_jacobian_m(MECHANISM, angles).T @ tensions
        assert np.abs(missing).max() <= 0.15 + 1e-5
        np.testing.assert_allclose(np.delete(missing, where), 0.0, atol=1e-5)
        if before is not None:
            far = np.abs(angles - before) > 2 * 3e-4
            far[[j for j in range(8) if j not in where]] = False
            expected = 0.15 * np.sign(angles - before)[far]
            np.testing.assert_allclose(missing[far], expected, atol=1e-5)
        before = angles
