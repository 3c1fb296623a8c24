"""The effects that verdicts have names for, drawn in the forms that physics offers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from cablesense_gap.plant.change import Draw
from cablesense_gap.plant.listed import actuators, cables, joints, loads, routing, sensors

LISTED: Mapping[str, Draw] = MappingProxyType(
    {
        "actuator_backlash": actuators.backlash,
        "base_tilt": loads.base_tilt,
        "cable_creep": cables.creep,
        "cable_stiffness": cables.stiffness,
        "capstan_friction": cables.capstan_friction,
        "contact_offset": loads.contact_offset,
        "joint_elasticity": joints.elasticity,
        "joint_friction": joints.friction,
        "payload": loads.payload,
        "pretension_error": cables.pretension_error,
        "routing_geometry": routing.routing_geometry,
        "sensor_crosstalk": sensors.crosstalk,
        "sensor_drift": sensors.drift,
        "sensor_gain": sensors.gain,
        "sensor_lag": sensors.lag,
        "sensor_offset": sensors.offset,
    }
)
