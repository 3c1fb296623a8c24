"""Units in which somebody else's recording may have its numbers, each in SI units.

Amplifiers on a CAN bus have counts or mV/V: their channel maps state `scale_n_per_unit` instead
(`cablesense_online.can.channel_map`).
"""

from __future__ import annotations

import math
from typing import Final

FORCE_UNITS: Final = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "lbf": 4.4482216152605,
}
TORQUE_UNITS: Final = {"N·m": 1.0, "mN·m": 1e-3, "N·cm": 1e-2, "N·mm": 1e-3}
ANGLE_UNITS: Final = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0}
LENGTH_UNITS: Final = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
OTHER_TIME_UNITS: Final = {
    "milliseconds": TIME_UNITS["ms"],
    "microseconds": TIME_UNITS["us"],
    "nanoseconds": TIME_UNITS["ns"],
}
"""In which a column of seconds may be by mistake, by their names in words."""
READING_UNITS: Final = FORCE_UNITS | TORQUE_UNITS
"""Of a channel: a tension, or a joint's torque."""
COMMAND_UNITS: Final = ANGLE_UNITS | LENGTH_UNITS
"""Of a command: an angle, a slide, or the length that an actuator holds."""


def time_unit_of(interval: float, usual_s: tuple[float, float]) -> str:
    """The unit, in words, in which times seem to be that should be in seconds; empty for none.

    Their rows are `interval` apart as numbers. Times are taken for those of a unit if, read in
    it, rows come as often as such rows usually do: every `usual_s`, from the first to below the
    second.
    """
    for unit, seconds in OTHER_TIME_UNITS.items():
        if usual_s[0] <= interval * seconds < usual_s[1]:
            return unit
    return ""
