"""What the plant's actuators make of commands."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cablesense_gap.plant.arm import ideal_actuation

IDEAL = ideal_actuation(3)
TIME_S = 0.2 * np.arange(40)


@given(arrays(float, (40, 3), elements=st.floats(-0.01, 0.01)))
def test_ideal_actuators_obey(wanted: np.ndarray) -> None:
    np.testing.assert_array_equal(IDEAL.paid_out_m(wanted, TIME_S), wanted)


@given(arrays(float, (40, 3), elements=st.floats(-0.01, 0.01)), st.floats(-1.0, 1.0))
def test_play_lags_by_half_at_most_and_moves_only_when_taken_up(
    wanted: np.ndarray, start: float
) -> None:
    play = np.array([0.0, 1e-3, 4e-3])
    loose = replace(IDEAL, play_m=play, play_start=np.full(3, start))
    given_m = loose.paid_out_m(wanted, TIME_S)
    assert (np.abs(given_m - wanted) <= 0.5 * play + 1e-12).all()
    moved = np.diff(given_m, axis=0) != 0.0
    at_end = np.abs(np.abs(given_m - wanted) - 0.5 * play)[1:] <= 1e-12
    assert (at_end | ~moved).all()


def test_a_reversal_loses_the_whole_play() -> None:
    loose = replace(IDEAL, play_m=np.full(3, 2e-3), play_start=np.full(3, -1.0))
    wanted = np.array([0.0, 5e-3, 4e-3, 3e-3, 2e-3])[:, None] * np.ones(3)
    given_m = loose.paid_out_m(wanted, TIME_S[:5])
    np.testing.assert_allclose(given_m[:, 0], [-1e-3, 4e-3, 4e-3, 4e-3, 3e-3])


def test_a_screw_error_repeats_every_turn_and_is_none_when_straight() -> None:
    screw = replace(
        IDEAL,
        screw_m=np.array([1e-5, 0.0, 2e-5]),
        screw_pitch_m=0.004,
        screw_phase_rad=np.array([0.3, 0.0, 1.0]),
    )
    wanted = np.array([0.0, 0.001, 0.005, 0.009])[:, None] * np.ones(3)
    error = screw.paid_out_m(wanted, TIME_S[:4]) - wanted
    assert not error[0].any()
    np.testing.assert_allclose(error[1], error[2], atol=1e-15)
    np.testing.assert_allclose(error[2], error[3], atol=1e-15)
    assert error[1, 0] != 0.0


def test_a_clamp_slips_once() -> None:
    slipping = replace(IDEAL, slip_m=np.array([0.0, 1e-4, 0.0]), slip_time_s=1.0)
    error = slipping.paid_out_m(np.zeros((40, 3)), TIME_S)
    assert not error[TIME_S < 1.0].any()
    np.testing.assert_array_equal(error[TIME_S >= 1.0, 1], 1e-4)
