"""Effects on the arm, its actuators and sensors: closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_sim import kinematics
from cablesense_sim.effects.registry import EffectEntry, amended, side_by_side
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from tests.helpers.effect_arms import ARM, MECHANISM, STRAIGHT, bent, course, entry, push, readings
from tests.helpers.joint_torques import load_torques_n_m

POSES = np.concatenate([STRAIGHT[None], bent(1, count=4)])
PUSH = push(3, [0.0, 15.0, 10.0])


def rest_of(*entries: EffectEntry, forces: np.ndarray = PUSH):
    """The amended arm, its pose and tensions, while its actuators hold the nominal lengths."""
    mechanism = amended(MECHANISM, entries)
    held = held_lengths_m(MECHANISM, POSES)
    return mechanism, solve_equilibrium(mechanism, POSES, forces, held_m=held)


def unbalanced_n_m(mechanism: Mechanism, rest, forces: np.ndarray) -> np.ndarray:
    """J'T less the torques of weight and loads (B, 8), with the geometry of `mechanism`."""
    jacobian = kinematics.cable_jacobian_m(mechanism, rest.joint_angles_rad)
    forces = np.broadcast_to(forces, (len(POSES), 4, 3))
    torque = load_torques_n_m(mechanism, rest.joint_angles_rad, forces)
    return np.einsum("bmj,bm->bj", jacobian, rest.tensions_n) - torque


def test_a_payload_is_its_weight_at_its_place() -> None:
    """J'T of the loaded arm balances the nominal weight and a point weight at that place."""
    mass = 0.7
    beyond = 0.15
    _, rest = rest_of(entry("payload", "segment_3", mass_kg=mass, beyond_middle=beyond))
    missing = unbalanced_n_m(MECHANISM, rest, PUSH)
    pose = kinematics.chain(MECHANISM, rest.joint_angles_rad)
    position_m = pose.joint_m[:, 2] + 0.13 * (0.5 + beyond) * pose.rotation[:, 2, :, 0]
    weight = np.array([0.0, 0.0, -9.81 * mass])
    for joint in range(8):
        lever = position_m - pose.joint_m[:, joint // 2]
        moment = np.einsum("bi,bi->b", pose.joint_axis[:, joint], np.cross(lever, weight))
        np.testing.assert_allclose(missing[:, joint], moment if joint < 6 else 0.0, atol=1e-6)


def test_a_load_elsewhere_is_a_load_with_another_lever() -> None:
    """Equal forces at two points of a segment differ by a couple, the same all the way down."""
    mechanism, rest = rest_of(entry("contact_offset", "segment_3", offset_m=0.02))
    np.testing.assert_allclose(mechanism.contact_m - 0.065, [0.0, 0.0, 0.02, 0.0])
    pose = kinematics.chain(MECHANISM, rest.joint_angles_rad)
    couple = np.cross(0.02 * pose.rotation[:, 2, :, 0], PUSH[2])
    missing = unbalanced_n_m(MECHANISM, rest, PUSH)
    for joint in range(8):
        moment = np.einsum("bi,bi->b", pose.joint_axis[:, joint], couple)
        np.testing.assert_allclose(missing[:, joint], moment if joint < 6 else 0.0, atol=1e-6)


def test_tolerances_are_numbers_of_one_cable_hole_or_sensor() -> None:
    is_the_cable = np.arange(12) == 6
    cable = entry("cable_tolerance", "cable_7", pretension_n=0.5, log_stiffness=0.1)
    mechanism = amended(MECHANISM, [cable])
    np.testing.assert_allclose(mechanism.pretension_n - 50.0, 0.5 * is_the_cable)
    stiffer = mechanism.stiffness_n_m / MECHANISM.stiffness_n_m
    np.testing.assert_allclose(stiffer, np.exp(0.1 * is_the_cable))
    hole = entry("hole_tolerance", "cable_7_plate_2", outward_m=3e-4, around_m=4e-4)
    moved = amended(MECHANISM, [hole])
    np.testing.assert_array_equal(moved.hole_y_m, MECHANISM.hole_y_m)
    by_m = np.hypot(
        moved.segment_hole_y_m - MECHANISM.segment_hole_y_m,
        moved.segment_hole_z_m - MECHANISM.segment_hole_z_m,
    )
    np.testing.assert_allclose(by_m, np.outer(5e-4 * is_the_cable, [0, 1, 0, 0]), atol=1e-15)
    radius_m = np.hypot(moved.segment_hole_y_m, moved.segment_hole_z_m)[6, 1]
    assert radius_m == pytest.approx(np.hypot(0.05 + 3e-4, 4e-4))
    base = amended(MECHANISM, [entry("hole_tolerance", "cable_7_plate_0", outward_m=3e-4)])
    np.testing.assert_array_equal(base.segment_hole_y_m, MECHANISM.segment_hole_y_m)
    assert np.hypot(base.hole_y_m, base.hole_z_m)[6] == pytest.approx(0.0503)
    replay = course(POSES, PUSH)
    sensor = entry("sensor_tolerance", "cable_7", zero_n=0.2, gain=0.01)
    expected = readings(replay) * (1.0 + 0.01 * is_the_cable) + 0.2 * is_the_cable
    np.testing.assert_allclose(readings(replay, sensor), expected, atol=1e-9)


def test_with_wrong_joint_zeros_the_actuators_hold_the_lengths_of_other_angles() -> None:
    replay = course(POSES, PUSH)
    read_n = readings(
        replay,
        entry("joint_tolerance", "joint_1", pitch_rad=0.01),
        entry("joint_tolerance", "joint_3", yaw_rad=-0.02),
    )
    zeros_rad = np.array([0.01, 0, 0, 0, 0, -0.02, 0, 0])
    told = solve_equilibrium(MECHANISM, POSES + zeros_rad, PUSH)
    np.testing.assert_allclose(read_n, told.tensions_n, atol=1e-6)


def test_the_actuators_hold_the_lengths_of_the_arm_as_it_was_drawn() -> None:
    """A turned hole circle shows at bent poses, where a controller that knew would not."""
    turned = entry("routing_geometry", "segment_3", cables_angle_rad=0.1)
    mechanism = amended(MECHANISM, [turned])
    told = solve_equilibrium(mechanism, POSES, PUSH).tensions_n
    replay = course(POSES, PUSH)
    held = readings(replay, turned)
    np.testing.assert_allclose(held[0], told[0], atol=1e-6)  # straight is straight
    assert np.abs(held[1:] - told[1:]).max() > 1.0
    assert ARM.segment_count == 4


THIRD = np.arange(12) == 2


def sensed(entries: list[EffectEntry], tensions_n: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Readings (P, R, M) of tensions (R, M) by P sensors side by side, one by one and at once."""
    sensing, again = (
        entries[0].effect.sensing(entries[0].place, side_by_side(entries)) for _ in range(2)
    )
    assert sensing is not None
    assert again is not None
    rows = [np.broadcast_to(row, (len(entries), 12)).copy() for row in tensions_n]
    read = np.stack(
        [sensing.step(float(t), row) for t, row in zip(times_s, rows, strict=True)], axis=1
    )
    np.testing.assert_allclose(again.along(times_s, np.stack(rows, axis=1)), read)
    return read


def some_tensions(rows: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.uniform(0.0, 120.0, (rows, 12)), np.cumsum(rng.uniform(0.05, 2.0, rows))


def test_gain_offset_and_crosstalk_act_on_their_own_sensor() -> None:
    tensions, times = some_tensions()
    gains = [entry("sensor_gain", "cable_3", gain=g) for g in (0.04, -0.1)]
    for read, gain in zip(sensed(gains, tensions, times), (0.04, -0.1), strict=True):
        np.testing.assert_allclose(read, tensions * (1.0 + gain * THIRD))
    off = entry("sensor_offset", "cable_3", offset_n=-2.5)
    np.testing.assert_allclose(sensed([off], tensions, times)[0], tensions - 2.5 * THIRD)
    leak = entry("sensor_crosstalk", "cable_7_into_cable_3", share=0.05)
    read = sensed([leak], tensions, times)[0]
    np.testing.assert_allclose(read, tensions + 0.05 * tensions[:, 6:7] * THIRD)


def test_a_drift_rises_evenly_within_each_interval_and_then_stands() -> None:
    rises = {f"rise_{k + 1}_n": r for k, r in enumerate([1.0, -2.0, 0.0, 0.5])}
    times = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 90.0, 105.0, 120.0, 5000.0])
    expected = np.array([0.0, 0.5, 1.0, 0.0, -1.0, -1.0, -0.75, -0.5, -0.5])
    read = sensed([entry("sensor_drift", "cable_3", **rises)], np.zeros((9, 12)), times)[0]
    np.testing.assert_allclose(read, expected[:, None] * THIRD, atol=1e-12)


SPAN_S = np.append(0.0, 1e-6 + 0.2 * np.arange(50))
STEP_N = np.where(SPAN_S > 0.0, 10.0, 0.0)[:, None] * np.ones(12)


def share_through(tau: float, share: float) -> np.ndarray:
    """Of a step, after each moment, by two lags in a row in closed form."""
    gone = np.exp(-SPAN_S / tau)
    if share == 0.0:
        return 1.0 - gone
    if share == 1.0:
        return 1.0 - (1.0 + SPAN_S / tau) * gone
    return 1.0 - (gone - share * np.exp(-SPAN_S / (share * tau))) / (1.0 - share)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_a_lag_follows_a_step_as_one_lag_or_two_in_a_row(share: float) -> None:
    taus = 0.5, 2.0
    late = [entry("sensor_lag", "cable_3", time_constant_s=t, second_share=share) for t in taus]
    read = sensed(late, STEP_N, SPAN_S)
    for p, tau in enumerate(taus):
        np.testing.assert_allclose(read[p, :, 2], 10.0 * share_through(tau, share), atol=1e-3)
        np.testing.assert_array_equal(read[p][:, ~THIRD], STEP_N[:, ~THIRD])


@given(st.integers(0, 9999), st.floats(0.0, 20.0), st.floats(0.0, 1.0))
def test_rows_on_a_straight_line_add_nothing_to_a_lag(seed: int, tau: float, share: float) -> None:
    rng = np.random.default_rng(seed)
    at_s = np.cumsum(rng.uniform(0.05, 5.0, 6))
    tension_n = rng.uniform(-50.0, 50.0, 6)
    every_s = np.union1d(at_s, np.linspace(at_s[0], at_s[-1], 40))
    every_n = np.interp(every_s, at_s, tension_n)[:, None] * np.ones(12)
    kept = np.isin(every_s, at_s)
    late = [entry("sensor_lag", "arm", time_constant_s=tau, second_share=share)]
    few = sensed(late, every_n[kept], at_s)
    np.testing.assert_allclose(sensed(late, every_n, every_s)[:, kept], few, atol=1e-4)


@pytest.mark.parametrize("tau", [0.1, 0.3, 1.0, 2.0, 5.0, 10.0])
def test_the_lags_that_a_search_begins_with_are_much_alike_any_other(tau: float) -> None:
    """The change by one of them, scaled, is three quarters of that by a lag under slow loads."""
    at_s = np.arange(0.0, 60.0, 0.05)
    rising_3_s = np.interp(at_s % 20.0, [0.0, 3.0, 7.0, 10.0, 20.0], [0.0, 1.0, 1.0, 0.0, 0.0])
    tension_n = 20.0 * rising_3_s[:, None] * np.ones(12)

    def changed_by(tau: float) -> np.ndarray:
        late = [entry("sensor_lag", "cable_3", time_constant_s=tau)]
        return np.asarray(sensed(late, tension_n, at_s)[0, :, 2] - tension_n[:, 2])

    time_constant = entry("sensor_lag", "cable_3").effect.parameters[0]
    true = changed_by(tau)
    alike = []
    for start in time_constant.starts:
        change = changed_by(start)
        scale = (change @ true) / (change @ change)
        residual_n = true - scale * change
        alike.append(1.0 - (residual_n @ residual_n) / (true @ true))
    assert max(alike) >= 0.75


def held_by(entries: list[EffectEntry], commanded_m: np.ndarray) -> np.ndarray:
    """Lengths (P, R) that cable 3 of P arms really has under commands (R,) for it."""
    actuation = entries[0].effect.actuation(entries[0].place, side_by_side(entries))
    assert actuation is not None
    held_m = []
    for row, length in enumerate(commanded_m):
        every = np.where(THIRD, length, 0.5)[None].repeat(len(entries), axis=0)
        after = actuation.step(0.2 * row, every)
        np.testing.assert_array_equal(after[:, ~THIRD], every[:, ~THIRD])
        held_m.append(after[:, 2])
    return np.stack(held_m, axis=1)


def play(start: float = 0.0, play_m: float = 1e-3) -> EffectEntry:
    return entry("actuator_backlash", "cable_3", play_m=play_m, start=start)


def test_a_play_makes_a_loop_as_wide_as_itself() -> None:
    to_and_fro = 0.01 * np.sin(np.linspace(0.0, 6 * np.pi, 400))
    held = held_by([play(), play(play_m=2e-3), play(play_m=0.0)], to_and_fro)
    rising = np.gradient(to_and_fro) > 0.0
    later = np.arange(400) > 140
    for p, width in enumerate((1e-3, 2e-3)):
        behind = held[p] - to_and_fro
        assert np.abs(behind).max() <= 0.5 * width + 1e-15
        # well after a reversal it lags by half the play, on either side
        fast = later & (np.abs(np.gradient(to_and_fro)) > 3e-4)
        np.testing.assert_allclose(behind[fast & rising], -0.5 * width, atol=1e-15)
        np.testing.assert_allclose(behind[fast & ~rising], 0.5 * width, atol=1e-15)
    np.testing.assert_array_equal(held[2], to_and_fro)


def test_in_a_replay_a_play_changes_what_its_cable_is_held_at() -> None:
    there = bent(2)
    replay = course(np.array([STRAIGHT, there, STRAIGHT]), push(2, [0.0, 5.0, 0.0]))
    read_n = readings(replay, play(play_m=2e-4))
    lengths = held_lengths_m(MECHANISM, replay.course.command_rad)
    sign = np.sign(lengths[1, 2])
    lengths[:, 2] += [0.0, -sign * 1e-4, sign * 1e-4]  # half the play behind, either way
    rest = solve_equilibrium(
        MECHANISM, replay.course.command_rad, replay.course.forces_n, held_m=lengths
    )
    np.testing.assert_allclose(read_n, rest.tensions_n, atol=1e-6)
