"""Arrays to and from `sensor_msgs/JointState`: tensions as efforts, joint angles as positions."""

from __future__ import annotations

import array
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.contract_error import ContractError
from cablesense_msgs_py.named_values import NamedOrder

MAX_JOINT_ANGLE_RAD = math.radians(60.0)
"""Commands beyond this are refused: no universal joint between guide plates reaches it."""


def put_tensions(message: Any, tensions_n: NDArray[np.float64]) -> None:
    """Put (M,) tensions in N into a `JointState` whose names are set already."""
    message.effort = array.array("d", tensions_n.tolist())


def put_joint_angles(message: Any, angles_rad: NDArray[np.float64]) -> None:
    """Put (2N,) joint angles in rad into a `JointState` whose names are set already."""
    message.position = array.array("d", angles_rad.tolist())


def joint_command_rad(message: Any, order: NamedOrder) -> NDArray[np.float64]:
    """The (2N,) joint angles that a `JointState` commands, in the arm's order.

    Raises:
        ContractError: a joint is missing, unknown or repeated, or an angle is not finite or out of
        reach.
    """
    angles = order.arrange(message.name, message.position, "position")
    for name, angle in zip(order.names, angles, strict=True):
        if not abs(angle) <= MAX_JOINT_ANGLE_RAD:
            raise ContractError(
                f"position of {name} is {angle:g} rad; it must be finite and within "
                f"±{MAX_JOINT_ANGLE_RAD:.3f} rad (a third of pi)"
            )
    return angles
