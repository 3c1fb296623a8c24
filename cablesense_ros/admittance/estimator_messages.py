"""What is read of the estimator's messages; anything that breaks the contract is refused."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.diagnostics import Level
from cablesense_msgs_py.frames import Frames
from cablesense_msgs_py.load import MAX_LOAD_N

Array = NDArray[np.float64]

INPUT_STATUS = "cable_tensions"


class FeltWrench(NamedTuple):
    """An estimate: segment 0 and no force where nothing touches, or nothing is known.

    Attributes:
        segment: from 1.
        force_n: (3,) in the segment's axes.
        stamp_ns: of the sample.
    """

    segment: int
    force_n: Array
    stamp_ns: int


def read_wrench(message: Any, frames: Frames) -> FeltWrench:
    """The estimate in a `WrenchStamped`.

    Raises:
        ContractError: an unknown frame, a force that is not finite or too large, or a force in
            the base frame, where there is none.
    """
    force = message.wrench.force
    components = (force.x, force.y, force.z)
    if not math.hypot(*components) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {components} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    frame = message.header.frame_id
    segment = 0 if frame == frames.base else frames.segment_number(frame)
    if segment == 0 and any(components):
        raise ContractError(
            f"wrench.force is {components} N in {frame}; a contact comes in its segment's frame"
        )
    stamp = message.header.stamp
    return FeltWrench(segment, np.array(components), stamp.sec * 1_000_000_000 + stamp.nanosec)


def check_probabilities(message: Any, segment_count: int) -> None:
    """Make sure that a `Float64MultiArray` holds this arm's probabilities.

    Raises:
        ContractError: another number of them, or one that is none.
    """
    if len(message.data) != segment_count + 1 or not all(0.0 <= p <= 1.0 for p in message.data):
        raise ContractError(
            f"data holds {list(message.data)[:8]}; it must hold {segment_count + 1} probabilities"
        )


def input_is_stale(message: Any, estimator: str) -> bool | None:
    """Whether a `DiagnosticArray` says that the estimator has no samples; None if it says nothing.

    `estimator` is the node's name.
    """
    for status in message.status:
        node, _, part = status.name.partition(": ")
        if part == INPUT_STATUS and node.strip("/") == estimator.strip("/"):
            return int.from_bytes(status.level, "little") == Level.STALE
    return None
