"""What all lifecycle nodes have in common: files are read when configured, and faults are said."""

from __future__ import annotations

import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.spin import run_node

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class ConfiguredNode(LifecycleNode, ABC):
    """A lifecycle node with a parameter `autostart`, which its subclass declares."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read files and create what the node has; on failure say why and stay unconfigured."""
        try:
            self._configure()
        except CableSenseError as error:
            self._release()
            self.get_logger().error(f"cannot configure: {error}")
            return FAILURE
        except Exception:  # rclpy would drop it without a word
            self._release()
            self.get_logger().error(f"cannot configure:\n{traceback.format_exc()}")
            return FAILURE
        return super().on_configure(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget what configuring read."""
        result = super().on_cleanup(state)
        self._release()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop from any state."""
        self._release()
        return super().on_shutdown(state)

    def autostart(self) -> None:
        """Configure and activate, unless `autostart` leaves it to a lifecycle manager."""
        if self.get_parameter("autostart").value and self.trigger_configure() == SUCCESS:
            self.trigger_activate()

    @abstractmethod
    def _configure(self) -> None:
        """Read what the parameters name, and create publishers and services.

        Raises:
            CableSenseError: a file is missing or invalid.
        """

    @abstractmethod
    def _release(self) -> None:
        """Stop, and undo whatever of `_configure` has been done; harmless when repeated."""


def run_configured_node(make: Callable[[], ConfiguredNode], args: Sequence[str] | None) -> int:
    """Run such a node, started as `autostart` says; the process's exit code."""

    def make_node() -> ConfiguredNode:
        node = make()
        node.autostart()
        return node

    return run_node(make_node, args)
