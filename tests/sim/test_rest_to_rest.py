"""An arm with memory in the sim node: the replay's readings, holding at rest, starting afresh."""

from __future__ import annotations

import numpy as np
import pytest
from arm_variants import variant
from effect_arms import bent, up_and_down

from cablesense_sim.dynamics import LEAST_PERIOD_S, ArmDynamics, RestToRestArm, moving_arm
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.loads import LoadError
from cablesense_sim.replay import replay_arm

KINDS = {
    "capstan_friction": {"coefficient": 0.15, "pulley_wrap_rad": 1.5},
    "joint_friction": {"torque_n_m": 0.15},
    "cable_creep": {"share": 0.3, "time_s": 5.0},
}
PLACES = {"joint_friction": "joint_2"}


def with_effects(*names: str):
    listed = [
        {"effect": name, "at": PLACES.get(name, "arm"), "parameters": KINDS[name]}
        for name in names
    ]
    return variant({"effects": listed}, "cdsm_lab")


@pytest.mark.parametrize("names", [*((name,) for name in KINDS), tuple(KINDS)], ids="+".join)
def test_it_goes_through_a_course_as_the_replay_does(names: tuple[str, ...]) -> None:
    arm = with_effects(*names)
    loads = up_and_down(rows=5)
    commands = np.linspace(0.0, 1.0, len(loads))[:, None] * bent(3, most_deg=6.0)
    times = 0.2 * np.arange(len(loads))
    moving = RestToRestArm(arm)
    found = []
    for row, time in enumerate(times):
        if row:
            moving.command(commands[row])
            moving.load(3, loads[row, 2])
            moving.advance(time - moving.time_s)
        found.append(moving.tensions_n)
    np.testing.assert_allclose(found, replay_arm(arm, times, commands, loads), atol=1e-3)


def test_friction_holds_at_rest_for_an_hour() -> None:
    moving = RestToRestArm(with_effects("capstan_friction", "joint_friction"))
    moving.command(bent(3, most_deg=6.0))
    for load in (10.0, 4.0):
        moving.load(3, [0.0, load, 0.0])
        moving.advance(0.2)
        first = moving.tensions_n
    for _ in range(50):
        moving.advance(72.0)
        np.testing.assert_array_equal(moving.tensions_n, first)


def test_it_comes_to_rest_when_looked_at_and_not_more_often_than_needed() -> None:
    moving = RestToRestArm(with_effects("joint_friction"))
    before = moving.tensions_n
    moving.load(2, [0.0, 10.0, 0.0])
    moving.advance(0.4 * LEAST_PERIOD_S)
    np.testing.assert_array_equal(moving.tensions_n, before)
    for _ in range(20):
        moving.advance(0.04 * LEAST_PERIOD_S)
    assert np.abs(moving.tensions_n - before).max() > 1.0


def test_reset_forgets_the_past() -> None:
    moving = RestToRestArm(with_effects(*KINDS))
    first = moving.tensions_n
    moving.command(bent(3, most_deg=6.0))
    moving.load(3, [0.0, 10.0, 0.0])
    moving.advance(1.0)
    assert np.abs(moving.tensions_n - first).max() > 1.0
    assert np.abs(moving.joint_angles_rad).max() > 0.05
    moving.reset()
    np.testing.assert_array_equal(moving.tensions_n, first)
    assert moving.time_s == 0.0
    assert not moving.forces_n.any()
    assert not moving.command_rad.any()


def test_without_a_rest_it_reads_nothing() -> None:
    moving = RestToRestArm(with_effects("joint_friction"))
    moving.load(4, [0.0, 5e4, 0.0])
    moving.advance(0.2)
    assert np.isnan(moving.tensions_n).all()


def test_what_cannot_be_is_refused_and_changes_nothing() -> None:
    moving = RestToRestArm(with_effects("joint_friction"))
    first = moving.tensions_n
    for command in (np.zeros(7), np.full(8, np.nan), np.full(8, 0.9)):
        with pytest.raises(EquilibriumError):
            moving.command(command)
        with pytest.raises(EquilibriumError):
            moving.reset(command)
    for segment, force in ((0, [0.0, 0.0, 1.0]), (1, [0.0, 1.0]), (1, [0.0, 1.0, np.nan])):
        with pytest.raises(LoadError):
            moving.load(segment, force)
    moving.advance(0.2)
    np.testing.assert_allclose(moving.tensions_n, first, atol=1e-4)


def test_one_place_decides_who_moves_in_time() -> None:
    assert isinstance(moving_arm(with_effects("cable_creep"), 1e-3), RestToRestArm)
    gain = {"effect": "sensor_gain", "at": "cable_1", "parameters": {"gain": 0.1}}
    assert isinstance(moving_arm(variant({"effects": [gain]}, "cdsm_lab"), 1e-3), ArmDynamics)
    with pytest.raises(EquilibriumError, match="depend on the past"):
        ArmDynamics(with_effects("cable_creep"))
