"""Capstan friction: equation (2) in slip, less while it sticks, and a loop that lasts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from effect_arms import MECHANISM, bent, course, entry, readings, small, up_and_down
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_torques import load_torques_n_m

from cablesense_sim import kinematics
from cablesense_sim.effects.effect import Rest
from cablesense_sim.effects.registry import side_by_side
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_sim.replay import replay_arm

SPANS_M = np.array([[[0.03, 0.03, 0.03], [0.03, 0.03, 0.0]]])
PASSES = SPANS_M > 0.0
BENDS_RAD = np.array(
    [
        [
            [[0.1, 0.2], [0.3, 0.1], [0.2, 0.4]],
            [[0.2, 0.2], [0.1, 0.3], [0.0, 0.0]],
        ]
    ]
)
BENT = bent(3, most_deg=6.0)
FRICTION = entry("capstan_friction", coefficient=0.15)


def over_guides(coefficient=0.2, pulley=1.5, give=1e-4, start=0.0, rounded=0.0, run=0.0):
    """Friction of two cables over the guides of three joints, having come to rest once."""
    values = {
        "coefficient": coefficient,
        "pulley_wrap_rad": pulley,
        "give_m": give,
        "rounded": rounded,
        "run_share": run,
        "start_cable_1": start,
        "start_cable_2": start,
    }
    friction = FRICTION.effect.transmission("arm", {k: np.array([v]) for k, v in values.items()})
    assert friction is not None
    friction.hold(np.zeros((1, 2)))  # taut: all spans are longer than that
    friction.begin(SimpleNamespace(cable_count=2), rest(SPANS_M))
    return friction


def rest(spans_m: np.ndarray) -> Rest:
    return Rest(0.0, np.zeros((1, 6)), spans_m, BENDS_RAD, np.zeros((1, 2)))


def drawn_in(by_m: float) -> np.ndarray:
    """The spans after every cable has been drawn in, most of it beyond the last joint."""
    spans = SPANS_M.copy()
    spans[:, 0] -= [1e-9, 1e-9, by_m]
    spans[:, 1, :2] -= [1e-9, by_m]
    return spans


def test_in_slip_the_tension_falls_by_equation_2_over_every_guide_passed() -> None:
    kept = over_guides().kept_tension(drawn_in(0.01), BENDS_RAD)
    wrap = 1.5 + np.array([[0.1, 0.3 + 0.3, 0.7 + 0.2], [0.2, 0.4 + 0.1, 0.0]])
    np.testing.assert_allclose(kept.spans[PASSES], np.exp(-0.2 * wrap)[PASSES[0]])
    np.testing.assert_array_equal(kept.spans_by_m[PASSES], 0.0)  # however far it is drawn


@pytest.mark.parametrize("rounded", [0.0, 0.6])
@pytest.mark.parametrize("start", [-1.0, 0.0, 0.3, 1.0])
def test_drawn_in_and_let_out_the_losses_are_opposite(start: float, rounded: float) -> None:
    friction = over_guides(start=start, rounded=rounded)
    there = friction.kept_tension(drawn_in(0.01), BENDS_RAD).spans
    friction.settle(rest(drawn_in(0.01)))
    back = friction.kept_tension(drawn_in(-0.01), BENDS_RAD).spans
    np.testing.assert_allclose((back * there)[PASSES], 1.0)


def test_before_it_slips_a_guide_holds_the_share_that_the_past_left() -> None:
    friction = over_guides(start=0.25)
    kept = friction.kept_tension(SPANS_M, BENDS_RAD).spans
    full = over_guides(start=1.0).kept_tension(SPANS_M, BENDS_RAD).spans
    np.testing.assert_allclose(np.log(kept), 0.25 * np.log(full))
    for _ in range(5):  # rest, as often as one looks
        friction.settle(rest(SPANS_M))
    np.testing.assert_array_equal(friction.kept_tension(SPANS_M, BENDS_RAD).spans, kept)


@given(st.lists(st.floats(-5e-4, 5e-4), min_size=1, max_size=12), st.floats(-1.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_tensions_across_the_guides_are_never_further_apart_than_in_slip(
    path: list[float], start: float
) -> None:
    friction = over_guides(start=start, rounded=0.5)
    most = -np.log(over_guides(start=1.0).kept_tension(SPANS_M, BENDS_RAD).spans)
    for by_m in path:
        kept = friction.kept_tension(drawn_in(by_m), BENDS_RAD).spans
        assert (np.abs(np.log(kept)) <= most + 1e-12).all()
        friction.settle(rest(drawn_in(by_m)))


@pytest.mark.parametrize("rounded", [0.0, 0.5])
@pytest.mark.parametrize("run", [0.0, 0.4, 1.0])
def test_slopes_are_the_derivatives_by_the_spans(rounded: float, run: float) -> None:
    friction = over_guides(start=0.2, rounded=rounded, run=run)
    spans = drawn_in(2e-5)  # it gives by 1e-4: everything sticks
    kept = friction.kept_tension(spans, BENDS_RAD)
    for cable, joint in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1)):
        moved = spans.copy()
        moved[0, cable, joint] += 1e-9
        more = friction.kept_tension(moved, BENDS_RAD)
        by_m = (more.spans - kept.spans)[0, cable] / 1e-9
        np.testing.assert_allclose(by_m, kept.spans_by_m[0, cable, :, joint], rtol=1e-4, atol=1e-3)
        mean_by_m = (more.mean - kept.mean)[0, cable] / 1e-9
        np.testing.assert_allclose(
            mean_by_m, kept.mean_by_m[0, cable, joint], rtol=1e-4, atol=1e-3
        )


def test_no_friction_changes_nothing() -> None:
    replay = course(BENT, up_and_down())
    none = small(FRICTION, coefficient=0.0)
    np.testing.assert_allclose(readings(replay, none), readings(replay), atol=1e-3)


def test_a_load_cycle_leaves_a_loop_and_the_loop_lasts_at_rest() -> None:
    loads = up_and_down(rows=10)
    still = np.repeat(loads[15:16], 40, axis=0)
    replay = course(BENT, np.concatenate([loads[:16], still]))
    found = readings(replay, FRICTION)
    at_the_same_load = found[5], found[15]
    assert np.abs(at_the_same_load[0] - at_the_same_load[1]).max() > 0.3
    assert np.abs(readings(replay)[5] - readings(replay)[15]).max() < 1e-6
    np.testing.assert_array_equal(found[16:], np.repeat(found[15:16], 40, axis=0))


def test_how_fast_it_goes_does_not_matter() -> None:
    slow, fast = (course(BENT, up_and_down(), period_s) for period_s in (30.0, 0.01))
    np.testing.assert_array_equal(readings(slow, FRICTION), readings(fast, FRICTION))


@pytest.mark.slow
def test_finer_steps_lead_to_the_same_rest() -> None:
    ends = [
        readings(course(BENT, up_and_down(rows=rows)), FRICTION)[[rows, -1]]
        for rows in (8, 16, 64)
    ]
    loop = np.abs(ends[2][1] - readings(course(BENT, up_and_down()), FRICTION)[0]).max()
    assert np.abs(ends[1] - ends[2]).max() < 0.05 * loop
    assert np.abs(ends[0] - ends[2]).max() < 0.1 * loop


def test_what_joints_feel_lies_within_what_guides_can_hold() -> None:
    """At every rest J'T differs from the load by no more than slipping guides would take."""
    mu = FRICTION.values["coefficient"]
    arm = QuasiStaticArm([MECHANISM], [[FRICTION]])
    held = held_lengths_m(MECHANISM, BENT)[None]
    for row, load in enumerate(up_and_down(rows=6)):
        tensions = arm.step(0.0, held, load)[0]
        angles = arm.joint_angles_rad[0]
        span = kinematics.spans(MECHANISM, angles)
        jacobian = kinematics.interleave(span)
        torque = load_torques_n_m(MECHANISM, angles, load)
        # a cable turns at both guides of a joint by at most the joint's own bend, twice
        bend = np.abs(angles.reshape(-1, 2)).sum(-1)
        most = np.expm1(mu * 2.0 * np.cumsum(bend))
        missing = np.abs(jacobian.T @ tensions - torque)
        allowed = (np.abs(jacobian) * tensions[:, None] * np.repeat(most, 2)).sum(0)
        assert (missing <= allowed + 1e-6).all()
        assert row == 0 or missing.max() > 0.01  # it began without friction's share


def test_a_file_with_friction_replays() -> None:
    from arm_variants import variant

    listed = {"effect": "capstan_friction", "parameters": {"coefficient": 0.15}}
    arm = variant({"effects": [listed]}, "cdsm_lab")
    replay = course(BENT, up_and_down())
    found = replay_arm(arm, replay.time_s, replay.command_rad, replay.forces_n)
    np.testing.assert_array_equal(found, readings(replay, FRICTION))
    assert side_by_side([FRICTION])["coefficient"] == [0.15]
