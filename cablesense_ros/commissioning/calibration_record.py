"""Calibrated sensors as the calibration that the driver reads."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from cantools.database.can import Database

from cablesense_ros.can.calibration import CalibratedSensor, Calibration
from cablesense_ros.can.channel_map import Channel, ChannelMap
from cablesense_ros.can.signal_database import channel_signal
from cablesense_ros.commissioning.sensor_calibration import SensorCalibration


def calibration_record(
    found: Mapping[str, SensorCalibration],
    channel_map: ChannelMap,
    database: Database,
    made: datetime,
    gravity_m_s2: float | None,
    common_relative_u: float,
) -> Calibration:
    """The calibration of a map's sensors; cables that were not calibrated are listed as such.

    Args:
        found: by cable.
        channel_map: the map of their channels.
        database: its DBC file, whose units and factors are noted.
        made: when.
        gravity_m_s2: with which masses were taken for forces; none where there were no masses.
        common_relative_u: relative standard uncertainty that all loads shared.
    """
    return Calibration(
        map=channel_map.name,
        made=made,
        gravity_m_s2=gravity_m_s2,
        common_relative_u=common_relative_u,
        uncalibrated=[cable for cable in channel_map.channels if cable not in found],
        cables={
            cable: _sensor(found[cable], channel, database)
            for cable, channel in channel_map.channels.items()
            if cable in found
        },
    )


def _sensor(found: SensorCalibration, channel: Channel, database: Database) -> CalibratedSensor:
    signal = channel_signal(database, channel)
    return CalibratedSensor(
        message=channel.message,
        signal=channel.signal,
        signal_unit=signal.unit,
        signal_factor=signal.factor,
        signal_offset=signal.offset,
        scale_n_per_unit=found.scale_n_per_unit,
        zero=found.zero,
        scale_u95_n_per_unit=found.scale_u95_n_per_unit,
        zero_u95=found.zero_u95,
        tension_u95_n=found.tension_u95_n,
        points=found.points,
        largest_force_n=found.largest_force_n,
        nonlinearity_n=found.figures.nonlinearity_n,
        hysteresis_n=found.figures.hysteresis_n,
        repeatability_n=found.figures.repeatability_n,
    )
