"""The settings of an estimator node that nobody has set; without rclpy."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.plain_yaml import parse_plain_mapping
from cablesense_online.settings import EstimationSettings


def node_settings(**changes: Any) -> EstimationSettings:
    """The defaults of `parameters.yaml`, but for some; `changes` are named as the settings."""
    text = files("cablesense_ros").joinpath("parameters.yaml").read_text(encoding="utf-8")
    nodes = parse_plain_mapping(text, "parameters.yaml", "nodes", CableSenseError)
    entries = nodes["estimator"]
    values = {
        name: (nodes["shared"][name] if entry == "shared" else entry)["default"]
        for name, entry in entries.items()
    }
    radians = {
        name.replace("_deg", "_rad"): float(np.deg2rad(value))
        for name, value in values.items()
        if "_deg" in name
    }
    return EstimationSettings.model_validate(values | radians | changes)
