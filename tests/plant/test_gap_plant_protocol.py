"""What is done to a plant while it is recorded."""

import numpy as np
import pytest
from gap_plant import NOMINAL

from cablesense_gap.plant.protocol import draw_history, draw_schedule


@pytest.mark.parametrize("seed", range(5))
def test_a_recording_has_its_25_trials(seed: int) -> None:
    schedule = draw_schedule(NOMINAL, np.random.default_rng(seed))
    rows = np.bincount(schedule.trial)
    assert rows.tolist() == [20, *[33] * 12, 440, 25, *[33] * 4, 205, 20, *[33] * 4]
    np.testing.assert_allclose(schedule.time_s, 0.2 * np.arange(1370))
    assert np.abs(schedule.command_rad).max() < np.deg2rad(10.0)
    loads = np.linalg.norm(schedule.load_n, axis=1)
    assert loads.max() < 75.0
    np.testing.assert_array_equal(loads > 0.0, schedule.load_segment > 0)
    assert set(schedule.load_segment) == {0, 1, 2, 3, 4}
    straight = (schedule.trial >= 1) & (schedule.trial <= 12)
    assert not schedule.command_rad[straight].any()
    assert not schedule.load_n[:, 0].any()
    for trial in range(25):  # every trial but the sweeps begins and ends where the last ended
        own = schedule.load_segment[schedule.trial == trial]
        assert len(set(own) - {0}) <= 1
        assert own[-1] == 0


def test_loads_act_on_one_segment() -> None:
    schedule = draw_schedule(NOMINAL, np.random.default_rng(0))
    np.testing.assert_allclose(schedule.forces_n.sum(axis=1), schedule.load_n)
    assert ((schedule.forces_n != 0.0).any(axis=2).sum(axis=1) <= 1).all()


def test_the_history_ends_at_rest_just_before_the_first_row() -> None:
    history = draw_history(NOMINAL, np.random.default_rng(0))
    assert history.time_s[-1] == pytest.approx(-0.2)
    assert not history.command_rad[-2:].any()
    assert not history.load_n[-2:].any()
    assert np.abs(history.command_rad).max() > 0.01
