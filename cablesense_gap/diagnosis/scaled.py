"""Parameters in units of what is typical, so that one step length suits them all."""

from __future__ import annotations

import numpy as np

from cablesense_sim.effects.effect import Parameter

SIZE_PRIOR = 3.0
"""Sizes are expected within this many typical ones of zero (one standard deviation)."""


def is_logarithmic(parameter: Parameter) -> bool:
    """Times and lengths that are never zero are sought by their logarithm."""
    return parameter.role == "shape" and parameter.low > 0.0


def to_scaled(parameter: Parameter, value: float) -> float:
    """The value as the search sees it."""
    if is_logarithmic(parameter):
        return float(np.log(value))
    return value / parameter.typical


def from_scaled(parameter: Parameter, scaled: float) -> float:
    """The value that the search means, within the plausible range."""
    value = np.exp(scaled) if is_logarithmic(parameter) else scaled * parameter.typical
    return float(np.clip(value, parameter.low, parameter.high))


def prior_precision(parameter: Parameter) -> float:
    """Of the scaled value about zero for a size, about its start for a shape."""
    return SIZE_PRIOR**-2 if parameter.role == "size" else 1.0
