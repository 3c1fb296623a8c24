"""The `page` node: a machine and its estimator in the browser, and what a person asks for."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from std_srvs.srv import Trigger

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_online.page.controls import Actions
from cablesense_online.page.guard import exposure_warning
from cablesense_online.page.live_machine import LiveMachine
from cablesense_online.page.opened import shown_machine
from cablesense_online.page.page import Page
from cablesense_ros.endpoints import of_node, steady_timer
from cablesense_ros.machine_client import MachineClient, command_readers
from cablesense_ros.node_process import declare_parameters, full_name, parameter_table, run_node

_ASK_AGAIN_S = 0.5
"""After a commissioner has refused to begin."""


class PageNode(Node):
    """A thin shell around `LiveMachine` (messages in) and `Page` (picture and controls out)."""

    def __init__(self) -> None:
        super().__init__("page")
        settings = declare_parameters(self, parameter_table("page"))
        shown = shown_machine(settings["arm"])
        felt = shown.felt
        host = settings["host"]
        port = settings["port"]
        estimator = settings["estimator"]
        self._home_due = settings["home_at_start"]
        self._commission_due = settings["commission_at_start"]
        self._commission_from_s = 0.0
        self._home = felt.first_command
        self._live = LiveMachine(
            shown,
            joint_speed_rad_s=settings["joint_speed_rad_s"],
            frame_prefix=settings["frame_prefix"],
            estimator=full_name(self, estimator),
            commissioner=full_name(self, "commissioner"),
        )
        readers = command_readers(shown, estimator, commissioner=self._commission_due)
        self._client = MachineClient(self, self._live, estimator, readers)
        tare = self.create_client(Trigger, of_node(estimator, topics.TARE))
        undo_tare = self.create_client(Trigger, of_node(estimator, topics.TARE_UNDO))
        breathe = self.create_client(Trigger, of_node("breather", topics.BREATHE))
        commission = self.create_client(Trigger, of_node("commissioner", topics.COMMISSION))
        self._commission_client = commission
        self._actions = Actions(
            push=self._of_person("Not pushed", self._client.push),
            command=self._of_person("Not moved", self._client.command),
            tare=partial(self._ask, tare, "Tared", "Not tared"),
            undo_tare=partial(self._ask, undo_tare, "Tare undone", "Not undone"),
            breathe=partial(self._ask, breathe, "Breathing", "No breath"),
            can_breathe=breathe.service_is_ready,
            commission=partial(self._ask, commission, "Commissioning", "Not commissioned"),
            can_commission=commission.service_is_ready,
        )
        controls = settings["controls"]
        self._page = Page(shown, self._actions if controls else None, host=host, port=port)
        if self._page.port != port:
            self.get_logger().warning(f"port {port} is busy; serving on {self._page.port} instead")
        if warning := exposure_warning(host, self._page.port, controls):
            self.get_logger().warning(warning)
        self.get_logger().info(
            f"page of {shown.words.machine} {felt.identity} at {self._page.url}"
        )
        print(f"page: {self._page.url}", flush=True)
        steady_timer(self, 1.0 / settings["rate_hz"], self._draw)

    def destroy_node(self) -> None:
        """Closes the page, too."""
        self._page.close()
        super().destroy_node()

    def _draw(self) -> None:
        if self._home_due and self._client.connected:
            self._home_due = False
            self._client.command(self._home)
        if self._commission_due and not self._home_due and self._live.reports_ok("tare"):
            self._begin_commissioning()
        self._page.show(self._live.snapshot(time.monotonic()))

    def _begin_commissioning(self) -> None:
        """Ask the commissioner, again and again until it begins."""
        now_s = time.monotonic()
        client = self._commission_client
        if now_s < self._commission_from_s or not client.service_is_ready():
            return
        self._commission_from_s = now_s + _ASK_AGAIN_S

        def begun(future: Any) -> None:
            answer = future.result()
            if answer is not None and answer.success:
                self._commission_due = False
                self._page.notify("Commissioning", answer.message)

        client.call_async(Trigger.Request()).add_done_callback(begun)

    def _of_person(self, title: str, act: Callable[..., None]) -> Callable[..., None]:
        """The action, whose refusal is shown on the page; nothing begins by itself after it."""

        def try_to_act(*values: Any) -> None:
            self._commission_due = False
            try:
                act(*values)
            except CableSenseError as error:
                self._page.notify(title, str(error))

        return try_to_act

    def _ask(self, client: Client, done: str, refused: str) -> None:
        """Call a service; its answer is shown under one of the titles."""
        if not client.service_is_ready():
            self._page.notify(refused, f"nothing answers {client.srv_name}")
            return

        def show(future: Any) -> None:
            if (answer := future.result()) is not None:
                said = answer.message.replace("call ~/tare_undo", "press Undo the tare")
                self._page.notify(done if answer.success else refused, said)

        client.call_async(Trigger.Request()).add_done_callback(show)


main = partial(run_node, PageNode)


if __name__ == "__main__":
    sys.exit(main())
