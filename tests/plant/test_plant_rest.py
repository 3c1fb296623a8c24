"""The plant's rests without friction: equilibrium, derivatives, slack, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from plant_arm import BODY, NOMINAL

from cablesense_plants.arm.body import Body, PlantError, TipSpring
from cablesense_plants.arm.geometry import cable_lengths_m, frames, points_m, torques, turns
from cablesense_plants.arm.protocol import draw_schedule
from cablesense_plants.arm.rest import commanded_angles_rad, find_rest, follow_path, tension_law

RNG = np.random.default_rng(1)
STRAIGHT = np.zeros((1, 8))
ANGLES = RNG.uniform(-0.15, 0.15, (4, 8))
LOADS = RNG.uniform(-30.0, 30.0, (4, 4, 3))
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


def energy_j(body: Body, angles: np.ndarray, loads: np.ndarray) -> np.ndarray:
    placed = frames(body, angles, turns(body, angles))
    masses = points_m(placed, body.mass_joint, body.mass_at_m)
    contacts = points_m(placed, body.contact_joint, body.contact_at_m)
    total = -(masses @ body.gravity_m_s2) @ body.mass_kg - (contacts * loads).sum((1, 2))
    linear, cubic = body.spring_nm_rad.ravel(), body.hardening_nm_rad3.ravel()
    total += (0.5 * linear * angles**2 + 0.25 * cubic * angles**4).sum(1)
    per = body.cogging_per_turn
    total += (body.cogging_nm.ravel() * (1.0 - np.cos(per * angles)) / per).sum(1)
    tip = points_m(placed, np.array([3]), body.tip_at_m[None])[:, 0]
    for spring in body.tip_springs:
        away = tip - np.array(spring.anchor_m)
        if spring.normal is not None:
            away = np.maximum(away @ np.array(spring.normal), 0.0)[:, None]
        total += 0.5 * spring.stiffness_n_m * (away**2).sum(1)
    return total


def test_torques_are_the_slope_of_the_energy() -> None:
    """Virtual work of weights, loads, springs, cogging, a tether and a wall."""
    torque, slopes = torques(RICH, ANGLES, turns(RICH, ANGLES), LOADS)
    step = 1e-5
    for angle in range(8):
        moved = step * np.eye(8)[angle]
        work = energy_j(RICH, ANGLES + moved, LOADS) - energy_j(RICH, ANGLES - moved, LOADS)
        np.testing.assert_allclose(torque[:, angle], -work / (2 * step), atol=2e-8)
        ahead = torques(RICH, ANGLES + moved, turns(RICH, ANGLES + moved), LOADS)[0]
        back = torques(RICH, ANGLES - moved, turns(RICH, ANGLES - moved), LOADS)[0]
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

    for angle in range(8):
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


@pytest.mark.slow
def test_following_a_recording_meets_each_rest() -> None:
    schedule = draw_schedule(NOMINAL, np.random.default_rng(3))
    command, loads = schedule.command_rad, schedule.forces_n
    paid = cable_lengths_m(BODY, command) - cable_lengths_m(BODY, STRAIGHT)
    rest = follow_path(BODY, command, paid, loads)
    start = commanded_angles_rad(BODY, command)
    again = find_rest(BODY, rest.angles_rad, paid, loads)
    np.testing.assert_allclose(again.tensions_n, rest.tensions_n, atol=1e-6)
    near = find_rest(BODY, start, paid, loads)
    same = np.abs(near.tensions_n - rest.tensions_n).max(axis=1) < 1e-6
    assert same.mean() > 0.95  # the others have two rests, and the way there decides
    assert same[(loads == 0.0).all(axis=(1, 2))].all()
