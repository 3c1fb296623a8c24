"""Readings under known loads, from a recording: the tensions turned back into signal values."""

import numpy as np
import pytest
from can_frames import PACKED

from cablesense_gap.recordings.recording import Recording
from cablesense_online.commissioning.sensor_calibration import calibration_points
from cablesense_online.commissioning.tables import CommissioningError, KnownLoad, TimeWindow

TIME_S = np.arange(0.0, 20.0, 0.1)


def recording(tensions_n):
    rows = len(TIME_S)
    return Recording(
        "run",
        TIME_S,
        np.zeros(rows, dtype=np.int64),
        np.zeros((rows, 8)),
        np.zeros(rows, dtype=np.int64),
        np.zeros((rows, 3)),
        tensions_n,
    )


def load(reading, cable="cable_3"):
    return KnownLoad("l.csv: line 2", cable, True, 20.0, 0.1, reading, 0.0)


def with_channel(cable, **values):
    channels = dict(PACKED.channels)
    channels[cable] = channels[cable].model_copy(update=values)
    return PACKED.model_copy(update={"channels": channels})


def test_noted_readings_go_through():
    (point,) = calibration_points({"cable_3": [load(417.0)]}, PACKED, None)["cable_3"]
    assert (point.force_n, point.raw, point.force_u_n) == (20.0, 417.0, 0.1)


def test_a_window_gives_the_signal_value_whatever_scale_was_in_force():
    as_recorded = with_channel("cable_3", scale_n_per_unit=0.5, zero=10.0)
    tensions_n = np.zeros((len(TIME_S), 12))
    tensions_n[(TIME_S >= 5.0) & (TIME_S <= 8.0), 2] = as_recorded.channels["cable_3"].tension_n(
        417.0
    )
    loads = {"cable_3": [load(TimeWindow(5.0, 8.0))]}
    (point,) = calibration_points(loads, as_recorded, recording(tensions_n))["cable_3"]
    assert point.raw == pytest.approx(417.0)


@pytest.mark.parametrize("window", [TimeWindow(5.0, 5.2), TimeWindow(30.0, 40.0)])
def test_a_window_with_too_few_samples_is_refused(window):
    with pytest.raises(CommissioningError, match=r"line 2: only .* samples of run"):
        calibration_points({"c": [load(window)]}, PACKED, recording(np.zeros((200, 12))))


def test_a_window_wants_a_recording():
    with pytest.raises(CommissioningError, match="give the recording as well"):
        calibration_points({"c": [load(TimeWindow(1.0, 2.0))]}, PACKED, None)
