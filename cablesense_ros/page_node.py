"""The `page` node: shows arm and estimator in the browser, publishes what a person asks for."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from rclpy.node import Node
from std_srvs.srv import Trigger

from cablesense_base.errors import CableSenseError
from cablesense_msgs_py import topics
from cablesense_online.page.live_arm import LiveArm
from cablesense_online.page.page import Page, exposure_warning
from cablesense_online.page.panel import Actions, Push
from cablesense_ros.arm_client import ArmClient
from cablesense_ros.node_process import (
    ARM,
    FRAME_PREFIX,
    JOINT_SPEED,
    NodeParameter,
    declare_parameters,
    of_node,
    parameter_values,
    run_node,
)
from cablesense_sim.arm import open_arm

PAGE_PARAMETERS: Final = (
    ARM,
    FRAME_PREFIX,
    JOINT_SPEED,
    NodeParameter(
        "host", "127.0.0.1", "Address to serve on; 0.0.0.0 lets other machines see and push."
    ),
    NodeParameter("port", 8080, "Port to serve on; when busy, the next free one.", 1, 65535),
    NodeParameter("rate_hz", 25.0, "How often the scene is drawn, Hz.", 1.0, 60.0),
    NodeParameter("estimator", "estimator", "Name of the estimator node to show."),
    NodeParameter("controls", True, "Whether a person may push, move and tare from the page."),
    NodeParameter(
        "home_at_start",
        False,
        "Command the straight pose once arm and estimator receive, so that they agree on it.",
    ),
)


class PageNode(Node):
    """A thin shell around `LiveArm` (messages in) and `Page` (picture and controls out)."""

    def __init__(self) -> None:
        super().__init__("page")
        declare_parameters(self, PAGE_PARAMETERS)
        values = parameter_values(self, PAGE_PARAMETERS)
        arm = open_arm(values["arm"])
        self._home_due = values["home_at_start"]
        self._home_rad = np.zeros(arm.joint_count)
        self._live = LiveArm(
            arm,
            joint_speed_rad_s=float(np.deg2rad(values["joint_speed_deg_s"])),
            frame_prefix=values["frame_prefix"],
            estimator=values["estimator"],
        )
        self._client = ArmClient(self, arm, self._live, values["estimator"])
        self._tare = self.create_client(Trigger, of_node(values["estimator"], topics.TARE))
        actions = Actions(self._push, self._client.command, self._ask_for_tare)
        self._page = Page(
            arm, actions if values["controls"] else None, host=values["host"], port=values["port"]
        )
        if self._page.port != values["port"]:
            self.get_logger().warning(
                f"port {values['port']} is busy; serving on {self._page.port} instead"
            )
        warning = exposure_warning(values["host"], self._page.port, values["controls"])
        if warning:
            self.get_logger().warning(warning)
        self.get_logger().info(f"page of arm {arm.identity} at {self._page.url}")
        print(f"page: {self._page.url}", flush=True)
        self.create_timer(1.0 / values["rate_hz"], self._draw)

    def destroy_node(self) -> None:
        """Closes the page, too."""
        self._page.close()
        super().destroy_node()

    def _draw(self) -> None:
        if self._home_due and self._client.connected:
            self._home_due = False
            self._client.command(self._home_rad)
        self._page.show(self._live.snapshot(time.monotonic()))

    def _push(self, push: Push) -> None:
        try:
            self._client.push(push.segment, push.angle_deg, push.magnitude_n)
        except CableSenseError as error:
            self._page.notify("Not pushed", str(error))

    def _ask_for_tare(self) -> None:
        if not self._tare.service_is_ready():
            self._page.notify("Not tared", f"nothing answers {self._tare.srv_name}")
            return
        future = self._tare.call_async(Trigger.Request())
        future.add_done_callback(self._show_answer)

    def _show_answer(self, future: Any) -> None:
        answer = future.result()
        if answer is not None:
            self._page.notify("Tared" if answer.success else "Not tared", answer.message)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; the process's exit code."""
    return run_node(PageNode, args)


if __name__ == "__main__":
    sys.exit(main())
