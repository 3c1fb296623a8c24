"""Known loads from a table; scale and zero from them: exact, with uncertainty, or refused."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cablesense_base import CableSenseError
from cablesense_online.sensor_calibration import (
    KnownLoad,
    calibrate_sensor,
    characteristics,
    raw_reading,
    read_known_loads,
)
from cablesense_online.sensor_check import CommissioningError
from tests.helpers.can_frames import PACKED, PACKED_DATABASE
from tests.helpers.sensor_series import series

UP_AND_DOWN_N = (0.0, 20.0, 40.0, 60.0, 80.0, 60.0, 40.0, 20.0, 0.0)
SCALE = 0.0125
ZERO = -310.0
DRAWS = 600


def calibrate(force_n, raw, common_relative_u=0.0, cable="cable_2"):
    forces_n = np.array(force_n)
    channel = PACKED.channels[cable]
    return calibrate_sensor(
        cable, channel, PACKED_DATABASE, forces_n, np.array(raw), common_relative_u
    )


def raw_of(force_n=UP_AND_DOWN_N, error_n=0.0):
    return ZERO + (np.array(force_n) + error_n) / SCALE


def test_the_stated_uncertainty_covers_the_truth_in_95_of_100_draws():
    draw = np.random.default_rng(4)
    hits = np.zeros(3)
    for _ in range(DRAWS):
        calibrated = calibrate(UP_AND_DOWN_N, raw_of(error_n=draw.normal(0.0, 0.3, 9)))
        top_n = calibrated.scale_n_per_unit * (ZERO + 80.0 / SCALE - calibrated.zero)
        hits += (
            abs(calibrated.scale_n_per_unit - SCALE) <= calibrated.scale_u95_n_per_unit,
            abs(calibrated.zero - ZERO) <= calibrated.zero_u95,
            abs(top_n - 80.0) <= calibrated.tension_u95_n,
        )
    share = hits / DRAWS
    assert (share >= 0.925).all(), share
    assert (share[:2] <= 0.975).all(), share


@pytest.mark.parametrize(
    ("force_n", "remedy"),
    [
        ((0.0, 10.0, 20.0, 30.0), "at least 5"),
        ((0.0, 50.0, 0.0, 50.0, 0.0, 50.0), "only 2 sizes"),
        ((60.0, 70.0, 80.0, 90.0, 100.0), "at least half of the largest"),
        ((0.0,) * 6, "only 1 sizes;"),
    ],
)
def test_too_few_or_too_close_loads_are_refused(force_n, remedy):
    with pytest.raises(CommissioningError, match=f"cable_7: .*{remedy}"):
        calibrate(force_n, raw_of(force_n), cable="cable_7")


def test_readings_that_do_not_follow_are_refused():
    for raw in (np.full(9, 12.0), np.random.default_rng(6).normal(size=9)):
        with pytest.raises(CommissioningError, match="do not follow"):
            calibrate(UP_AND_DOWN_N, raw)


FORCES_N = np.array([0.0, 20.0, 40.0, 60.0, 80.0, 100.0])


@settings(max_examples=30)
@given(st.floats(1e-6, 1e4) | st.floats(-1e4, -1e-6), st.floats(-1e5, 1e5))
def test_readings_without_error_give_back_scale_and_zero(scale, zero):
    raw = zero + FORCES_N / scale
    assume(100.0 / abs(scale) > 1e-5 * abs(raw).max())
    calibrated = calibrate(FORCES_N, raw)
    assert calibrated.scale_n_per_unit == pytest.approx(scale, rel=1e-6)
    assert calibrated.zero == pytest.approx(zero, abs=1e-6 * (abs(zero) + 100.0 / abs(scale)))
    assert calibrated.points == 6
    assert calibrated.largest_force_n == 100.0
    assert calibrated.hysteresis_n is None


@pytest.mark.parametrize(
    ("force_n", "residual_n", "nonlinearity_n", "hysteresis_n", "repeatability_n"),
    [
        ([0, 50, 100, 50, 0], [0.0, -0.5, 0.25, 1.0, 0.125], 0.5, 1.5, None),
        ([0, 50, 100, 0, 50, 100], [0.0, 0.0, 0.0, 0.0, 0.75, 0.0], 0.375, 0.0, 0.75),
        ([0, 50, 100], [0.1, -0.2, 0.1], 0.2, None, None),
    ],
    ids=["up and down", "repeated", "rising only"],
)
def test_characteristics_follow_from_the_order_of_the_loads(
    force_n, residual_n, nonlinearity_n, hysteresis_n, repeatability_n
):
    found = characteristics(np.array(force_n, dtype=float), np.array(residual_n))
    assert found == pytest.approx((nonlinearity_n, hysteresis_n, repeatability_n))


def load(**reading):
    return KnownLoad(line=2, cable="cable_3", mass_kg=2.0, **reading)


@pytest.mark.parametrize("window", [(5.0, 5.2), (30.0, 40.0)])
def test_a_window_without_samples_is_refused(window):
    windowed = load(start_s=window[0], end_s=window[1])
    with pytest.raises(CommissioningError, match=r"line 2: only .* samples of run"):
        raw_reading(windowed, PACKED, series(np.zeros((200, 12)), 0.1 * np.arange(200)))
    with pytest.raises(CommissioningError, match="give the recording as well"):
        raw_reading(windowed, PACKED, None)


CABLES = ("cable_1", "cable_2")


@pytest.fixture
def read(tmp_path):
    def of(text):
        path = tmp_path / "loads.csv"
        path.write_text(text, encoding="utf-8")
        return read_known_loads(path, CABLES)

    return of


def test_cells_go_by_column_name_and_cables_keep_the_order_of_their_loads(read):
    loads = read(
        "\ufeffcable, force_n, start_s, end_s, raw\n"
        "# up\ncable_2,0,1,5,\ncable_1,3,,,12.5\n\ncable_2,30,10.5,14,\n"
    )
    assert [load.force_n for load in loads["cable_2"]] == [0.0, 30.0]
    assert [load.line for load in loads["cable_2"]] == [3, 6]
    assert (loads["cable_2"][1].start_s, loads["cable_2"][1].end_s) == (10.5, 14.0)
    assert loads["cable_1"][0].raw == 12.5


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("cable,force_n,raw\n", "no rows"),
        ("cable,weight,raw\ncable_1,1,2\n", "weight is no known key"),
        ("force_n,raw\n1,2\n", "cable is missing"),
        ("cable,force_n,raw\ncable_3,1,2\n", "no cable 'cable_3'; there are cable_1, cable_2"),
        ("cable,force_n,raw\ncable_1,1\n", "line 2 has 2 cells"),
        ("cable,force_n,raw\ncable_1,x,2\n", "force_n = 'x': must be a number"),
        ("cable,force_n,raw\ncable_1,nan,2\n", "must be a finite number"),
        ("cable,force_n,mass_kg,raw\ncable_1,1,1,2\n", "must give one of mass_kg and force_n"),
        ("cable,force_n,raw\ncable_1,,2\n", "must give one of mass_kg and force_n"),
        ("cable,force_n,raw\ncable_1,1,\n", "must give one of raw and start_s"),
        ("cable,force_n,start_s\ncable_1,1,5\n", "both of start_s and end_s"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(read, text, remedy):
    with pytest.raises(CableSenseError, match=r"loads\.csv: ") as refusal:
        read(text)
    assert remedy in str(refusal.value)
