"""What a calibration file says of sensors, and of those that were not calibrated."""

from datetime import UTC, datetime

from can_frames import PACKED, PACKED_DATABASE

from cablesense_online.can.calibration import calibrated
from cablesense_online.commissioning.sensor_calibration import (
    CalibrationPoint,
    calibrate_sensor,
    calibration_record,
)

POINTS = [CalibrationPoint(force, 3.0 + 4.0 * force) for force in (0.0, 20.0, 40.0, 60.0, 80.0)]


def test_the_record_is_taken_by_the_map_it_was_made_for():
    found = {"cable_9": calibrate_sensor("cable_9", POINTS, 0.01)}
    made = calibration_record(
        found, PACKED, PACKED_DATABASE, datetime(2026, 3, 1, tzinfo=UTC), 9.81, 0.01
    )
    assert made.uncalibrated == [cable for cable in PACKED.channels if cable != "cable_9"]
    assert made.cables["cable_9"].signal == PACKED.channels["cable_9"].signal
    assert made.cables["cable_9"].points == 5
    assert made.cables["cable_9"].hysteresis_n is None
    channel = calibrated(PACKED, PACKED_DATABASE, made, "c").channels["cable_9"]
    assert abs(channel.tension_n(3.0 + 4.0 * 50.0) - 50.0) < 1e-9
