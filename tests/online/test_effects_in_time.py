"""Every effect in the sim node's arm: at rest it reads what the replay reads."""

from __future__ import annotations

import numpy as np
import pytest
from arm_variants import variant
from effect_arms import bent

from cablesense_msgs_py.wrenches import Load
from cablesense_online.simulated_arm import SimulatedArm
from cablesense_sim.build import entries_of
from cablesense_sim.dynamics import moving_arm
from cablesense_sim.effects.registry import known_effects, sensings
from cablesense_sim.replay import replay_arm

PERIOD_S = 0.1
PUSH = np.array([0.0, 12.0, -6.0])
BENT = bent(3, most_deg=4.0)


def listed(name: str) -> dict[str, object]:
    """An effect of its typical size in the middle of its places."""
    effect = known_effects()[name]
    places = effect.places(4, 12)
    values = {p.name: p.typical for p in effect.parameters if p.role == "size"}
    if name == "sensor_lag":
        values["time_constant_s"] = 0.08  # settled at rest, as the replay does not swing
    return {"effect": name, "at": places[len(places) // 2], "parameters": values}


def put_through(arm) -> tuple[list[np.ndarray], ...]:
    """Bent, then pushed: times, set-points, loads and readings, each tenth of a second."""
    moving = moving_arm(arm, 1e-3)
    simulated = SimulatedArm(
        moving, 1e-3, np.radians(20.0), 0.0, 0.0,
        sensings=sensings([entries_of(arm)]), longest_lag_s=1.0,
    )  # fmt: skip
    course: tuple[list[np.ndarray], ...] = ([], [], [], [])
    simulated.go_to(BENT)
    for row in range(26):
        if row == 15:
            simulated.push(Load(2, PUSH), PERIOD_S * row)
        simulated.advance_to(PERIOD_S * row)
        reading = simulated.reading_n(arm.sensors, None)
        for kept, value in zip(
            course, (PERIOD_S * row, moving.command_rad, moving.forces_n, reading), strict=True
        ):
            kept.append(np.array(value))
    return course


@pytest.mark.parametrize("name", list(known_effects()))
def test_at_rest_the_node_reads_what_the_replay_reads(name: str) -> None:
    arm = variant({"effects": [listed(name)], "segments.joint_damping_n_m_s": 3.0}, "cdsm_lab")
    times, commands, loads, readings = (np.array(part) for part in put_through(arm))
    expected = replay_arm(arm, times, commands, loads)
    for at_rest in (14, -1):
        np.testing.assert_allclose(readings[at_rest], expected[at_rest], atol=1e-3)


def test_a_refused_command_does_not_move_a_play() -> None:
    play = {"effect": "actuator_backlash", "at": "cable_3", "parameters": {"play_m": 5e-4}}
    arm = variant({"effects": [play]}, "cdsm_lab")
    moving = moving_arm(arm, 1e-3)
    simulated = SimulatedArm(moving, 1e-3, np.radians(20.0), 0.0, 0.0)
    with pytest.raises(Exception, match="plates touch"):
        simulated.go_to(np.full(8, 1.04))
    before = moving.tensions_n
    simulated.go_to(BENT)  # taken on, not yet gone
    simulated.advance_to(1e-4)
    np.testing.assert_allclose(moving.tensions_n, before, atol=1e-6)


def test_a_slow_sensor_does_not_slow_time() -> None:
    arm = variant({}, "cdsm_lab")
    simulated = SimulatedArm(
        moving_arm(arm, 1e-3), 1e-3, np.radians(20.0), 0.0, 0.0, longest_lag_s=0.4
    )
    for row in range(1, 11):
        simulated.advance_to(0.2 * row)
    assert simulated.real_time_factor(2.0) == pytest.approx(1.0)
    assert simulated.skipped_s == 0.0


def test_an_arm_with_a_memory_that_finds_no_rest_starts_afresh() -> None:
    arm = variant({"effects": [listed("joint_friction")]}, "cdsm_lab")
    simulated = SimulatedArm(moving_arm(arm, 1e-3), 1e-3, np.radians(20.0), 0.0, 0.0)
    first = simulated.reading_n(arm.sensors, None)
    simulated.push(Load(4, np.array([0.0, 5e4, 0.0])), 0.0)
    simulated.advance_to(0.05)
    assert simulated.resets == 1
    assert not simulated.loads_n
    np.testing.assert_allclose(simulated.reading_n(arm.sensors, None), first, atol=1e-3)
