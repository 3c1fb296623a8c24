"""Node parameters as a table: name, default, description, range; NaN is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from cablesense_base.errors import CableSenseError


class ParameterError(CableSenseError):
    """A parameter given at start that does not fit: names it and what would be valid."""


@dataclass(frozen=True)
class NodeParameter:
    """One parameter.

    Attributes:
        name: as in YAML files and `ros2 param`.
        default: also fixes the type.
        description: what it does, with its unit.
        lowest, highest: allowed range of a number.
    """

    name: str
    default: bool | int | float | str
    description: str
    lowest: float | None = None
    highest: float | None = None

    def descriptor(self, read_only: bool) -> ParameterDescriptor:
        """The description that `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(description=self.description, read_only=read_only)
        if self.lowest is None or self.highest is None:
            return descriptor
        if isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.lowest, to_value=self.highest)
            ]
        else:
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.lowest), to_value=int(self.highest), step=1)
            ]
        return descriptor

    def valid(self) -> str:
        """What would be right, for errors."""
        kind = {
            bool: "true or false",
            int: "a whole number",
            float: "a number with a decimal point",
        }
        what = kind.get(type(self.default), "text")
        within = "" if self.lowest is None else f" from {self.lowest:g} to {self.highest:g}"
        return f"{what}{within}"


def declare_parameters(node: Node, table: Sequence[NodeParameter], read_only: bool = True) -> None:
    """Declare all of a table; `read_only` ones keep the value given at start.

    Raises:
        ParameterError: a value given at start has the wrong type or lies out of range.
    """
    for parameter in table:
        try:
            value = node.declare_parameter(
                parameter.name, parameter.default, parameter.descriptor(read_only)
            ).value
        except (
            InvalidParameterTypeException,
            InvalidParameterValueException,
            ParameterException,
        ) as error:
            raise ParameterError(
                f"parameter {parameter.name}: {error}; it must be {parameter.valid()}"
            ) from error
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(
                f"parameter {parameter.name} is {value}; it must be {parameter.valid()}"
            )
    node.add_on_set_parameters_callback(_refuse_not_finite)


def parameter_values(node: Node, table: Sequence[NodeParameter]) -> dict[str, Any]:
    """Present values by name."""
    return {parameter.name: node.get_parameter(parameter.name).value for parameter in table}


def _refuse_not_finite(parameters: list[Parameter]) -> SetParametersResult:
    """NaN passes rclpy's own check of ranges, as it compares false with both ends."""
    for parameter in parameters:
        if isinstance(parameter.value, float) and not math.isfinite(parameter.value):
            return SetParametersResult(
                successful=False, reason=f"{parameter.name} must be finite, not {parameter.value}"
            )
    return SetParametersResult(successful=True)
