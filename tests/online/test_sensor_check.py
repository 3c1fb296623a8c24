"""Good sensors pass; every fault is a finding that names its cable and the remedy."""

import re
from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording
from sensor_series import ARM, EXPECTED, RATE_HZ, STEP_N, good_tensions_n, series

from cablesense_gap.recordings import thinning
from cablesense_online.commissioning.sensor_check import (
    LEAST_FLOOR_N,
    check_sensors,
    exercised_channel_findings,
    expectation,
)
from cablesense_online.commissioning.tables import Pull, TimeWindow
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium


def wrong(report):
    return {(finding.kind, finding.where) for finding in report.findings if finding.wrong}


@pytest.mark.parametrize("seed", range(2))
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
    tensions_n[17, 4] = 3276.0
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


def test_bounds_are_the_arm_files():
    expected = expectation(ARM.sensors)
    assert expected.rate_hz == ARM.sensors.rate_hz
    assert expected.floor_n == pytest.approx((0.05**2 + 0.1813**2 / 12) ** 0.5)
    assert expected.noise_n == pytest.approx(2.0 * expected.floor_n)
    assert expected.jitter_s == pytest.approx(0.5 / expected.rate_hz)
    given = expectation(ARM.sensors, 1000.0, 0.5)
    assert (given.rate_hz, given.drift_n) == (1000.0, 0.5)


def test_ideal_sensors_of_a_file_leave_room_for_real_ones():
    ideal = ARM.sensors.model_copy(update={"noise_std_n": 0.0, "step_n": 0.0})
    assert expectation(ideal).floor_n == LEAST_FLOOR_N


@pytest.fixture(scope="module")
def recording():
    made = small_recording()
    nominal = solve_equilibrium(mechanism_of(LAB), made.command_rad, made.forces_n)
    draw = np.random.default_rng(0)
    return replace(
        made, tensions_n=nominal.tensions_n + draw.normal(0.0, 0.05, nominal.tensions_n.shape)
    )


def test_correct_channels_and_an_arm_at_rest_give_no_findings(recording):
    assert exercised_channel_findings(recording, LAB) == []
    assert exercised_channel_findings(recording.rows(slice(0, 20)), LAB) == []


def test_an_exchange_is_found(recording):
    swapped_n = recording.tensions_n.copy()
    swapped_n[:, [1, 6]] = swapped_n[:, [6, 1]]
    (finding,) = exercised_channel_findings(replace(recording, tensions_n=swapped_n), LAB)
    assert finding.wrong
    assert finding.kind == "swapped"
    assert "tension_2_n reads cable_7" in finding.text


def test_a_long_recording_is_thinned_out_and_rows_are_those_of_the_file(recording, monkeypatch):
    monkeypatch.setattr(thinning, "MOST_ROWS", len(recording) // 2)
    dead_n = recording.tensions_n.copy()
    dead_n[100:, 4] = 50.0
    (finding,) = exercised_channel_findings(replace(recording, tensions_n=dead_n), LAB)
    assert finding.kind == "stuck"
    first, last = map(int, re.findall(r"rows (\d+) to (\d+)", finding.text)[0])
    assert 100 < first < 110
    assert last == len(recording)
