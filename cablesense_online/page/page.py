"""The page as a whole: one web server with the scene, the numbers, the traces and the controls."""

from __future__ import annotations

import contextlib
import io
import ipaddress
import socket
import threading
import time

import viser

from cablesense_base.errors import CableSenseError
from cablesense_online.page import panel
from cablesense_online.page.drawing import full_scale_n
from cablesense_online.page.live_arm import Score, Snapshot
from cablesense_online.page.panel import Actions, Controls, TracePlot
from cablesense_online.page.scene import ArmScene
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.mechanism import Mechanism

NUMBERS_EVERY_S = 0.15
PORT_TRIES = 20


class PageError(CableSenseError):
    """The page cannot be served."""


class Page:
    """A live view of an arm, served on `port` until `close`."""

    def __init__(
        self, arm: Arm, actions: Actions | None, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        """Starts serving; without `actions` the page only shows.

        Raises:
            PageError: no port from `port` on can be bound on `host`.
        """
        mechanism = mechanism_of(arm)
        self.port = free_port(host, port)
        with contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(host=host, port=self.port, verbose=False)
        self._host = host
        self._score = Score()
        self._lock = threading.Lock()
        self._numbers_due_s = 0.0
        self._segment_count = arm.segment_count
        server = self._server
        server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, brand_color=(86, 180, 233)
        )
        server.gui.set_panel_label("CableSense")
        _place_camera(server, mechanism)
        self._scene = ArmScene(server.scene, mechanism)
        if actions is not None:
            self._controls = Controls(server.gui, arm.segment_count, actions)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(320)
        dock = server.gui.add_panel()
        with dock.add_tab("Estimate", viser.Icon.TARGET_ARROW):
            self._numbers = [server.gui.add_html("") for _ in range(4)]
            reset = server.gui.add_button(
                "Reset the errors", icon=viser.Icon.REFRESH, color="gray"
            )
            reset.on_click(lambda _: self._reset_errors())
            self._numbers.append(server.gui.add_html(""))
            self._traces = TracePlot(server.gui, mechanism)
            server.gui.add_html(panel.traces_legend_html(arm.segment_count))
        dock.dock_left()
        dock.set_width(400)

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        host = "127.0.0.1" if self._host == "0.0.0.0" else self._host
        return f"http://{host}:{self.port}"

    def show(self, snapshot: Snapshot) -> None:
        """Draws one moment: the scene every time, numbers and traces a few times a second."""
        with self._lock:
            self._score.add(snapshot)
        if snapshot.tensions_n is not None:
            self._traces.buffer.add(snapshot.time_s, snapshot.tensions_n)
        if not self._server.get_clients():
            return
        scale_n = full_scale_n(self._traces.buffer.peak_n)
        with self._server.atomic():
            self._scene.pose(snapshot.joint_angles_rad)
            if snapshot.tensions_n is not None:
                self._scene.tensions(snapshot.tensions_n, scale_n)
            self._scene.forces(snapshot.true, snapshot.estimate)
        if time.monotonic() >= self._numbers_due_s:
            self._numbers_due_s = time.monotonic() + NUMBERS_EVERY_S
            self._show_numbers(snapshot, scale_n)

    def _reset_errors(self) -> None:
        with self._lock:
            self._score.reset()

    def notify(self, title: str, body: str) -> None:
        """Shows a note to everyone who looks at the page, for a few seconds."""
        for client in self._server.get_clients().values():
            client.add_notification(title, body, auto_close_seconds=5.0)

    def close(self) -> None:
        """Stops serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _show_numbers(self, snapshot: Snapshot, scale_n: float) -> None:
        with self._lock:
            errors = self._score.errors
        contents = (
            panel.status_html(snapshot.status),
            panel.forces_html(snapshot.true, snapshot.estimate),
            panel.probabilities_html(snapshot.probabilities, self._segment_count),
            panel.errors_html(errors),
            panel.legend_html(scale_n, snapshot.tensions_n),
        )
        for handle, content in zip(self._numbers, contents, strict=True):
            if handle.content != content:
                handle.content = content
        self._traces.draw()


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that can be bound on `host`.

    Raises:
        PageError: the host is not of this machine, or no port is free.
    """
    problem = ""
    for candidate in range(port, min(port + PORT_TRIES, 65_536)):
        try:
            with socket.create_server((host, candidate)):
                return candidate
        except OSError as error:
            problem = str(error)
    raise PageError(
        f"the page cannot be served on {host}, ports {port} to {port + PORT_TRIES - 1} "
        f"({problem}); give another --host or --port"
    )


def _place_camera(server: viser.ViserServer, mechanism: Mechanism) -> None:
    reach = float(mechanism.joint_position_straight_m[-1] + mechanism.segment_length_m[-1])
    server.initial_camera.position = (0.86 * reach, -1.66 * reach, 0.7 * reach)
    server.initial_camera.look_at = (0.5 * reach, 0.0, -0.04 * reach)
    server.initial_camera.fov = 0.75
    server.initial_camera.near = 0.01


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches `host`; a name other than localhost may lead anywhere."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def exposure_warning(host: str, port: int, controls: bool) -> str:
    """A warning that others reach a page served on `host`; empty if this machine alone does."""
    if is_loopback(host):
        return ""
    what = "see and move the arm" if controls else "see the arm"
    return (
        f"the page is served on {host}, port {port}, without a password: everyone who reaches "
        f"this machine can {what}"
    )
