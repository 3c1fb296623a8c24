"""What sensors read under known loads, in their signals' units: as noted, or from a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cablesense_gap.recordings.recording import Recording
from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.commissioning.commissioning_error import CommissioningError
from cablesense_ros.commissioning.known_load import KnownLoad
from cablesense_ros.commissioning.sensor_calibration import CalibrationPoint

FEWEST_SAMPLES = 10
"""In a window; the mean of fewer is hardly better than one reading."""


def calibration_points(
    loads: Mapping[str, Sequence[KnownLoad]],
    as_recorded: ChannelMap,
    recording: Recording | None,
) -> dict[str, list[CalibrationPoint]]:
    """The points of every cable that has loads, in the order of the loads.

    Args:
        loads: by cable.
        as_recorded: the map, with the scales and zeros that were in force when the recording was
            made: with them its tensions are turned back into the signals' values. Its channels
            are in the order of the recording's tensions.
        recording: where the loads' windows lie, if any has one.

    Raises:
        CommissioningError: a window without a recording, or with too few samples in it.
    """
    return {
        cable: [_point(load, as_recorded, recording) for load in of_cable]
        for cable, of_cable in loads.items()
    }


def _point(
    load: KnownLoad, as_recorded: ChannelMap, recording: Recording | None
) -> CalibrationPoint:
    if isinstance(load.reading, float):
        return CalibrationPoint(load.force_n, load.reading, load.force_u_n, load.raw_u)
    if recording is None:
        raise CommissioningError(
            f"{load.where}: gives start_s and end_s; give the recording as well, or the reading "
            "under raw"
        )
    rows = load.reading.rows(recording.time_s)
    if np.count_nonzero(rows) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"{load.where}: only {np.count_nonzero(rows)} samples of {recording.name} lie from "
            f"{load.reading.start_s:g} to {load.reading.end_s:g} s; there must be at least "
            f"{FEWEST_SAMPLES}, and the recording goes from {recording.time_s[0]:g} to "
            f"{recording.time_s[-1]:g} s"
        )
    column = as_recorded.cable_names.index(load.cable)
    tension_n = float(recording.tensions_n[rows, column].mean())
    raw = as_recorded.channels[load.cable].value(tension_n)
    return CalibrationPoint(load.force_n, raw, load.force_u_n, load.raw_u)
