"""A course of commands and loads as the sensors of many arms would read it.

What the tension sensors make of a tension: noise, step and range.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablesense_sim.arm import Sensors, open_arm
from cablesense_sim.course import Course
from cablesense_sim.effects.effect import Effect
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import (
    Replay,
    mean_variance_n2,
    read_tensions_n,
    reading_variance_n2,
    replay_arm,
)
from tests.helpers.arm_variants import variant
from tests.helpers.effect_arms import ARM, MECHANISM, bent, course, entry, readings, up_and_down

COMMANDS = np.repeat(bent(11, count=3, most_deg=6.0), 5, axis=0)
LOADS = np.concatenate([up_and_down(rows=2, segment=2)] * 3)


def any_entry(effect: Effect, size: float = 1.0):
    """An effect of its typical size in the middle of its places."""
    places = effect.places(4, 12)
    values = {p.name: size * p.typical for p in effect.parameters if p.role == "size"}
    return entry(effect.name, places[len(places) // 2], **values)


def test_without_effects_it_is_the_static_solver() -> None:
    expected = solve_equilibrium(MECHANISM, COMMANDS, LOADS).tensions_n
    np.testing.assert_allclose(readings(course(COMMANDS, LOADS)), expected, atol=1e-6)


@pytest.mark.parametrize("name", list(known_effects()))
def test_every_effect_is_seen_none_of_size_zero_and_side_by_side_as_alone(name: str) -> None:
    """A lag is seen after a step, a play after a reversal, a drift after a while."""
    effect = known_effects()[name]
    seen_n = []
    for period_s in (0.2, 3.0) if effect.needs_time else (0.2,):
        replay = course(COMMANDS, LOADS, period_s=period_s)
        ideal = readings(replay)
        none, whole = replay.readings_n([[any_entry(effect, size)] for size in (0.0, 1.0)])
        np.testing.assert_allclose(none, ideal, atol=1e-3)
        np.testing.assert_allclose(whole, readings(replay, any_entry(effect)), atol=1e-3)
        seen_n.append(np.abs(whole - ideal).max())
    assert max(seen_n) > (0.005 if effect.tolerance else 0.05)


@pytest.mark.parametrize("name", ["capstan_friction", "joint_friction"])
def test_friction_states_at_the_start_are_read_side_by_side_as_alone(name: str) -> None:
    """They are simulated together and only for a while, as their influence fades."""
    effect = known_effects()[name]
    sized = any_entry(known_effects()[name])
    none = {p.name: p.default for p in (*effect.parameters, *effect.history(4, 12)) if p.fades}
    changes = [none, *(none | {each: 0.8} for each in none)]
    every = [replace(sized, values=sized.values | each) for each in changes]
    replay = course(COMMANDS, LOADS)
    read_n = replay.readings_n([[each] for each in every])
    alone = [readings(replay, each) for each in every]
    np.testing.assert_allclose(read_n, alone, atol=1e-3)
    assert (np.abs(read_n[1:] - read_n[0]).max(axis=(1, 2)) > 5e-3).all()


FRICTION = {"effect": "capstan_friction", "parameters": {"coefficient": 0.1}}
CREEP = {"effect": "cable_creep", "parameters": {"share": 0.2}}


@pytest.mark.parametrize("effects", [[], [FRICTION], [CREEP]], ids=["none", "friction", "creep"])
def test_a_stated_place_is_a_contact_point_there(effects: list[dict[str, object]]) -> None:
    """One after the other: with a state, every place begins where the last has ended."""
    run = Course(0.2 * np.arange(len(COMMANDS)), COMMANDS, LOADS)
    arm = variant({"effects": effects}, "cdsm_lab")
    for at_m in (0.0, 0.03, 0.12):
        there = variant({"effects": effects, "segments.contact_m": max(at_m, 1e-9)}, "cdsm_lab")
        replayed = replay_arm(arm, run._replace(places_m=np.full((len(LOADS), 4), at_m)))
        np.testing.assert_allclose(replayed, replay_arm(there, run), atol=1e-5)
    unstated = replay_arm(arm, run._replace(places_m=np.full((len(LOADS), 4), np.nan)))
    np.testing.assert_array_equal(unstated, replay_arm(arm, run))


@pytest.mark.parametrize("name", ["contact_offset", "capstan_friction"])
def test_loads_at_several_places_are_those_of_each(name: str) -> None:
    """Each cycle ends unloaded where it began, so that without a state each stands alone."""
    places_m = np.repeat([0.03, np.nan, 0.11], 5)[:, None] * np.ones(4)
    mixed_course = Course(0.2 * np.arange(15), COMMANDS, LOADS, places_m)
    mixed = Replay(ARM, mixed_course)
    alone = [
        Replay(ARM, mixed_course._replace(places_m=np.full((15, 4), at_m)))
        for at_m in (0.03, np.nan, 0.11)
    ]
    same = any_entry(known_effects()[name], 0.0)
    expected = np.concatenate(
        [readings(each, same)[5 * k : 5 * k + 5] for k, each in enumerate(alone)]
    )
    np.testing.assert_allclose(readings(mixed, same), expected, atol=1e-3)


def test_the_order_in_an_arm_file_makes_no_difference() -> None:
    listed = [
        {"effect": "sensor_offset", "at": "cable_4", "parameters": {"offset_n": 10.0}},
        {"effect": "sensor_gain", "at": "cable_4", "parameters": {"gain": 0.1}},
        {"effect": "sensor_lag", "at": "cable_4", "parameters": {"time_constant_s": 0.3}},
        {"effect": "sensor_crosstalk", "parameters": {"share": 0.1}},
        {"effect": "segment_tolerance", "at": "segment_2", "parameters": {"mass_share": 0.05}},
        {"effect": "payload", "at": "segment_2", "parameters": {"mass_kg": 2.0}},
        {"effect": "payload", "at": "segment_2", "parameters": {"mass_kg": -0.4}},
        {"effect": "cable_creep", "parameters": {"share": 0.2}},
    ]
    run = Course(0.2 * np.arange(len(COMMANDS)), COMMANDS, LOADS)
    one, other = (
        replay_arm(variant({"effects": order}, "cdsm_lab"), run)
        for order in (listed, listed[::-1])
    )
    np.testing.assert_array_equal(one, other)


SENSORS = open_arm("cdsm").sensors
MANY = 200_000


def with_(**changes: object) -> Sensors:
    return SENSORS.model_copy(update=changes)


@pytest.mark.parametrize("noise_std_n", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("step_n", [0.0, 0.1813])
def test_mean_and_variance_are_as_stated(noise_std_n: float, step_n: float) -> None:
    rng = np.random.default_rng(1)
    sensors = with_(noise_std_n=noise_std_n, step_n=step_n)
    truth = rng.uniform(10, 200, MANY)  # many steps wide, so that rounding is uniform
    error = read_tensions_n(truth, sensors, rng) - truth
    variance = reading_variance_n2(sensors)
    assert variance == pytest.approx(noise_std_n**2 + step_n**2 / 12)
    # five standard deviations of either estimate
    assert abs(error.mean()) <= 5 * np.sqrt(variance / MANY)
    assert error.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / MANY), abs=1e-30)


@pytest.mark.parametrize(
    ("noise_std_n", "step_n"), [(0.05, 0.18), (0.02, 0.2), (0.0, 0.3), (0.1, 0)]
)
def test_rounding_does_not_average_out(noise_std_n: float, step_n: float) -> None:
    rng = np.random.default_rng(4)
    sensors = with_(noise_std_n=noise_std_n, step_n=step_n)
    truth = rng.uniform(10, 200, (4000, 1))
    off = read_tensions_n(np.repeat(truth, 30, axis=1), sensors, rng).mean(1) - truth[:, 0]
    expected = mean_variance_n2(sensors, 30)
    assert off.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / 4000))
    assert mean_variance_n2(sensors, 1) == pytest.approx(reading_variance_n2(sensors))


def test_readings_are_multiples_of_the_step_and_saturate_at_the_ends_of_the_range() -> None:
    sensors = with_(range_n=(0.0, 100.0))
    steps = read_tensions_n(np.linspace(0, 300, 99), SENSORS, np.random.default_rng(0)) / 0.1813
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    readings = read_tensions_n([-50.0, 50.0, 500.0], sensors, np.random.default_rng(0))
    assert readings[0] == 0.0
    assert readings[1] == pytest.approx(50.0, abs=0.5)
    assert readings[2] == 100.0


@pytest.mark.parametrize("beside", [(), (entry("joint_friction", "joint_2"),)], ids=["", "rough"])
def test_a_load_cell_changes_the_loads_that_act(beside) -> None:
    """A fifth more, turned by half a radian about the base's x axis."""
    cell = entry("load_cell", scale=0.2, turn_x_rad=0.5)
    y = LOADS[..., 1]
    z = LOADS[..., 2]
    acting = 1.2 * np.stack(
        [LOADS[..., 0], np.cos(0.5) * y - np.sin(0.5) * z, np.sin(0.5) * y + np.cos(0.5) * z], -1
    )
    np.testing.assert_allclose(
        readings(course(COMMANDS, LOADS), cell, *beside),
        readings(course(COMMANDS, acting), *beside),
        atol=1e-5,
    )
