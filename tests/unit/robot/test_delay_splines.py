"""Torques of an earlier time are those of SciPy's splines through each trial."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cablesense_gap.robot.inverse import _Splines


@pytest.mark.parametrize("rows", [(4,), (4, 5, 7), (200, 50, 4)])
@pytest.mark.parametrize("delay_s", [0.0, 0.004, -0.01, 0.2, 50.0])
def test_every_trial_has_a_spline_of_its_own(rows, delay_s):
    rng = np.random.default_rng(0)
    times = [rng.uniform(-5.0, 5.0) + np.cumsum(rng.uniform(0.005, 0.03, n)) for n in rows]
    values = [rng.normal(size=(n, 3)) for n in rows]
    splines = _Splines(np.concatenate(times), np.repeat(3 * np.arange(len(rows)), rows))
    earlier = splines.earlier(np.concatenate(values), delay_s)
    expected = [
        CubicSpline(time_s, of_trial)(np.clip(time_s - delay_s, time_s[0], time_s[-1]))
        for time_s, of_trial in zip(times, values, strict=True)
    ]
    assert earlier == pytest.approx(np.concatenate(expected), abs=1e-10)
