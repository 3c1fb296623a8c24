"""The health that a node states, and its way into `diagnostic_msgs/DiagnosticArray`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any


class Level(IntEnum):
    """Severity, as `diagnostic_msgs/DiagnosticStatus` numbers it."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """One line of a node's health: a level, one sentence, figures with their units in the key."""

    name: str
    level: Level
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def diagnostic_statuses(
    statuses: Iterable[Status],
    node_name: str,
    hardware_id: str,
    make_status: Callable[..., Any],
    make_value: Callable[..., Any],
) -> list[Any]:
    """The statuses as messages.

    Args:
        statuses: in the order wanted.
        node_name: goes before each name (REP-107).
        hardware_id: the arm's identity.
        make_status: the class `diagnostic_msgs.msg.DiagnosticStatus`.
        make_value: the class `diagnostic_msgs.msg.KeyValue`.
    """
    return [
        make_status(
            level=bytes([status.level]),
            name=f"{node_name}: {status.name}",
            message=status.message,
            hardware_id=hardware_id,
            values=[make_value(key=key, value=value) for key, value in status.values.items()],
        )
        for status in statuses
    ]
