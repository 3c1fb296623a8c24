"""The plant's geometry and its rests without friction: closed forms, derivatives, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_plants.arm.arm import Schedule, ideal_arm
from cablesense_plants.arm.body import Body, PlantError, TipSpring
from cablesense_plants.arm.listed import ArmDraw
from cablesense_plants.arm.statics import (
    cable_lengths_m,
    find_rest,
    frames,
    spans,
    tension_law,
    torques,
    turns,
)
from cablesense_plants.arm.unlisted import UNLISTED
from tests.helpers.plant_arm import BODY, NOMINAL

JOINTS = 2 * NOMINAL.segment_count
RNG = np.random.default_rng(0)
ANGLES = RNG.uniform(-0.15, 0.15, (5, JOINTS))

STRAIGHT = np.zeros((1, 8))
LOADS = RNG.uniform(-30.0, 30.0, (5, 4, 3))
EVERYWHERE = RNG.uniform(-10.0, 10.0, (5, 16, 3))
RICH = replace(
    BODY,
    spring_nm_rad=RNG.uniform(0.0, 5.0, (4, 2)),
    hardening_nm_rad3=RNG.uniform(0.0, 20.0, (4, 2)),
    cogging_nm=RNG.uniform(0.0, 0.05, (4, 2)),
    tip_springs=(
        TipSpring((0.5, 0.2, 0.1), 30.0),
        TipSpring((0.5, -0.05, 0.0), 400.0, (0.0, 0.6, 0.8)),
    ),
)


SCHEDULE = Schedule(
    np.zeros(1),
    np.zeros(1, dtype=int),
    STRAIGHT,
    np.array([3]),
    np.array([[2.0, 15.0, -25.0]]),
    np.array([np.nan]),
)


def lengths(body: Body, angles: np.ndarray) -> np.ndarray:
    return spans(body, angles, turns(body, angles)).length_m


@pytest.mark.parametrize("angle", [-0.3, 0.1])
def test_a_span_in_the_plane_of_bending_has_its_closed_form(angle: float) -> None:
    """The hole at +z when a joint pitches: the law of cosines about the joint's centre."""
    angles = np.zeros((1, JOINTS))
    angles[0, 0] = angle
    offset = 0.015
    radius = 0.05
    half = np.arctan2(offset, radius)
    # the plates open by the pitch on the side of +z when the arm pitches down, and close above
    expected = 2.0 * np.hypot(offset, radius) * np.sin(half + 0.5 * angle)
    assert lengths(BODY, angles)[0, 0, 0] == pytest.approx(expected, rel=1e-12)


def energy_j(body: Body, angles: np.ndarray, loads: np.ndarray) -> np.ndarray:
    placed = frames(body, angles, turns(body, angles))
    masses = placed.points_m(body.mass_joint, body.mass_at_m)
    points = placed.points_m(body.contact_joint.ravel(), body.contact_at_m.reshape(-1, 3))
    contacts = points[:, : loads.shape[1]]
    total = -(masses @ body.gravity_m_s2) @ body.mass_kg - (contacts * loads).sum((1, 2))
    linear = body.spring_nm_rad.ravel()
    cubic = body.hardening_nm_rad3.ravel()
    total += (0.5 * linear * angles**2 + 0.25 * cubic * angles**4).sum(1)
    per = body.cogging_per_turn
    total += (body.cogging_nm.ravel() * (1.0 - np.cos(per * angles)) / per).sum(1)
    tip = placed.points_m(np.array([3]), body.tip_at_m[None])[:, 0]
    for spring in body.tip_springs:
        away = tip - np.array(spring.anchor_m)
        if spring.normal is not None:
            away = np.maximum(away @ np.array(spring.normal), 0.0)[:, None]
        total += 0.5 * spring.stiffness_n_m * (away**2).sum(1)
    return total


def test_torques_are_the_slope_of_the_energy() -> None:
    """Virtual work of weights, loads at all points, springs, cogging, a tether and a wall."""
    torque, slopes = torques(RICH, ANGLES, turns(RICH, ANGLES), EVERYWHERE)
    step = 1e-5
    for angle in range(8):
        moved = step * np.eye(8)[angle]
        work = energy_j(RICH, ANGLES + moved, EVERYWHERE) - energy_j(
            RICH, ANGLES - moved, EVERYWHERE
        )
        np.testing.assert_allclose(torque[:, angle], -work / (2 * step), atol=2e-8)
        ahead = torques(RICH, ANGLES + moved, turns(RICH, ANGLES + moved), EVERYWHERE)[0]
        back = torques(RICH, ANGLES - moved, turns(RICH, ANGLES - moved), EVERYWHERE)[0]
        slope = (ahead - back) / (2 * step)
        np.testing.assert_allclose(slopes[:, :, angle], slope, atol=2e-6)


def test_at_rest_no_small_turn_does_work() -> None:
    """The cables' energy by finite differences, against everything else's torque."""
    paid = cable_lengths_m(BODY, ANGLES) - cable_lengths_m(BODY, STRAIGHT)
    rest = find_rest(BODY, ANGLES, paid, LOADS)
    outer = torques(BODY, rest.angles_rad, turns(BODY, rest.angles_rad), LOADS)[0]
    wanted = paid + cable_lengths_m(BODY, STRAIGHT)
    step = 1e-6

    def stored_j(angles: np.ndarray) -> np.ndarray:
        tension, _ = tension_law(BODY, cable_lengths_m(BODY, angles) - wanted)
        return (0.5 * tension**2 / BODY.stiffness_n_m).sum(1)

    for angle in range(0, 8, 3):
        moved = step * np.eye(8)[angle]
        work = stored_j(rest.angles_rad + moved) - stored_j(rest.angles_rad - moved)
        np.testing.assert_allclose(work / (2 * step), outer[:, angle], atol=1e-5)


def test_a_cable_never_pushes() -> None:
    load = np.zeros((1, 4, 3))
    load[0, 3, 2] = -70.0
    rest = find_rest(BODY, STRAIGHT, np.zeros((1, 12)), load)
    assert rest.tensions_n.min() == 0.0
    assert rest.tensions_n.max() > 200.0


def test_a_load_beyond_all_bearing_is_refused() -> None:
    load = np.zeros((1, 4, 3))
    load[0, 3, 2] = -2000.0
    with pytest.raises(PlantError, match=r"row 1: joint . bends by|no rest found in 1 rows"):
        find_rest(BODY, STRAIGHT, np.zeros((1, 12)), load)


@pytest.mark.parametrize("at_m", [0.0, 0.02, 0.065, 0.12])
def test_a_load_at_a_place_is_one_on_an_arm_with_its_contact_points_there(at_m: float) -> None:
    """Also where segments bend in their middle: all but stiff ones are as rigid ones."""
    placed = SCHEDULE._replace(load_at_m=np.where(SCHEDULE.load_segment, at_m, np.nan))
    there = replace(BODY, contact_at_m=np.tile([at_m, 0.0, 0.0], (4, 4, 1)))
    ideal = ideal_arm(NOMINAL)
    loads = ideal.point_loads_n(placed)
    rest = find_rest(BODY, STRAIGHT, np.zeros((1, 12)), loads)
    wanted = find_rest(there, STRAIGHT, np.zeros((1, 12)), SCHEDULE.forces_n)
    np.testing.assert_allclose(rest.tensions_n, wanted.tensions_n, atol=1e-6)
    limber = UNLISTED["limber_segments"](ArmDraw(np.random.default_rng(0), NOMINAL))
    stiff = limber.apply(ideal, 1e-6).body
    bent = find_rest(stiff, np.zeros((1, 16)), np.zeros((1, 12)), loads)
    np.testing.assert_allclose(bent.tensions_n, wanted.tensions_n, atol=2e-3)
