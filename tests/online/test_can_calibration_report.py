"""What diagnostics say of the calibration in use."""

from test_can_calibration import OTHERS, TWO, WHOLE, calibration

from cablesense_msgs_py.diagnostics import Level
from cablesense_online.can.calibration import calibration_status


def test_no_calibration_is_said_without_alarm():
    assert calibration_status(None).level is Level.OK
    assert "channel map" in calibration_status(None).message


def test_a_whole_one_is_told_with_its_values():
    status = calibration_status(calibration(WHOLE))
    assert status.level is Level.OK
    assert status.values["cable_3"] == "1.25 N per unit from zero -3"


def test_cables_without_are_a_warning():
    status = calibration_status(calibration(TWO, OTHERS))
    assert status.level is Level.WARN
    assert "cable_12" in status.message
