"""Good sensors pass; every fault is found where it is, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from sensor_series import EXPECTED, RATE_HZ, STEP_N, good_tensions_n, series

from cablesense_online.commissioning.sensor_check import check_sensors
from cablesense_online.commissioning.tables import Pull, TimeWindow


def wrong(report):
    return {(finding.kind, finding.where) for finding in report.findings if finding.wrong}


@pytest.mark.parametrize("seed", range(5))
def test_good_sensors_are_usable(seed):
    report = check_sensors(series(good_tensions_n(seed=seed)), EXPECTED)
    assert report.usable, report.findings
    assert len(report.channels) == 12
    assert report.timing.rate_hz == pytest.approx(RATE_HZ)


def noisy(tensions_n):
    tensions_n[:, 4] += np.random.default_rng(0).normal(0.0, 1.0, len(tensions_n))


def drifting(tensions_n):
    tensions_n[:, 4] += np.linspace(0.0, 3.0, len(tensions_n))


def coarse(tensions_n):
    row = np.arange(len(tensions_n))
    tensions_n[:, 4] = 4.0 * STEP_N * np.round(20.0 * np.sin(row / 40.0))


def over_range(tensions_n):
    tensions_n[17, 4] = 3276.0


@pytest.mark.parametrize(
    ("spoil", "kind"), [(noisy, "noise"), (drifting, "drift"), (coarse, "step")]
)
def test_a_fault_is_found_at_its_cable(spoil, kind):
    tensions_n = good_tensions_n()
    spoil(tensions_n)
    found = wrong(check_sensors(series(tensions_n), EXPECTED))
    assert (kind, "cable_5") in found
    assert {where for _, where in found} == {"cable_5"}


def test_drift_of_an_arm_that_was_moved_in_between_is_a_note():
    tensions_n = good_tensions_n()
    drifting(tensions_n)
    moved = np.arange(len(tensions_n)) % 500 > 400
    report = check_sensors(series(tensions_n, at_rest=~moved), EXPECTED)
    assert report.usable
    assert [(finding.kind, finding.where) for finding in report.findings] == [("drift", "cable_5")]
    pulled = check_sensors(series(tensions_n), EXPECTED, [Pull("cable_5", TimeWindow(3.0, 4.0))])
    assert pulled.usable


def test_an_end_of_the_range_is_found():
    tensions_n = good_tensions_n()
    over_range(tensions_n)
    expected = replace(EXPECTED, range_n=(-50.0, 3276.0))
    assert ("range", "cable_5") in wrong(check_sensors(series(tensions_n), expected))
    assert ("range", "cable_5") not in wrong(check_sensors(series(tensions_n), EXPECTED))


def test_a_channel_that_stands_still_is_wrong_only_while_others_move():
    tensions_n = good_tensions_n()
    tensions_n[:, 4] = 50.0
    resting = check_sensors(series(tensions_n), EXPECTED)
    assert resting.usable
    assert [(finding.kind, finding.where) for finding in resting.findings] == [
        ("stuck", "cable_5")
    ]
    moving = np.arange(len(tensions_n)) > 500
    tensions_n[moving] += 30.0
    tensions_n[:, 4] = 50.0
    report = check_sensors(series(tensions_n, at_rest=~moving), EXPECTED)
    assert wrong(report) == {("stuck", "cable_5")}


def test_rate_jitter_and_loss_are_of_all():
    tensions_n = good_tensions_n()
    time_s = np.arange(len(tensions_n)) / RATE_HZ
    slow = check_sensors(series(tensions_n, 1.2 * time_s), EXPECTED)
    assert wrong(slow) == {("rate", "all")}
    lossy = np.delete(time_s, slice(300, 310))
    lost = check_sensors(series(tensions_n[:-10], lossy), EXPECTED)
    assert wrong(lost) == {("lost", "all")}
    shaken_s = time_s + 0.45 / RATE_HZ * np.random.default_rng(0).choice([-1, 1], len(time_s))
    assert ("jitter", "all") in wrong(check_sensors(series(tensions_n, shaken_s), EXPECTED))


def test_pulls_show_a_swap_and_are_no_rest():
    tensions_n = good_tensions_n()
    tensions_n[400:600, 6] += 25.0
    right = check_sensors(series(tensions_n), EXPECTED, [Pull("cable_7", TimeWindow(3.5, 6.5))])
    assert right.usable, right.findings
    swapped = check_sensors(series(tensions_n), EXPECTED, [Pull("cable_2", TimeWindow(3.5, 6.5))])
    assert wrong(swapped) == {("swapped", "cable_2")}
    assert "cable_7 moved most (25" in swapped.findings[0].text


def test_a_pull_that_shows_nothing_is_noted_and_not_wrong():
    weak = check_sensors(
        series(good_tensions_n()), EXPECTED, [Pull("cable_2", TimeWindow(3.5, 6.5))]
    )
    assert weak.usable
    assert weak.findings[0].kind == "pull"


def test_problems_of_the_coming_are_wrong():
    spoiled = replace(series(good_tensions_n()), problems=("3 samples were not finite",))
    assert wrong(check_sensors(spoiled, EXPECTED)) == {("samples", "all")}
