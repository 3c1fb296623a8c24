"""Capstan friction of the arm: none changes nothing, and with it a loop that lasts."""

from __future__ import annotations

import numpy as np
import pytest
from effect_arms import MECHANISM, bent, course, entry, readings, up_and_down
from joint_torques import load_torques_n_m

from cablesense_sim import kinematics
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.quasi_static import QuasiStaticArm

BENT = bent(3, most_deg=6.0)
FRICTION = entry("capstan_friction", coefficient=0.15)


def test_a_load_that_goes_leaves_the_reading_of_runs_that_stick() -> None:
    """A wound pulley sticks while the load is taken off, and the actuators read no change."""
    wound = entry("capstan_friction", coefficient=0.13, pulley_wrap_rad=np.pi / 2)
    found = readings(course(BENT, up_and_down(rows=40)), wound)
    assert np.ptp(found[36:40], axis=0).max() > 0.5
    np.testing.assert_allclose(found[41:44], np.repeat(found[40:41], 3, axis=0), rtol=1e-12)


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
