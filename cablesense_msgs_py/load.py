"""A known load from `geometry_msgs/WrenchStamped`, as `applied_wrench` carries it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.frames import Frames

MAX_LOAD_N = 2_000.0
"""A larger force is a wrong unit or a slip, not a push."""


@dataclass(frozen=True)
class Load:
    """A force (3,) in N, base axes, at the contact point of segment `segment` (counted from 1)."""

    segment: int
    force_base_n: NDArray[np.float64]


def read_load(message: Any, frames: Frames) -> Load:
    """The load that a `WrenchStamped` describes.

    Raises:
        ContractError: an unknown frame, a force that is not finite or too large, or a torque.
    """
    segment = frames.segment_number(message.header.frame_id)
    force, torque = message.wrench.force, message.wrench.torque
    components = (force.x, force.y, force.z)
    if not math.hypot(*components) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {_shown(components)} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    if any(component != 0.0 for component in (torque.x, torque.y, torque.z)):
        raise ContractError(
            f"wrench.torque is {_shown((torque.x, torque.y, torque.z))} N·m; it must be zero: "
            "a load is a force at the contact point of the segment"
        )
    return Load(segment, np.array(components, dtype=np.float64))


def _shown(vector: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{component:g}" for component in vector) + ")"
