"""Which calibration the driver's tensions rest on, for log and diagnostics."""

from __future__ import annotations

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_ros.can.calibration import Calibration


def calibration_status(calibration: Calibration | None) -> Status:
    """Where scales and zeros are from; of calibrated cables also their values, for the record."""
    if calibration is None:
        return Status("calibration", Level.OK, "none given; those of the channel map")
    values = {
        cable: f"{sensor.scale_n_per_unit:.6g} N per unit from zero {sensor.zero:.6g}"
        for cable, sensor in calibration.cables.items()
    }
    made = f"calibration of {calibration.made:%Y-%m-%d %H:%M}"
    if calibration.uncalibrated:
        left = ", ".join(calibration.uncalibrated)
        return Status("calibration", Level.WARN, f"{made}, but the map's for {left}", values)
    return Status("calibration", Level.OK, made, values)
