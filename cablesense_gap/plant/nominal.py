"""What the plant takes from an arm file: bare numbers, read here and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.plant_error import PlantError
from cablesense_msgs_py.bounded_file import read_bounded_text
from cablesense_msgs_py.plain_yaml import parse_plain_mapping

Array = NDArray[np.float64]

MAX_FILE_BYTES = 200_000


@dataclass(frozen=True)
class Nominal:
    """The arm as drawn: N segments, M cables.

    Attributes:
        gravity_m_s2: (3,) base frame.
        segment_count: N.
        length_m: joint centre to joint centre.
        mass_kg: of each segment, on the axis at half length.
        plate_offset_m: from a guide plate to its joint's centre; joint 1 is that far from x = 0.
        contact_m: from a segment's joint centre to its contact point, on the axis.
        per_segment: cables that end on a segment.
        radius_m: of the guide holes about the axis.
        hole_angle_rad: (M,) from +z towards +y.
        stiffness_n_m: of cable and actuator in series.
        pretension_n: with the arm straight and weightless.
        run_m: from actuator to base plate.
        rate_hz: of the sensors.
        noise_std_n: of a reading.
        step_n: of a reading.
    """

    gravity_m_s2: Array
    segment_count: int
    length_m: float
    mass_kg: float
    plate_offset_m: float
    contact_m: float
    per_segment: int
    radius_m: float
    hole_angle_rad: Array
    stiffness_n_m: float
    pretension_n: float
    run_m: float
    rate_hz: float
    noise_std_n: float
    step_n: float

    @property
    def cable_count(self) -> int:
        """M."""
        return self.segment_count * self.per_segment

    @property
    def floor_n(self) -> float:
        """Root mean square error of one reading: noise, and rounding over one step."""
        return float(np.sqrt(self.noise_std_n**2 + self.step_n**2 / 12.0))


def read_nominal(path: str | Path) -> Nominal:
    """Read the numbers of an arm file of identical segments.

    Raises:
        PlantError: the file cannot be read, lacks a number, or tells of another kind of arm.
    """
    try:
        text = read_bounded_text(path, MAX_FILE_BYTES, "an arm file", PlantError)
        keys = "segments, cables, sensors, gravity_m_s2"
        return _nominal(parse_plain_mapping(text, str(path), keys, PlantError))
    except KeyError as error:
        raise PlantError(f"{path}: {error} is missing; the plant needs a complete arm") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise PlantError(
            f"{path}: {error}; the plant builds arms of identical segments, as "
            "config/arms/cdsm_lab.yaml"
        ) from error


def _nominal(text: Any) -> Nominal:
    segments, cables, sensors = text["segments"], text["cables"], text["sensors"]
    if text.get("effects"):
        raise ValueError("effects are listed, and the plant draws its own from a nominal arm")
    count, per_segment = int(segments["count"]), int(cables["per_segment"])
    if count < 2 or per_segment < 3:
        raise ValueError("fewer than 2 segments or than 3 cables each")
    angle = cables["angle_deg"]
    segment, cable = np.divmod(np.arange(count * per_segment), per_segment)
    angles = angle["first"] + angle["per_segment"] * segment + angle["per_cable"] * cable
    return Nominal(
        gravity_m_s2=np.array(text["gravity_m_s2"], dtype=float).reshape(3),
        segment_count=count,
        length_m=float(segments["length_m"]),
        mass_kg=float(segments["mass_kg"]),
        plate_offset_m=float(segments["plate_offset_m"]),
        contact_m=float(segments["contact_m"]),
        per_segment=per_segment,
        radius_m=float(cables["routing_radius_m"]),
        hole_angle_rad=np.deg2rad(angles.astype(float)),
        stiffness_n_m=float(cables["stiffness_n_m"]),
        pretension_n=float(cables["pretension_n"]),
        run_m=float(cables["run_m"]),
        rate_hz=float(sensors["rate_hz"]),
        noise_std_n=float(sensors["noise_std_n"]),
        step_n=float(sensors["step_n"]),
    )
