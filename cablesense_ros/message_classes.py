"""Message classes by their full names."""

from __future__ import annotations

from importlib import import_module


def message_class(kind: str) -> type | None:
    """The class of `sensor_msgs/msg/JointState` and the like; none where it is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name, None)
    except ModuleNotFoundError:
        return None
