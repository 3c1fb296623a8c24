"""The services `~/tare` and `~/tare_undo`, and what the log says of tares."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.service import Service
from std_srvs.srv import Trigger

from cablesense_msgs_py import topics
from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.estimation import Estimation
from cablesense_ros.tare import Tare
from cablesense_ros.tare_words import tare_taken_line, tare_undone_line


class TareServices:
    """Takes tares, and takes them back, of an estimation that is at work."""

    def __init__(
        self,
        node: Node,
        cable_names: Sequence[str],
        estimation: Callable[[], Estimation | None],
        now_ns: Callable[[], int],
    ) -> None:
        """`estimation` gives the one at work, none while the node is not active."""
        self._node, self._cable_names = node, cable_names
        self._estimation, self._now_ns = estimation, now_ns
        self._services: list[Service] = [
            node.create_service(Trigger, topics.TARE, self._on_tare),
            node.create_service(Trigger, topics.TARE_UNDO, self._on_tare_undo),
        ]

    def destroy(self) -> None:
        """Offer them no more."""
        for service in self._services:
            self._node.destroy_service(service)
        self._services = []

    def log(self, tare: Tare, how: str) -> str:
        """Say in the log that a tare was taken; gives the line."""
        message = tare_taken_line(tare, self._cable_names, how)
        self._node.get_logger().info(message)
        return message

    def _on_tare(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._take)

    def _on_tare_undo(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._undo)

    def _answer(
        self, response: Trigger.Response, do: Callable[[Estimation], str]
    ) -> Trigger.Response:
        estimation = self._estimation()
        if estimation is None:
            response.success, response.message = False, "the node is not active"
            return response
        try:
            response.message = do(estimation)
            response.success = True
        except CableSenseError as error:
            response.success, response.message = False, str(error)
            self._node.get_logger().warning(f"tare: {error}")
        return response

    def _take(self, estimation: Estimation) -> str:
        return self.log(estimation.take_tare(self._now_ns()), "on request")

    def _undo(self, estimation: Estimation) -> str:
        undone = estimation.tare.present
        earlier = estimation.undo_tare()
        assert undone is not None  # or there would have been nothing to undo
        message = tare_undone_line(undone, earlier, self._cable_names, estimation.tare.undoable)
        self._node.get_logger().info(message)
        return message
