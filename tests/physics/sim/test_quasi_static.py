"""From rest to rest: without history the static solver, with friction a loop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim.effects.registry import EffectEntry, amended
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.quasi_static import QuasiStaticArm
from tests.helpers.effect_arms import MECHANISM, bent, course, entry, push, readings, up_and_down

KINDS = [
    entry("capstan_friction", coefficient=0.1, pulley_wrap_rad=1.5, start_cable_3=0.2),
    entry("joint_friction", "joint_2", torque_n_m=0.1, start_yaw=-0.4),
    entry("cable_creep", "segment_3", share=0.3, time_s=2.0),
]


def tensions(
    mechanisms: list, variants: list[list[EffectEntry]], commands: np.ndarray, loads: np.ndarray
) -> np.ndarray:
    """Tensions (P, R, M) along a course."""
    arm = QuasiStaticArm(mechanisms, variants)
    held = held_lengths_m(MECHANISM, commands)
    rows = [
        arm.step(0.2 * i, np.repeat(held[i : i + 1], len(variants), axis=0), load)
        for i, load in enumerate(loads)
    ]
    return np.stack(rows, axis=1)


@pytest.mark.slow
@given(st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_memoryless_it_is_the_static_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    commands = bent(seed, count=6)
    loads = rng.uniform(-8.0, 8.0, (6, 4, 3))
    odd = amended(
        MECHANISM,
        [
            entry("payload", "segment_4", mass_kg=0.4),
            entry("joint_elasticity", stiffness_n_m_rad=3.0),
            entry("routing_geometry", "segment_2", plates_angle_rad=0.03),
            entry("base_tilt", roll_rad=0.1),
        ],
    )
    tensions_n = tensions([MECHANISM, odd], [[], []], commands, loads)
    held = held_lengths_m(MECHANISM, commands)
    for p, mechanism in enumerate((MECHANISM, odd)):
        rest = solve_equilibrium(mechanism, commands, loads, held_m=held)
        np.testing.assert_allclose(tensions_n[p], rest.tensions_n, atol=1e-3)


def test_a_load_beyond_the_arm_is_refused() -> None:
    arm = QuasiStaticArm([MECHANISM], [KINDS])
    arm.step(0.0, np.zeros((1, 12)), np.zeros((4, 3)))
    with pytest.raises(EquilibriumError):
        arm.step(0.2, np.zeros((1, 12)), push(4, [0.0, 5e4, 0.0]))


def test_an_arm_without_a_rest_leaves_the_others_alone() -> None:
    """One of three is pushed by more than it bears; the others read what they read without it."""
    some = QuasiStaticArm([MECHANISM] * 3, [[KINDS[0]]] * 3, some_may_fail=True)
    two = QuasiStaticArm([MECHANISM] * 2, [[KINDS[0]]] * 2)
    loads = [np.stack([f * load for f in (0.5, 1.0, 0.8)]) for load in up_and_down(rows=4)]
    for row, load in enumerate(loads):
        load[1] = push(4, [0.0, 5e4, 0.0]) if row > 1 else load[1]
        found = some.step(0.0, np.zeros((3, 12)), load)
        expected = two.step(0.0, np.zeros((2, 12)), load[::2])
        np.testing.assert_allclose(found[::2], expected, atol=1e-3)
        assert np.isnan(found[1]).all() == (row > 1)


BENT = bent(3, most_deg=6.0)
FRICTION = entry("capstan_friction", coefficient=0.15)


def test_a_load_cycle_leaves_a_loop_and_the_loop_lasts_at_rest() -> None:
    loads = up_and_down(rows=10)
    still = np.repeat(loads[15:16], 40, axis=0)
    replay = course(BENT, np.concatenate([loads[:16], still]))
    read_n = readings(replay, FRICTION)
    at_the_same_load = read_n[5], read_n[15]
    assert np.abs(at_the_same_load[0] - at_the_same_load[1]).max() > 0.3
    assert np.abs(readings(replay)[5] - readings(replay)[15]).max() < 1e-6
    np.testing.assert_array_equal(read_n[16:], np.repeat(read_n[15:16], 40, axis=0))


@pytest.mark.parametrize(("by_length", "ratios"), [(0.0, 0.5), (1.0, 1.25 / np.arange(1, 5))])
def test_what_an_actuator_reads_while_the_pulley_holds(by_length, ratios) -> None:
    """The pretension, whatever the arm weighs, and the stretch of the piece before the pulley."""
    held = {"coefficient": 0.5, "pulley_wrap_rad": 4.0, "weight_borne": 0.0}
    friction = entry("capstan_friction", run_compliance=0.5, run_by_length=by_length, **held)
    arm = QuasiStaticArm([MECHANISM], [[friction]])
    no_load = np.zeros((4, 3))
    tensions_n = [arm.step(0.0, np.full((1, 12), drawn), no_load)[0] for drawn in (0.0, -1e-4)]
    np.testing.assert_allclose(tensions_n[0], MECHANISM.pretension_n)
    stiffness = MECHANISM.stiffness_n_m * np.repeat(1.0 + 1.0 / (ratios + np.zeros(4)), 3)
    np.testing.assert_allclose(np.diff(tensions_n, axis=0)[0], 1e-4 * stiffness, rtol=1e-6)
