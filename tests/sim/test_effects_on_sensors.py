"""Effects between an actuator's tension and its reading, and on the lengths that it holds."""

import numpy as np
import pytest
from effect_arms import MECHANISM, STRAIGHT, bent, course, entry, push, readings
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_sim.effects.registry import EffectEntry, side_by_side
from cablesense_sim.effects.sensor import INTERVAL_S
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium

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


def test_a_gain_scales_its_own_sensor() -> None:
    tensions, times = some_tensions()
    read = sensed([entry("sensor_gain", "cable_3", gain=g) for g in (0.04, -0.1)], tensions, times)
    np.testing.assert_allclose(read[0], tensions * (1.0 + 0.04 * THIRD))
    np.testing.assert_allclose(read[1], tensions * (1.0 - 0.1 * THIRD))


def test_an_offset_is_added_to_its_own_sensor() -> None:
    tensions, times = some_tensions()
    read = sensed([entry("sensor_offset", "cable_3", offset_n=-2.5)], tensions, times)[0]
    np.testing.assert_allclose(read, tensions - 2.5 * THIRD)


def test_crosstalk_goes_one_way() -> None:
    tensions, times = some_tensions()
    leak = entry("sensor_crosstalk", "cable_7_into_cable_3", share=0.05)
    read = sensed([leak], tensions, times)[0]
    np.testing.assert_allclose(read, tensions + 0.05 * tensions[:, 6:7] * THIRD)
    assert len(leak.effect.places(4, 12)) == 1 + 12 * 11


def test_crosstalk_of_the_whole_arm_is_between_neighbours() -> None:
    times = np.array([0.0])
    tensions = np.zeros((1, 1, 12))
    tensions[..., 6] = 40.0
    read = sensed([entry("sensor_crosstalk", "arm", share=0.05)], tensions[0], times)[0]
    np.testing.assert_allclose(read[0, [5, 6, 7]], [2.0, 40.0, 2.0])
    np.testing.assert_allclose(np.delete(read[0], [5, 6, 7]), 0.0)


def test_a_drift_rises_evenly_within_each_interval_and_then_stands() -> None:
    rises = {f"rise_{k + 1}_n": r for k, r in enumerate([1.0, -2.0, 0.0, 0.5])}
    times = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 90.0, 105.0, 120.0, 5000.0])
    expected = np.array([0.0, 0.5, 1.0, 0.0, -1.0, -1.0, -0.75, -0.5, -0.5])
    read = sensed([entry("sensor_drift", "cable_3", **rises)], np.zeros((9, 12)), times)[0]
    assert INTERVAL_S == 30.0
    np.testing.assert_allclose(read, expected[:, None] * THIRD, atol=1e-12)


SPAN_S = 0.2 * np.arange(50)
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


@given(st.floats(0.01, 20.0), st.floats(0.0, 1.0), st.integers(2, 30), st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_a_lag_does_not_care_how_often_it_is_asked(
    tau: float, share: float, parts: int, seed: int
) -> None:
    """While the tension holds, many short steps and one long one are the same."""
    rng = np.random.default_rng(seed)
    moments = np.concatenate([[0.0], np.sort(rng.uniform(0.0, 5.0, parts)), [5.0]])
    tensions = np.full((len(moments), 12), 7.0)
    tensions[0] = 3.0
    late = [entry("sensor_lag", time_constant_s=tau, second_share=share)]
    often = sensed(late, tensions, moments)[0, -1]
    once = sensed(late, tensions[[0, -1]], moments[[0, -1]])[0, -1]
    np.testing.assert_allclose(often, once, rtol=1e-9)


@pytest.mark.parametrize(
    "nothing",
    [
        entry("sensor_gain", "cable_3"),
        entry("sensor_offset", "cable_3"),
        entry("sensor_drift", "cable_3"),
        entry("sensor_lag"),
        entry("sensor_crosstalk", "cable_7_into_cable_3"),
        entry("cable_tolerance", "cable_3"),
    ],
    ids=lambda e: e.effect.name,
)
def test_size_zero_reads_the_truth(nothing: EffectEntry) -> None:
    tensions, times = some_tensions()
    np.testing.assert_allclose(sensed([nothing], tensions, times)[0], tensions, atol=1e-12)


def held(entries: list[EffectEntry], commanded_m: np.ndarray) -> np.ndarray:
    """Lengths (P, R) that cable 3 of P arms really has under commands (R,) for it."""
    actuation = entries[0].effect.actuation(entries[0].place, side_by_side(entries))
    assert actuation is not None
    found = []
    for row, length in enumerate(commanded_m):
        every = np.where(THIRD, length, 0.5)[None].repeat(len(entries), axis=0)
        after = actuation.step(0.2 * row, every)
        np.testing.assert_array_equal(after[:, ~THIRD], every[:, ~THIRD])
        found.append(after[:, 2])
    return np.stack(found, axis=1)


def play(start: float = 0.0, play_m: float = 1e-3) -> EffectEntry:
    return entry("actuator_backlash", "cable_3", play_m=play_m, start=start)


def test_a_play_makes_a_loop_as_wide_as_itself() -> None:
    to_and_fro = 0.01 * np.sin(np.linspace(0.0, 6 * np.pi, 400))
    found = held([play(), play(play_m=2e-3), play(play_m=0.0)], to_and_fro)
    rising = np.gradient(to_and_fro) > 0.0
    later = np.arange(400) > 140
    for p, width in enumerate((1e-3, 2e-3)):
        behind = found[p] - to_and_fro
        assert np.abs(behind).max() <= 0.5 * width + 1e-15
        # well after a reversal it lags by half the play, on either side
        fast = later & (np.abs(np.gradient(to_and_fro)) > 3e-4)
        np.testing.assert_allclose(behind[fast & rising], -0.5 * width, atol=1e-15)
        np.testing.assert_allclose(behind[fast & ~rising], 0.5 * width, atol=1e-15)
    np.testing.assert_array_equal(found[2], to_and_fro)


def test_within_the_play_nothing_moves_whatever_the_start() -> None:
    within = np.array([0.0, 3e-4, -2e-4, 4e-4, 0.0])
    found = held([play(start) for start in (-1.0, 0.0, 1.0)], within)
    np.testing.assert_allclose(found[1], 0.0, atol=1e-15)
    assert found[0, 0] == pytest.approx(-5e-4)
    assert found[2, 0] == pytest.approx(5e-4)
    # only what goes beyond a flank pushes on
    np.testing.assert_allclose(found[0, 1:], [-2e-4, -2e-4, -1e-4, -1e-4], atol=1e-15)
    np.testing.assert_allclose(found[2, 1:], [5e-4, 3e-4, 3e-4, 3e-4], atol=1e-15)


def test_in_a_replay_a_play_changes_what_its_cable_is_held_at() -> None:
    there = bent(2)
    replay = course(np.array([STRAIGHT, there, STRAIGHT]), push(2, [0.0, 5.0, 0.0]))
    found = readings(replay, play(play_m=2e-4))
    lengths = held_lengths_m(MECHANISM, replay.command_rad)
    sign = np.sign(lengths[1, 2])
    lengths[:, 2] += [0.0, -sign * 1e-4, sign * 1e-4]  # half the play behind, either way
    rest = solve_equilibrium(MECHANISM, replay.command_rad, replay.forces_n, held_m=lengths)
    np.testing.assert_allclose(found, rest.tensions_n, atol=1e-6)
