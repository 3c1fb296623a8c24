"""The nodes' parameters: declared, described and bounded as `parameters.yaml` has them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from cablesense_base import CableSenseError
from cablesense_base.plain_yaml import parse_plain_mapping


class ParameterError(CableSenseError):
    """A parameter given at start that does not fit: names it and what would be valid."""


_KINDS = {bool: "true or false", int: "a whole number", float: "a number with a decimal point"}


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node, as `parameters.yaml` has it.

    Attributes:
        name: as in YAML files and `ros2 param`.
        default: also fixes the type.
        description: its effect, with the unit.
        bounds: least and greatest value of a number.
        choices: the texts that are allowed; empty for any.
        live: whether it may change while the node is at work; else the node reads it once.
    """

    name: str
    default: bool | int | float | str
    description: str
    bounds: Sequence[float] = ()
    choices: Sequence[str] = ()
    live: bool = False

    def descriptor(self, lifecycle: bool) -> ParameterDescriptor:
        """The description that `ros2 param describe` shows."""
        read_only = not (self.live or lifecycle)
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=read_only,
            additional_constraints=self.valid() if self.choices else "",
        )
        if self.bounds and isinstance(self.default, float):
            low, high = self.bounds
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif self.bounds:
            low, high = self.bounds
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        return descriptor

    def valid(self) -> str:
        """The valid values, for errors."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        within = " from {:g} to {:g}".format(*self.bounds) if self.bounds else ""
        return f"{_KINDS.get(type(self.default), 'text')}{within}"

    def allows(self, value: object) -> bool:
        """Whether a value of its type is finite and among the choices.

        NaN passes rclpy's own check of ranges, as it compares false with both ends.
        """
        finite = not isinstance(value, float) or math.isfinite(value)
        return finite and (not self.choices or value in self.choices)


def parameter_table(node: str) -> list[NodeParameter]:
    """The parameters of a node such as `sim`."""
    text = files("cablesense_ros").joinpath("parameters.yaml").read_text(encoding="utf-8")
    tables = parse_plain_mapping(text, "parameters.yaml", "nodes", ParameterError)
    return [
        NodeParameter(name, **(tables["shared"][name] if entry == "shared" else entry))
        for name, entry in tables[node].items()
    ]


def declare_parameters(
    node: Node, table: Sequence[NodeParameter], configured: Callable[[], bool] | None = None
) -> dict[str, Any]:
    """Declare all of a table, give their values.

    Those that are not live keep the value given at start, or, of a lifecycle node, the one that it
    was `configured` with: a change that would have no effect is refused.

    Raises:
        ParameterError: a value given at start has the wrong type or lies out of range.
    """
    for parameter in table:
        must = f"it must be {parameter.valid()}"
        descriptor = parameter.descriptor(configured is not None)
        try:
            value = node.declare_parameter(parameter.name, parameter.default, descriptor).value
        except ParameterException as error:
            raise ParameterError(f"parameter {parameter.name}: {error}; {must}") from error
        if not parameter.allows(value):
            raise ParameterError(f"parameter {parameter.name} is {value}; {must}")
    by_name = {parameter.name: parameter for parameter in table}

    def check(given: list[Parameter]) -> SetParametersResult:
        for one in given:
            parameter = by_name.get(one.name)
            if parameter is None or one.value == node.get_parameter(one.name).value:
                continue
            reason = ""
            if not parameter.allows(one.value):
                reason = f"must be {parameter.valid()}, not {one.value}"
            elif configured is not None and configured() and not parameter.live:
                reason = (
                    "is read when the node is configured, so a change now would have no effect; "
                    "deactivate the node and clean it up first"
                )
            if reason:
                return SetParametersResult(successful=False, reason=f"{one.name} {reason}")
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)
    return parameter_values(node)


def parameter_values(node: Node) -> dict[str, Any]:
    """Present values by name; those in degrees, `…_deg…`, also in radians, as `…_rad…`."""
    given = {name: one.value for name, one in node.get_parameters_by_prefix("").items()}
    degrees = {name: value for name, value in given.items() if re.search(r"_deg(_|$)", name)}
    return given | {
        name.replace("_deg", "_rad"): math.radians(value) for name, value in degrees.items()
    }
