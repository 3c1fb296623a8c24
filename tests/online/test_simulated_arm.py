"""The simulated arm as the sim node drives it."""

import numpy as np
import pytest

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py.wrenches import Load
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium

ARM = open_arm("cdsm")
MECHANISM = mechanism_of(ARM)
PUSH = Load(3, np.array([0.0, 30.0, 0.0]))


def simulated(load_timeout_s=0.0):
    return SimulatedArm(ArmDynamics(ARM), 1e-3, np.radians(20.0), load_timeout_s, now_s=0.0)


def run(arm, start_s, end_s):
    for now in np.arange(start_s, end_s, 0.01):
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
    assert arm.loads_n == {3: pytest.approx(30.0)}
    arm.push(Load(3, np.zeros(3)), 1.0)
    assert arm.loads_n == {}


def test_a_load_lapses_after_its_time():
    arm = simulated(load_timeout_s=0.3)
    arm.push(PUSH, 0.0)
    run(arm, 0.0, 0.25)
    assert arm.loads_n
    run(arm, 0.25, 0.8)
    assert not arm.loads_n
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


def test_a_command_out_of_reach_is_refused_and_changes_nothing():
    arm = simulated()
    with pytest.raises(CableSenseError, match="plates touch"):
        arm.go_to(np.full(8, 1.04))
    run(arm, 0.0, 0.3)
    np.testing.assert_allclose(
        tensions(arm), solve_equilibrium(MECHANISM, np.zeros(8)).tensions_n, atol=1e-3
    )


def test_readings_have_the_sensors_step():
    reading = simulated().reading_n(ARM.sensors, np.random.default_rng(0))
    steps = reading / ARM.sensors.step_n
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_dynamics_that_lose_their_footing_start_afresh():
    dynamics = ArmDynamics(ARM)
    arm = SimulatedArm(dynamics, 1e-3, 0.35, 0.0, now_s=0.0)
    dynamics.model.tendon_lengthspring[:] = np.nan
    arm.push(PUSH, 0.0)
    arm.advance_to(0.01)
    assert arm.resets == 1
    assert not arm.loads_n
