"""Statistics of readings; good sensors pass, and every fault is a finding at its cable."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.sensor_check import (
    SETTLING_S,
    CommissioningError,
    Pull,
    channel_statistics,
    judge_pull,
    quantisation_step_n,
    rows_at_rest,
    timing_statistics,
)
from tests.helpers.gap_recordings import small_recording
from tests.helpers.sensor_series import (
    ARM,
    EXPECTED,
    RATE_HZ,
    STEP_N,
    checked,
    good_tensions_n,
    series,
)


def wrong(report):
    return {(finding.kind, finding.where) for finding in report.findings if finding.wrong}


def noisy(tensions_n):
    tensions_n[:, 4] += np.random.default_rng(0).normal(0.0, 1.0, len(tensions_n))


def drifting(tensions_n):
    tensions_n[:, 4] += np.linspace(0.0, 3.0, len(tensions_n))


def coarse(tensions_n):
    row = np.arange(len(tensions_n))
    tensions_n[:, 4] = 4.0 * STEP_N * np.round(20.0 * np.sin(row / 40.0))


@pytest.mark.parametrize(
    ("spoil", "kind"), [(noisy, "noise"), (drifting, "drift"), (coarse, "step")]
)
def test_a_fault_is_found_at_its_cable(spoil, kind):
    tensions_n = good_tensions_n()
    spoil(tensions_n)
    faults = wrong(checked(series(tensions_n)))
    assert (kind, "cable_5") in faults
    assert {where for _, where in faults} == {"cable_5"}


def test_a_channel_that_stands_still_is_wrong_only_while_others_move():
    tensions_n = good_tensions_n()
    tensions_n[:, 4] = 50.0
    resting = checked(series(tensions_n))
    assert resting.usable
    assert [(finding.kind, finding.where) for finding in resting.findings] == [
        ("stuck", "cable_5")
    ]
    moving = np.arange(len(tensions_n)) > 500
    tensions_n[moving] += 30.0
    tensions_n[:, 4] = 50.0
    report = checked(series(tensions_n, at_rest=~moving))
    assert wrong(report) == {("stuck", "cable_5")}


def test_rate_jitter_and_loss_are_of_all():
    tensions_n = good_tensions_n()
    time_s = np.arange(len(tensions_n)) / RATE_HZ
    slow = checked(series(tensions_n, 1.2 * time_s))
    assert wrong(slow) == {("rate", "all")}
    lossy = np.delete(time_s, slice(300, 310))
    lost = checked(series(tensions_n[:-10], lossy))
    assert wrong(lost) == {("lost", "all")}
    shaken_s = time_s + 0.45 / RATE_HZ * np.random.default_rng(0).choice([-1, 1], len(time_s))
    assert ("jitter", "all") in wrong(checked(series(tensions_n, shaken_s)))


def test_pulls_show_a_swap_and_are_no_rest():
    tensions_n = good_tensions_n()
    tensions_n[400:600, 6] += 25.0
    right = checked(series(tensions_n), [Pull("cable_7", 3.5, 6.5)])
    assert right.usable, right.findings
    other = [Pull("cable_2", 3.5, 6.5)]
    swapped = checked(series(tensions_n), other)
    assert wrong(swapped) == {("swapped", "cable_2")}
    assert "cable_7 moved most (25" in swapped.findings[0].text
    weak = checked(series(good_tensions_n()), other)
    assert weak.usable
    assert weak.findings[0].kind == "pull"


TIME_S = np.arange(2000) / 100.0
REST = np.ones(2000, dtype=bool)


def figures_of(readings_n, at_rest=REST):
    made = series(np.repeat(readings_n[:, None], 12, axis=1), TIME_S)
    return channel_statistics(made, ARM.cable_names, at_rest, 100.0)[3]


def noise_n(deviation_n, seed=0):
    return np.random.default_rng(seed).normal(0.0, deviation_n, 2000)


def test_noise_is_estimated_beside_drift():
    figures = figures_of(50.0 + 0.1 * TIME_S + noise_n(0.2))
    assert figures.noise_n == pytest.approx(0.2, rel=0.05)
    assert figures.drift_n == pytest.approx(2.0, rel=0.05)
    assert figures.mean_n == pytest.approx(51.0, abs=0.05)


@given(st.floats(1e-4, 1.0), st.floats(-100.0, 100.0), st.floats(1.0, 50.0))
def test_the_step_of_quantised_readings_is_found(step_n, start_n, spread_steps):
    true_n = np.random.default_rng(0).normal(0.0, spread_steps * step_n, 2000)
    read_n = start_n + step_n * np.round(true_n / step_n)
    assert quantisation_step_n(read_n) == pytest.approx(step_n, rel=1e-3)


def at(time_s):
    return series(np.zeros((len(time_s), 12)), np.asarray(time_s))


@settings(max_examples=30)
@given(st.floats(1.0, 2000.0), st.sets(st.integers(1, 98), max_size=20))
def test_missing_samples_are_counted_and_do_not_lower_the_rate(rate_hz, missing):
    time_s = np.delete(np.arange(100) / rate_hz, sorted(missing))
    figures = timing_statistics(at(time_s))
    assert figures.rate_hz == pytest.approx(rate_hz, rel=1e-6)
    assert figures.lost == len(missing)
    assert figures.jitter_s < 1e-6 / rate_hz


def test_rest_is_the_usual_pose_without_a_load_once_settled():
    recording = small_recording()
    rows = rows_at_rest(recording)
    assert rows[:20].all()
    assert not rows[recording.load_segment > 0].any()
    assert not rows[recording.command_rad.any(axis=1)].any()
    unloading = np.flatnonzero(np.diff((recording.load_segment > 0).astype(int)) == -1)[0] + 1
    settled = recording.time_s > recording.time_s[unloading] + SETTLING_S
    assert not rows[unloading]
    assert rows[settled].any()


WINDOW = (4.0, 7.0)


def judged(moves_n, dead=None, window=WINDOW):
    """What a pull of cable_3 shows that moves channels (from 0) by so much."""
    tensions_n = good_tensions_n()
    pulled = slice(int(4.5 * RATE_HZ), int(6.5 * RATE_HZ))
    for channel, move_n in moves_n.items():
        tensions_n[pulled, channel] += move_n
    if dead is not None:
        tensions_n[:, dead] = 50.0
    return judge_pull(
        series(tensions_n), ARM.cable_names, Pull("cable_3", *window), EXPECTED.floor_n
    )


@pytest.mark.parametrize(
    ("moves_n", "dead", "verdict"),
    [
        ({2: 20.0, 4: -9.0}, None, "right"),
        ({4: 20.0, 2: -9.0}, None, "swapped"),
        ({4: 20.0}, None, "swapped"),
        ({4: 20.0}, 2, "dead"),
        ({2: 20.0, 4: -18.0}, None, "unclear"),
        ({4: 20.0, 2: 18.0}, None, "unclear"),
        ({2: 0.3}, None, "too weak"),
    ],
)
def test_what_a_pull_shows(moves_n, dead, verdict):
    assert judged(moves_n, dead).verdict == verdict


@pytest.mark.parametrize("window", [(0.0, 2.0), (50.0, 60.0)])
def test_a_pull_without_readings_around_it_is_refused(window):
    with pytest.raises(CommissioningError, match="pull of cable_3 from"):
        judged({}, window=window)
