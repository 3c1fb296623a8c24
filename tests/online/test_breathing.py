"""A breath's circle moves every cable at every guide, and hardly the tip; its set-points end."""

import numpy as np
import pytest
from arm_variants import variant
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_msgs_py.messages import BREATH_END
from cablesense_online.breathing import (
    MOST_RAD,
    SET_POINTS_A_TURN,
    Breath,
    BreathError,
    breath_circle,
    tip_m,
)
from cablesense_sim import kinematics
from cablesense_sim.build import mechanism_of

STRAIGHT = np.zeros(8)
BENT = np.radians([4.0, -3.0, 6.0, 2.0, -5.0, 7.0, 3.0, -2.0])


def arm(coefficient=0.1, name="cdsm_lab", **changes):
    parameters = {"coefficient": coefficient, "pulley_wrap_rad": 1.57}
    effect = {"effect": "capstan_friction", "at": "arm", "parameters": parameters}
    return variant({"effects": [effect], **changes}, name)


def circle_of(arm_of, points):
    return np.array([arm_of.at(k / points) for k in range(points)])


@pytest.mark.parametrize("command", [STRAIGHT, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_every_cable_moves_in_and_out_at_every_guide_it_passes(command, count):
    angles = {"first": 0, "per_segment": 120 / count, "per_cable": -120}
    some = arm(**{"segments.count": count, "cables.angle_deg": angles})
    mechanism, command = mechanism_of(some), np.resize(command, 2 * count)
    circle = breath_circle(some, command)
    beyond_m = [
        kinematics.spans(mechanism, command + deviation).length_m[..., ::-1].cumsum(-1)[..., ::-1]
        for deviation in circle_of(circle, 24)
    ]
    swing_m = np.ptp(beyond_m, axis=0)
    passed = mechanism.cable_segment[:, None] > np.arange(count)
    stretch_m = np.sinh(0.1 * 1.57) * mechanism.pretension_n / mechanism.stiffness_n_m
    assert (swing_m[passed].reshape(-1) > 2.0 * stretch_m.max()).all()


@settings(max_examples=10, deadline=None)
@given(bend=st.floats(0.0, 8.0), seed=st.integers(0, 2**32 - 1))
def test_the_tip_moves_by_less_than_a_millimetre(bend, seed):
    lab = arm()
    command = np.radians(bend) * np.random.default_rng(seed).uniform(-1.0, 1.0, 8)
    circle, mechanism = breath_circle(lab, command), mechanism_of(lab)
    ends = tip_m(mechanism, command + circle_of(circle, 24)) - tip_m(mechanism, command)
    assert np.linalg.norm(ends, axis=1).max() < 1e-3
    assert circle.tip_m == pytest.approx(np.linalg.norm(ends, axis=1).max(), rel=0.1)


@pytest.mark.parametrize("turns", [1, 3])
def test_set_points_begin_and_end_at_the_command_and_never_jump(turns):
    circle = breath_circle(arm(), BENT)
    breath, points, marks = Breath(circle, turns), [STRAIGHT], []
    while not breath.over:
        point, turn = breath.next()
        points.append(point)
        marks.append(turn)
    assert marks.count(1) == SET_POINTS_A_TURN
    assert max(marks) == turns
    assert marks[-1] == BREATH_END
    np.testing.assert_array_equal(points[-1], STRAIGHT)
    steps = np.abs(np.diff(points, axis=0)).max()
    assert steps <= 1.1 * 2.0 * np.pi / SET_POINTS_A_TURN * circle.largest_rad
    whole = np.array(points[1:])[np.array(marks) == 1]
    half = SET_POINTS_A_TURN // 2
    np.testing.assert_allclose(whole[:half], -whole[half:], atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(after=st.integers(0, 90))
def test_a_breath_that_is_ended_comes_back_without_a_jump(after):
    circle = breath_circle(arm(), STRAIGHT)
    breath = Breath(circle, 0)
    points = [breath.next()[0] for _ in range(after)]
    breath.end()
    while not breath.over:
        points.append(breath.next()[0])
    steps = np.abs(np.diff([STRAIGHT, *points], axis=0)).max()
    assert steps <= 1.1 * 2.0 * np.pi / SET_POINTS_A_TURN * circle.largest_rad
    np.testing.assert_array_equal(points[-1], STRAIGHT)
    assert len(points) <= after + 12


def test_where_there_is_no_breath_the_reason_is_given():
    with pytest.raises(BreathError, match="lists no capstan_friction"):
        breath_circle(variant({}), STRAIGHT)
    with pytest.raises(BreathError, match=r"swing by .* degrees, more than 2"):
        breath_circle(arm(0.8), STRAIGHT)
    with pytest.raises(BreathError, match=r"more than 2"):
        breath_circle(arm(), STRAIGHT, amplitude_rad=1.1 * MOST_RAD)
    with pytest.raises(BreathError, match=r"cable_\d+ with .* slack"):
        breath_circle(arm(**{"cables.pretension_n": 5.0}), STRAIGHT)
    with pytest.raises(BreathError, match=r"tip by .* mm, more than 0.01"):
        breath_circle(arm(), BENT, largest_tip_m=1e-5)


def test_an_amplitude_that_is_given_needs_no_friction_in_the_file():
    circle = breath_circle(variant({}), STRAIGHT, amplitude_rad=0.004)
    assert circle.largest_rad == pytest.approx(0.004)
    assert circle.least_rad == 0.0
