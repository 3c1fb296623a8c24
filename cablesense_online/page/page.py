"""The page as a whole: one web server with the 3D scene, the numbers, traces and controls."""

from __future__ import annotations

import contextlib
import io
import ipaddress
import secrets
import socket
import threading
import time

import numpy as np
import viser

from cablesense_base import Array
from cablesense_online.page import drawing, panel
from cablesense_online.page.guard import PageError, guarded_server
from cablesense_online.page.live_arm import Snapshot
from cablesense_online.page.panel import Actions, Controls
from cablesense_online.page.scene import ArmScene
from cablesense_online.page.score import Score
from cablesense_online.page.traces import ForcePlot, TensionPlot
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.load_capacity import contact_range_n
from cablesense_sim.mechanism import Mechanism

_NUMBERS_EVERY_S = 0.15
_PORT_TRIES = 20
_USUAL_ASPECT = 0.9
"""Width over height of the scene between the panels, until a browser says."""


class Page:
    """A live view of an arm, served until `close` to those who have its `url`.

    The visitor who has been there longest commands, the others watch.

    Attributes:
        port: that is served on.
        url: where a browser finds the page; with the token, without which it is refused.
    """

    def __init__(
        self,
        arm: Arm,
        actions: Actions | None,
        host: str = "127.0.0.1",
        port: int = 8080,
        token: str = "",
    ) -> None:
        """Starts serving; without `actions` the page only shows, without `token` it makes one.

        Raises:
            PageError: no port from `port` on can be bound on `host`, or viser cannot be guarded.
        """
        mechanism = mechanism_of(arm)
        self._force_limit_n = contact_range_n(arm)
        token = token or new_token()
        self._server = guarded_server(host, free_port(host, port), token)
        self.port = self._server.get_port()
        shown = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        self.url = f"http://{f'[{shown}]' if ':' in shown else shown}:{self.port}/{token}/"
        self._score = Score()
        self._lock = threading.Lock()
        self._numbers_due_s = 0.0
        self._segment_count = arm.segment_count
        server = self._server
        server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, brand_color=(86, 180, 233)
        )
        server.gui.set_panel_label("CableSense")
        self._reach_m = float(
            mechanism.joint_position_straight_m[-1] + mechanism.segment_length_m[-1]
        )
        server.initial_camera.position, server.initial_camera.look_at = drawing.view(
            self._reach_m, _USUAL_ASPECT
        )
        server.initial_camera.fov = drawing.VIEW_ANGLE_RAD
        server.initial_camera.near = 0.01
        server.on_client_connect(self._fit_view)
        self._scene = ArmScene(server.scene, mechanism)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(270)
        self._numbers = [server.gui.add_html("")]
        dock = server.gui.add_panel()
        with dock.add_tab("Estimate", viser.Icon.TARGET_ARROW):
            self._numbers.append(server.gui.add_html(""))
            self._forces = ForcePlot(server.gui, 0.1 * self._force_limit_n)
            self._numbers += [server.gui.add_html("") for _ in range(2)]
            reset = server.gui.add_button(
                "Reset the errors", icon=viser.Icon.REFRESH, color="gray"
            )
            reset.on_click(lambda _: self._reset_errors())
            self._numbers.append(server.gui.add_html(""))
            self._tensions = TensionPlot(server.gui, mechanism)
            legend = panel.traces_legend_html(arm.segment_count)
            server.gui.add_html(panel.style_html() + legend)
        dock.dock_left()
        dock.set_width(350)
        dock.expand()
        self._controls: Controls | None = None
        self._joints_deg = [0.0] * mechanism.joint_count
        self._commander = -1
        self._visitors: dict[int, viser.GuiHtmlHandle] = {}
        if actions is not None:
            for on_change in (server.on_client_connect, server.on_client_disconnect):
                on_change(lambda _: self._assign_controls(mechanism, actions))

    def show(self, snapshot: Snapshot) -> None:
        """Draws one moment: the scene every time, numbers and traces a few times a second."""
        with self._lock:
            self._score.add(snapshot)
        if snapshot.tensions_n is not None:
            self._tensions.buffer.add(snapshot.time_s, snapshot.tensions_n)
            self._forces.add(snapshot)
        if not self._server.get_clients():
            return
        scale_n = drawing.full_scale_n(self._tensions.buffer.peak)
        with self._server.atomic():
            self._scene.pose(snapshot.joint_angles_rad)
            if snapshot.tensions_n is not None:
                self._scene.tensions(snapshot.tensions_n, scale_n)
            self._scene.forces(snapshot.all_true, snapshot.all_estimated)
            self._scene.interval(snapshot.estimate, snapshot.bounds)
        if time.monotonic() >= self._numbers_due_s:
            self._numbers_due_s = time.monotonic() + _NUMBERS_EVERY_S
            self._show_numbers(snapshot, scale_n)

    def _assign_controls(self, mechanism: Mechanism, actions: Actions) -> None:
        """Gives the controls to who has been there longest, and shows everyone who that is.

        Controls are of one browser alone: what others send finds none.
        """
        with self._lock:
            clients = self._server.get_clients()
            self._visitors = {
                number: self._visitors.get(number) or client.gui.add_html("")
                for number, client in clients.items()
            }
            if self._commander not in clients and self._controls is not None:
                self._controls.close()
                self._joints_deg = self._controls.joints_deg
                self._controls = None
            if self._controls is None and clients:
                self._commander = min(clients)
                gui = clients[self._commander].gui
                self._controls = Controls(
                    gui, mechanism, actions, self._joints_deg, self._force_limit_n
                )
            for number, shown in self._visitors.items():
                shown.content = panel.visitors_html(number + 1, self._commander + 1, len(clients))

    def _reset_errors(self) -> None:
        with self._lock:
            self._score.reset()

    def _fit_view(self, client: viser.ClientHandle) -> None:
        """Shows the whole arm in a window of any shape, until the visitor turns it."""
        camera = client.camera
        put: list[Array] = [np.asarray(self._server.initial_camera.position)]

        def fit(_: object = None) -> None:
            turned = np.abs(camera.position - put[0]).max() > 1e-3 * self._reach_m
            position, look_at = drawing.view(self._reach_m, camera.aspect)
            if turned or np.abs(position - put[0]).max() < 1e-3 * self._reach_m:
                return
            put[0] = position
            with client.atomic():
                camera.position = position
                camera.look_at = look_at

        camera.on_update(fit)
        fit()

    def notify(self, title: str, body: str, *, warning: bool = False) -> None:
        """Shows a note to everyone who looks at the page; a warning until it is closed."""
        for client in self._server.get_clients().values():
            client.add_notification(
                title,
                body,
                auto_close_seconds=None if warning else 5.0,
                color="yellow" if warning else None,
            )

    def close(self) -> None:
        """Stops serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _show_numbers(self, snapshot: Snapshot, scale_n: float) -> None:
        with self._lock:
            errors = self._score.errors
        state = panel.status_html(snapshot.status) + panel.forces_html(snapshot)
        shown = (
            f"<div class='cablesense-narrow'>{state}</div>",
            state,
            panel.probabilities_html(snapshot.probabilities, self._segment_count),
            panel.errors_html(errors),
            panel.legend_html(scale_n, snapshot.tensions_n),
        )
        for handle, content in zip(self._numbers, shown, strict=True):
            if handle.content != content:
                handle.content = content
        self._forces.draw()
        self._tensions.draw()


def new_token() -> str:
    """What the address of a page ends in, for nobody to guess."""
    return secrets.token_urlsafe(16)


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that can be bound on `host`.

    Raises:
        PageError: the host is not of this machine, or no port is free.
    """
    problem = ""
    for candidate in range(port, min(port + _PORT_TRIES, 65_536)):
        try:
            with socket.create_server((host, candidate)):
                return candidate
        except OSError as error:
            problem = str(error)
    raise PageError(
        f"the page cannot be served on {host}, ports {port} to {port + _PORT_TRIES - 1} "
        f"({problem}); give another --host or --port"
    )


def exposure_warning(host: str, port: int, controls: bool) -> str:
    """A warning that others reach a page served on `host`; empty if this machine alone does."""
    with contextlib.suppress(ValueError):  # a name other than localhost may lead anywhere
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return ""
    what = "see and move the arm" if controls else "see the arm"
    return (
        f"the page is served on {host}, port {port}, without encryption: whoever is given its "
        f"address, or listens in on the way, can {what}"
    )
