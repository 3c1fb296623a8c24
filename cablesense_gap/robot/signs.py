"""Whether a torque was recorded with the opposite sign of the model's."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array

_AGAINST = 0.7
"""Correlation with the negative of the model's torque above which a channel may be reversed: an
imperfect model's may be somewhat negative."""


def is_reversed(measured: Array, modelled: Array, acceleration: Array) -> bool:
    """Whether a model explains a torque (Q,), N·m, better if the torque has the other sign.

    The inertia of a rotor, which a model need not have, may turn the sign of a torque that gravity
    dominates. It is positive, so it is fitted to the torque as it is, and to the reversed one.
    """
    sizes = np.linalg.norm(measured) * np.linalg.norm(modelled)
    if measured @ modelled >= -_AGAINST * sizes:
        return False
    residual = _residual_with_rotor(measured - modelled, acceleration)
    reversed_residual = _residual_with_rotor(-measured - modelled, acceleration)
    return reversed_residual < residual


def _residual_with_rotor(torque: Array, acceleration: Array) -> float:
    """Norm of a torque (Q,) that a rotor's inertia, zero or more, does not explain."""
    square = float(acceleration @ acceleration)
    inertia = max(float(torque @ acceleration) / square, 0.0) if square > 0.0 else 0.0
    return float(np.linalg.norm(torque - inertia * acceleration))
