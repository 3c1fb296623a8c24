"""The simulated arm as the sim node drives it.

Simulated time keeps to real time and never runs after it for long.

At rest it reads what the replay reads, with effects of each kind.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.messages import Load
from cablesense_online.simulated_arm import RealTimePacer, SimulatedArm
from cablesense_sim.arm import open_arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.built_arm import built_arm
from cablesense_sim.course import Course
from cablesense_sim.dynamics import ArmDynamics, moving_arm
from cablesense_sim.effects.registry import known_effects, sensings
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.replay import replay_arm
from tests.helpers.arm_variants import variant
from tests.helpers.effect_arms import bent

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
FRICTION = {"effect": "capstan_friction", "at": "arm", "parameters": {"coefficient": 0.1}}
PUSH = Load(3, np.array([0.0, 30.0, 0.0]))


def simulated(load_timeout_s=0.0):
    return SimulatedArm(ArmDynamics(ARM), 1e-3, np.radians(20.0), load_timeout_s, now_s=0.0)


def run(arm, start_s, end_s, step_s=0.01):
    for now in np.arange(start_s, end_s, step_s):
        arm.advance_to(now)


def tensions(arm):
    return arm.reading_n(ARM.sensors, None)


def test_a_push_holds_until_it_is_taken_away():
    arm = simulated()
    arm.push(PUSH, 0.0)
    run(arm, 0.0, 1.0)
    forces = np.zeros((4, 3))
    forces[2] = PUSH.force_base_n
    expected = solve_equilibrium(MECHANISM, np.zeros(8), forces).tensions_n
    np.testing.assert_allclose(tensions(arm), expected, atol=1e-3)
    assert arm.loads == [PUSH]
    arm.push(Load(3, np.zeros(3)), 1.0)
    assert not arm.loads


def test_a_built_arm_reads_what_its_own_sensors_and_cables_say():
    """Without noise: the tensions of the built mechanism, by gains and zeros of its sensors."""
    arm = open_arm("cdsm_lab")
    built = built_arm(arm, 7)
    moving = moving_arm(arm, 1e-3, built)
    driven = SimulatedArm(moving, 1e-3, np.radians(20.0), 0.0, now_s=0.0)
    driven.push(PUSH, 0.0)
    run(driven, 0.0, 3.0)
    forces = np.zeros((4, 3))
    forces[2] = PUSH.force_base_n
    held_m = held_lengths_m(mechanism_of(arm), built.joint_zeros_rad)
    rest = solve_equilibrium(built.mechanism, np.zeros(8), forces, held_m=held_m)
    expected = (1.0 + built.sensor_gain) * rest.tensions_n + built.sensor_zero_n
    np.testing.assert_allclose(driven.reading_n(arm.sensors, None), expected, atol=0.02)


def test_a_load_lapses_after_its_time():
    arm = simulated(load_timeout_s=0.3)
    arm.push(PUSH, 0.0)
    run(arm, 0.0, 0.25)
    assert arm.loads
    run(arm, 0.25, 0.8)
    assert not arm.loads
    unloaded = solve_equilibrium(MECHANISM, np.zeros(8)).tensions_n
    np.testing.assert_allclose(tensions(arm), unloaded, atol=1e-3)


def test_a_command_is_reached_without_a_jerk():
    arm = simulated()
    command = np.radians([5.0, -3.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0])
    arm.go_to(command)
    highest = 0.0
    for now in np.arange(0.0, 1.2, 0.01):
        arm.advance_to(now)
        highest = max(highest, tensions(arm).max())
    np.testing.assert_allclose(
        tensions(arm), solve_equilibrium(MECHANISM, command).tensions_n, atol=1e-3
    )
    assert highest < 120.0  # pulled there at once, a cable would carry thousands


@pytest.mark.parametrize("effects", [[], [FRICTION]])
def test_offset_cables_are_longer_than_the_command_has_them(effects):
    arm = variant({"effects": effects})
    simulated_arm = SimulatedArm(moving_arm(arm, 1e-3), 1e-3, np.radians(20.0), 0.0, now_s=0.0)
    step_s = 0.1 if effects else 0.01  # with friction each step is one from rest to rest
    # as far as cables go when joint 2 bends, so that the arm moves and none goes slack
    bend = np.zeros(8)
    bend[2] = np.radians(0.2)
    offset = held_lengths_m(MECHANISM, bend)
    simulated_arm.offset(offset)
    run(simulated_arm, 0.0, 1.0, step_s)
    there = simulated_arm.reading_n(ARM.sensors, None)
    rest = solve_equilibrium(MECHANISM, np.zeros(8), held_m=offset)
    np.testing.assert_allclose(simulated_arm.joint_angles_rad, rest.joint_angles_rad, atol=5e-5)
    if not effects:
        np.testing.assert_allclose(there, rest.tensions_n, atol=1e-3)
    simulated_arm.offset(np.zeros(12))
    run(simulated_arm, 1.0, 2.0, step_s)
    back = solve_equilibrium(MECHANISM, np.zeros(8)).joint_angles_rad
    np.testing.assert_allclose(simulated_arm.joint_angles_rad, back, atol=5e-5)


def test_dynamics_that_diverge_restart_without_loads():
    dynamics = ArmDynamics(ARM)
    diverging = SimulatedArm(dynamics, 1e-3, 0.35, 0.0, now_s=0.0)
    dynamics.model.tendon_lengthspring[:] = np.nan
    diverging.push(PUSH, 0.0)
    sticking = SimulatedArm(moving_arm(variant({"effects": [FRICTION]}), 1e-3), 1e-3, 0.35, 0, 0)
    sticking.push(Load(4, np.array([0.0, 5e4, 0.0])), 0.0)
    for arm in (diverging, sticking):
        arm.advance_to(0.05)
        assert arm.resets == 1
        assert not arm.loads


@pytest.mark.parametrize("effects", [[], [FRICTION]])
def test_loads_anywhere_turn_the_arm_as_on_an_arm_that_is_touched_there(effects):
    """With friction too: its arm is compared with another one of other contact points."""
    forces_n = np.array([[8.0, 20.0, -5.0], [-6.0, 0.0, 25.0]])
    places_m = [0.03, 0.12]
    touched = {"effects": effects, "segments.contact_m": [0.065, places_m[0], 0.065, places_m[1]]}
    there, anywhere = (
        SimulatedArm(moving_arm(variant(given), 1e-3), 1e-3, np.radians(20.0), 0.0, now_s=0.0)
        for given in (touched, {"effects": effects})
    )
    for segment, force_n, place_m in zip((2, 4), forces_n, places_m, strict=True):
        there.push(Load(segment, force_n), 0.0)
        anywhere.push(Load(segment, force_n, place_m), 0.0)
    for arm in (there, anywhere):
        run(arm, 0.0, 0.5, 0.1 if effects else 0.01)
    np.testing.assert_allclose(tensions(anywhere), tensions(there), atol=1e-6)
    if not effects:
        loads = np.zeros((4, 3))
        loads[[1, 3]] = forces_n
        run(anywhere, 0.5, 1.0)
        mechanism = mechanism_of(variant(touched))
        expected = solve_equilibrium(mechanism, np.zeros(8), loads).tensions_n
        np.testing.assert_allclose(tensions(anywhere), expected, atol=1e-3)


@given(st.lists(st.floats(0.0, 10.0), max_size=50))
def test_the_pacer_keeps_pace_and_skips_beyond_the_longest_lag(waits):
    pacer = RealTimePacer(1e-3, 0.1, 0.0)
    now = 0.0
    steps = 0
    for wait in waits:
        now += wait
        due = pacer.steps_due(now)
        assert 0 <= due <= 100
        steps += due
    assert 1e-3 * steps + pacer.skipped_s == pytest.approx(now, abs=2e-3)
    assert pacer.real_time_factor(now) == pytest.approx(1e-3 * steps / now if now else 1.0)


PERIOD_S = 0.35
BENT = bent(3, most_deg=4.0)
ONE_OF_A_KIND = (
    *("actuator_backlash", "capstan_friction", "cable_creep", "joint_friction"),
    *("load_cell", "payload", "sensor_drift", "sensor_lag"),
)
"""Effects by what they act on, and all that depend on the past."""


def listed(name):
    """An effect of its typical size in the middle of its places."""
    effect = known_effects()[name]
    places = effect.places(4, 12)
    values = {p.name: p.typical for p in effect.parameters if p.role == "size"}
    if name == "sensor_lag":
        values["time_constant_s"] = 0.08  # settled at rest, as the replay does not swing
    return {"effect": name, "at": places[len(places) // 2], "parameters": values}


@pytest.mark.slow
@pytest.mark.parametrize("name", ONE_OF_A_KIND)
def test_at_rest_the_node_reads_what_the_replay_reads(name):
    """Bent, then pushed: times, set-points, loads and readings, now and then."""
    plain = variant({"segments.joint_damping_n_m_s": 3.0}, "cdsm_lab")
    arm = variant({"effects": [listed(name)], "segments.joint_damping_n_m_s": 3.0}, "cdsm_lab")
    moving = moving_arm(arm, 1e-3)
    effects = sensings([entries_of(arm)])
    simulated = SimulatedArm(
        moving, 1e-3, np.radians(20.0), 0.0, 0.0, sensings=effects, longest_lag_s=1.0
    )
    simulated.go_to(BENT)
    rows = []
    for time_s in PERIOD_S * np.arange(9):
        if len(rows) == 5:
            simulated.push(Load(2, np.array([0.0, 12.0, -6.0])), time_s)
        simulated.advance_to(time_s)
        reading = simulated.reading_n(arm.sensors, None)
        rows.append((time_s, moving.command_rad.copy(), moving.forces_n.copy(), reading))
    times, commands, loads, readings = map(np.array, zip(*rows, strict=True))
    if known_effects()[name].acts_on == "load":  # of recordings; simulated loads act as they are
        arm = plain
    expected = replay_arm(arm, Course(times, commands, loads))
    for at_rest in (4, -1):
        np.testing.assert_allclose(readings[at_rest], expected[at_rest], atol=1e-3)
