"""Effects that verdicts have no name for: what a real arm may have and nobody listed."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cablesense_gap.plant.change import Draw
from cablesense_gap.plant.unlisted import measuring, structure, surroundings, transmission

UNLISTED: Mapping[str, Draw] = MappingProxyType(
    {
        "actuator_ratio": transmission.actuator_ratio,
        "clamp_slip": transmission.clamp_slip,
        "hardening_cables": transmission.hardening_cables,
        "screw_error": transmission.screw_error,
        "snagging_cables": transmission.snagging_cables,
        "limber_segments": structure.limber_segments,
        "link_length": structure.link_length,
        "skewed_axes": structure.skewed_axes,
        "cogging": surroundings.cogging,
        "tether": surroundings.tether,
        "wall": surroundings.wall,
        "load_direction": measuring.load_direction,
        "load_scale": measuring.load_scale,
        "sensor_bow": measuring.sensor_bow,
        "sensor_ceiling": measuring.sensor_ceiling,
        "sensor_dropouts": measuring.sensor_dropouts,
        "sensor_hum": measuring.sensor_hum,
    }
)
