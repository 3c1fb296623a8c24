"""The estimator node's parameters.

`LIVE_PARAMETERS` may change at any time; the others are read when the node is configured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from cablesense_ros.estimation_settings import EstimationSettings
from cablesense_ros.node_parameters import NodeParameter

ESTIMATOR_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "model", "", "Model file: the name of a bundled one, or a path; empty: the arm's own."
    ),
    NodeParameter(
        "autostart", True, "Configure and activate at start, without a lifecycle manager."
    ),
    NodeParameter("frame_prefix", "", "Goes before every frame name."),
    NodeParameter(
        "contact_threshold",
        0.5,
        "Probability of a contact from which on it is reported; below, the wrench is zero.",
        0.0,
        1.0,
    ),
    NodeParameter(
        "stale_after_s",
        0.2,
        "Without a sample for this long, or with one older than this, the wrench is zero, s.",
        0.001,
        60.0,
    ),
    NodeParameter(
        "slack_below_n", 1.0, "A cable below this tension, N, is reported as slack.", 0.0, 1000.0
    ),
    NodeParameter("tare_samples", 50, "Readings that a tare averages.", 1, 10_000),
    NodeParameter(
        "tare_steady_n",
        1.0,
        "Largest standard deviation of a cable's readings during a tare, N; more is not at rest.",
        0.001,
        1000.0,
    ),
    NodeParameter(
        "auto_tare",
        True,
        "Take the first readings at rest as the unloaded state; else wait for ~/tare.",
    ),
    NodeParameter(
        "state_file",
        "",
        "File that keeps tare and command, so that an estimator that was killed goes on with them "
        "instead of taking a loaded arm for the unloaded one; empty: none is kept.",
    ),
    NodeParameter(
        "state_within_s",
        60.0,
        "The file is gone on from when its estimator was alive at most this long ago, s.",
        1.0,
        86_400.0,
    ),
    NodeParameter(
        "joint_speed_deg_s",
        20.0,
        "Peak speed at which joints approach a command, degrees per second.",
        0.1,
        360.0,
    ),
    NodeParameter(
        "settle_s",
        0.5,
        "Time for the arm to come to rest after the joints must have arrived at a new command, s; "
        "until then the wrench is zero.",
        0.0,
        60.0,
    ),
    NodeParameter("markers", True, "Publish ~/markers."),
)


LIVE_PARAMETERS: Final = ("contact_threshold", "stale_after_s", "slack_below_n")


def estimation_settings(values: Mapping[str, Any]) -> EstimationSettings:
    """The settings that the parameters' values say."""
    return EstimationSettings(
        contact_threshold=values["contact_threshold"],
        stale_after_s=values["stale_after_s"],
        slack_below_n=values["slack_below_n"],
        tare_samples=values["tare_samples"],
        tare_steady_n=values["tare_steady_n"],
        auto_tare=values["auto_tare"],
        joint_speed_rad_s=math.radians(values["joint_speed_deg_s"]),
        settle_s=values["settle_s"],
    )
