"""The page as a whole: one web server with the 3D scene, the figures, traces and controls."""

from __future__ import annotations

import contextlib
import io
import secrets
import threading
import time
from collections.abc import Mapping

import numpy as np
import viser

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_online.page.arrows import ArrowScale
from cablesense_online.page.colours import full_scale_n
from cablesense_online.page.controls import Actions, Controls
from cablesense_online.page.figures import html
from cablesense_online.page.guard import free_port, guarded_server, present_visitor
from cablesense_online.page.scene import VIEW_ANGLE_RAD, MachineScene, Mouse, view
from cablesense_online.page.score import Score
from cablesense_online.page.shown import ReadingPanel, ShownMachine
from cablesense_online.page.snapshot import Snapshot
from cablesense_online.page.traces import ForceTrace, ReadingTrace, reading_lines

_FIGURES_EVERY_S = 0.15
"""Pace of figures on the page: faster ones cannot be read."""
_NOTE_S = 5.0
"""How long a notification is shown."""
_OTHER_SHAPE = 0.1
"""A window whose ratio of width and height changes by more than this share has another shape."""


_RETURN_S = 10.0
"""How long the controls wait for a visitor who commanded and has left: a reload takes less."""
_WIDE = 1.6
"""Width over height of a window whose height alone bounds the view."""
_SAME_VIEW = 1e-3
"""Two cameras closer than this share of the machine's size are at one place."""
_TENSION = "tension"
"""The quantity by which cables are coloured."""


class _ReadingFigures:
    """One panel of readings: their chart, and their numbers below it."""

    def __init__(self, gui: viser.GuiApi, panel: ReadingPanel) -> None:
        self.panel = panel
        self._lines = reading_lines(panel)
        self._channels = list(panel.channels)
        self.trace = ReadingTrace(gui, panel, self._lines)
        self._numbers = gui.add_html("")

    def add(self, time_s: float, readings: Array) -> None:
        """Keeps the readings (M,) of all channels at an instant."""
        self.trace.buffer.add(time_s, readings[self._channels])

    def values(self, readings: Array | None) -> Array | None:
        """Those of this panel among the readings (M,) of all channels."""
        return None if readings is None else readings[self._channels]

    def draw(self, readings: Array | None) -> None:
        """Shows what has been kept, and these numbers (M,)."""
        values = self.values(readings)
        scale = self.full_scale()
        self._numbers.content = html("readings", self.panel, self._lines, values, scale)
        self.trace.draw()

    def full_scale(self) -> float:
        """The round reading, in the panel's unit, that covers all that are shown."""
        return full_scale_n(self.trace.buffer.peak, self.panel.least)


class Page:
    """A live view of a machine, served until `close` to those who have its `url`.

    The visitor who has been there longest commands, the others watch. One who commanded and comes
    back soon, as by a reload, commands again.

    The `url` has the token without which a browser is refused.
    """

    def __init__(
        self,
        shown: ShownMachine,
        actions: Actions | None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        """Starts serving; without `actions` the page only shows."""
        self._shown = shown
        self._actions = actions
        token = secrets.token_urlsafe(16)  # for nobody to guess
        self._server = guarded_server(host, free_port(host, port), token)
        server = self._server
        self.port = server.get_port()
        reached = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        self.url = f"http://{f'[{reached}]' if ':' in reached else reached}:{self.port}/{token}/"
        self._lock = threading.Lock()
        self._score = Score(shown.felt.felt_across)
        self._figures_due_s = 0.0
        self._commander = -1
        self._commander_name = ""
        self._kept_until_s = 0.0  # 0 where nobody is awaited
        self._names: dict[int, str] = {}
        self._controls: Controls | None = None
        self._command_values = [slider.home for slider in shown.sliders]
        self._visitors: dict[int, viser.GuiHtmlHandle] = {}
        scale = ArrowScale(shown.extent.size_m, shown.strongest_n)
        mouse = Mouse(self._touch, self._pull) if actions else None
        self._scene = MachineScene(server.scene, shown, scale, mouse)
        # where "Reset View" of the viewer's menu leads
        server.initial_camera.position, server.initial_camera.look_at = view(shown.extent, _WIDE)
        self._lay_out()
        server.on_client_connect(self._follow_view)
        if actions is not None:
            server.on_client_connect(self._note_name)
            server.on_client_connect(self._assign_controls)
            server.on_client_disconnect(self._assign_controls)

    def _lay_out(self) -> None:
        """The figures on the left, the controls on the right; on a phone all in one sheet."""
        gui = self._server.gui
        gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, brand_color=(86, 180, 233)
        )
        gui.set_panel_label("CableSense")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(270)
        self._summary = gui.add_html("")
        home = gui.add_button(
            "Home view",
            icon=viser.Icon.FOCUS_CENTERED,
            color="gray",
            hint=f"shows the whole {self._shown.words.machine} again",
        )
        home.on_click(self._go_to_home_view)
        dock = gui.add_panel()
        with dock.add_tab("Estimate", viser.Icon.TARGET_ARROW):
            self._estimate = gui.add_html("")
            self._forces = ForceTrace(gui, 0.1 * self._shown.strongest_n)
            self._figures = gui.add_html("")
            reset = gui.add_button("Reset the errors", icon=viser.Icon.REFRESH, color="gray")
            reset.on_click(lambda _: self._reset_errors())
            has_cables = any(panel.quantity == _TENSION for panel in self._shown.panels)
            self._legend = gui.add_html("") if has_cables else None
            self._readings = [_ReadingFigures(gui, panel) for panel in self._shown.panels]
            gui.add_html(html("style"))
        dock.dock_left()
        dock.set_width(390)
        dock.expand()

    def _follow_view(self, client: viser.ClientHandle) -> None:
        """Shows the whole machine in a window of any shape.

        Again where the shape changes, and where the viewer's own reset has led to the view of a
        wide window.
        """
        camera = client.camera
        wide_m = view(self._shown.extent, _WIDE)[0]
        fitted = 0.0

        def fit(_: viser.CameraHandle) -> None:
            nonlocal fitted
            same_shape = abs(camera.aspect - fitted) <= _OTHER_SHAPE * fitted
            home_m = view(self._shown.extent, camera.aspect)[0]
            off_m = np.abs(np.asarray(camera.position) - wide_m).max()
            was_reset = off_m < _SAME_VIEW * self._shown.extent.size_m
            if same_shape and (not was_reset or np.allclose(home_m, wide_m)):
                return
            fitted = camera.aspect
            self._show_all(client)

        fit(camera)
        camera.on_update(fit)

    def _show_all(self, client: viser.ClientHandle) -> None:
        camera = client.camera
        with client.atomic():
            camera.near = 0.02 * self._shown.extent.size_m
            camera.fov = VIEW_ANGLE_RAD
            camera.position, camera.look_at = view(self._shown.extent, camera.aspect)

    def _go_to_home_view(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client is not None:
            self._show_all(event.client)

    async def _note_name(self, client: viser.ClientHandle) -> None:
        """Not in a thread, where the visitor would not be known."""
        self._names[client.client_id] = present_visitor.get()

    def _assign_controls(self, _: object = None) -> None:
        """Gives the controls to who has been there longest, and shows everyone who that is.

        Controls are of one browser alone: what others send finds none.
        """
        assert self._actions is not None
        with self._lock:
            clients = self._server.get_clients()
            for number in clients.keys() - self._visitors.keys():
                self._visitors[number] = clients[number].gui.add_html("")
            for number in self._visitors.keys() - clients.keys():
                del self._visitors[number]
                self._names.pop(number, None)
            if self._commander not in clients and self._controls is not None:
                self._controls.close()
                self._controls = None
                if self._commander_name:
                    self._kept_until_s = time.monotonic() + _RETURN_S
            if self._controls is None:
                self._choose_commander(clients)
            kept = self._controls is None
            for number, shown in self._visitors.items():
                commands = number == self._commander
                shown.content = html("visitors", commands, len(clients), kept, self._shown.words)

    def _choose_commander(self, clients: Mapping[int, viser.ClientHandle]) -> None:
        """Gives the controls to who commanded before, and to another once that one stays away."""
        assert self._actions is not None
        returned = [
            number
            for number in clients
            if self._commander_name and self._names.get(number) == self._commander_name
        ]
        kept = time.monotonic() < self._kept_until_s
        candidates = returned if returned or kept else list(clients)
        if not candidates:
            return
        self._kept_until_s = 0.0
        self._commander = min(candidates)
        self._commander_name = self._names.get(self._commander, "")
        with clients[self._commander].atomic():  # shown once a click is heard
            self._controls = Controls(
                clients[self._commander].gui, self._shown, self._actions, self._command_values
            )

    def _touch(self, client: int, link: int, place_m: float) -> None:
        """Somebody clicked on the machine; who commands sets where to push by it."""
        with self._lock:
            if self._controls is not None and client == self._commander:
                self._controls.touch(link, place_m)

    def _pull(self, client: int, contact: Contact | None) -> None:
        """Somebody drags the machine with the mouse; who commands pulls it."""
        with self._lock:
            if self._controls is not None and client == self._commander:
                self._controls.pull(contact)

    def _reset_errors(self) -> None:
        with self._lock:
            self._score.reset()

    def show(self, snapshot: Snapshot) -> None:
        """Draws one instant: the scene every time, figures and traces a few times a second."""
        with self._lock:
            self._score.add(snapshot)
        if snapshot.readings is not None:
            for figures in self._readings:
                figures.add(snapshot.time_s, snapshot.readings)
            self._forces.add(snapshot)
        if not self._server.get_clients():
            return
        if 0.0 < self._kept_until_s < time.monotonic():
            self._assign_controls()
        scale_n = self._readings[0].full_scale()
        with self._server.atomic():
            self._scene.show(snapshot, scale_n)
        if time.monotonic() < self._figures_due_s:
            return
        self._figures_due_s = time.monotonic() + _FIGURES_EVERY_S
        with self._lock:
            errors = self._score.errors
            if self._controls is not None:
                self._controls.offer()
        words = self._shown.words
        estimate = html("estimate", snapshot, words)
        self._summary.content = f"<div class='cablesense-narrow'>{estimate}</div>"
        self._estimate.content = estimate
        self._figures.content = html("figures", snapshot.probabilities, errors, words)
        if self._legend is not None:
            tensions_n = self._readings[0].values(snapshot.readings)
            self._legend.content = html("legend", scale_n, tensions_n)
        for figures in self._readings:
            figures.draw(snapshot.readings)
        self._forces.draw()

    def notify(self, title: str, body: str) -> None:
        """Shows a note to everyone who looks at the page, for some seconds."""
        for client in self._server.get_clients().values():
            client.add_notification(title, body, auto_close_seconds=_NOTE_S)

    def close(self) -> None:
        """Stops serving."""
        with contextlib.redirect_stdout(io.StringIO()):  # viser says so
            self._server.stop()
