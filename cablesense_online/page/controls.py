"""The page's controls: sliders and buttons by which a person pushes, moves and tares."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from cablesense_base import Array
from cablesense_msgs_py.messages import NO_CONTACT, Contact
from cablesense_online.page.shown import ShownMachine

_FORCE_STEPS = 200
"""Of the sliders of forces, up to the largest."""
_FIRST_PUSH = 0.3
"""Where the slider of the force begins, as a share of the largest."""
_ALONG_SHARE = 0.5
"""Largest force along a link, as a share of the largest across it."""


@dataclass(frozen=True)
class Actions:
    """Requests of the page to the nodes, from any thread.

    Attributes:
        push: takes a contact, which lets go where its forces are zero, and whether other pushes
            stay.
        command: takes a command (C,).
        tare: takes a tare.
        undo_tare: goes back to the tare before.
        breathe: asks for a breath.
        can_breathe: whether a breather answers; the button is shown where one does.
        commission: asks for a commissioning.
        can_commission: likewise, whether a commissioner answers.
    """

    push: Callable[[Contact, bool], None]
    command: Callable[[Array], None]
    tare: Callable[[], None]
    undo_tare: Callable[[], None]
    breathe: Callable[[], None]
    can_breathe: Callable[[], bool]
    commission: Callable[[], None]
    can_commission: Callable[[], bool]


class Controls:
    """Sliders and buttons in the main panel; what a person sets goes to `Actions`.

    A browser may send any number for a slider, which is brought into the slider's range, and any
    text for a link, which does nothing unless it is one.
    """

    def __init__(
        self, gui: viser.GuiApi, shown: ShownMachine, actions: Actions, command_values: list[float]
    ) -> None:
        """`command_values` (C,) is where the commands' sliders begin; it is kept up to date."""
        self._actions = actions
        self._sliders = shown.sliders
        self._command_values = command_values
        self._words = shown.words
        self._touched_m = shown.touched_m
        self._friction = shown.felt.surface_friction
        self._pushing = False
        self._pulled = False
        self._closed = False
        self._lock = threading.RLock()
        links = list(self._words.links)
        strongest_n = shown.strongest_n
        along_n = _ALONG_SHARE * strongest_n
        step_n = strongest_n / _FORCE_STEPS
        with gui.add_folder(f"Push the {self._words.machine}"):
            self._link = gui.add_dropdown(self._words.link, links, initial_value=links[-1])
            nearest_mm = 1e3 * self._touched_m.min()
            farthest_mm = 1e3 * self._touched_m.max()
            self._place = gui.add_slider(
                "place, mm",
                *(nearest_mm, farthest_mm, 1.0),
                float(np.clip(round(1e3 * shown.usual_m[-1]), nearest_mm, farthest_mm)),
                hint=f"along the {self._words.link}; a click on it sets it, too",
            )
            self._angle = gui.add_slider(
                "angle, °",
                0,
                355,
                5,
                215,
                hint="direction of the force: 0° to the link's z, 90° to y",
            )
            self._newtons = gui.add_slider(
                "force, N", 0.0, strongest_n, step_n, _FIRST_PUSH * strongest_n
            )
            self._along = gui.add_slider(
                "along, N",
                *(-along_n, along_n, step_n, 0.0),
                hint=f"force along the {self._words.link}, towards its end",
            )
            self._beside = gui.add_checkbox(
                "keep other pushes",
                False,
                hint=f"on other {self._words.link}s: several contacts at once",
            )
            self._button = gui.add_button("Push", color="orange", icon=viser.Icon.HAND_FINGER)
        with gui.add_folder("Move the joints", expand_by_default=True):
            self._joints = [
                gui.add_slider(slider.label, slider.lowest, slider.highest, slider.step, value)
                for slider, value in zip(self._sliders, command_values, strict=True)
            ]
            home = gui.add_button("Home", icon=viser.Icon.HOME)
        with gui.add_folder("Estimator"):
            hint = "takes the present tensions as the unloaded state"
            tare = gui.add_button("Tare", icon=viser.Icon.SCALE, hint=hint)
            hint = "goes back to the tare before the last, after one under load"
            undo = gui.add_button(
                "Undo the tare", icon=viser.Icon.ARROW_BACK_UP, color="gray", hint=hint
            )
            hint = "moves the machine a little, so that friction hides no force"
            self._breathe = gui.add_button(
                "Breathe", icon=viser.Icon.LUNGS, hint=hint, visible=actions.can_breathe()
            )
            hint = "visits some poses untouched, to learn how it was built"
            self._commission = gui.add_button(
                "Commission", icon=viser.Icon.ROUTE, hint=hint, visible=actions.can_commission()
            )
        for joint in self._joints:
            self._on(joint.on_update, self._send_command)
        for handle in (self._link, self._place, self._angle, self._newtons, self._along):
            self._on(handle.on_update, self._send_push)
        for button, act in (
            (self._button, self._toggle),
            (home, self._go_home),
            (tare, actions.tare),
            (undo, actions.undo_tare),
            (self._breathe, actions.breathe),
            (self._commission, actions.commission),
        ):
            self._on(button.on_click, act)

    def close(self) -> None:
        """Let go of the machine; nothing that is still on its way here does anything."""
        with self._lock:
            self._closed = True
            if self._pushing or self._pulled:
                self._actions.push(NO_CONTACT, False)

    def offer(self) -> None:
        """Show the buttons of those who answer, and hide the others."""
        offers = (
            (self._breathe, self._actions.can_breathe()),
            (self._commission, self._actions.can_commission()),
        )
        for button, offered in offers:
            if button.visible != offered:
                button.visible = offered

    def touch(self, link: int, place_m: float) -> None:
        """Choose where to push: link 1 … N and the place nearest to `place_m` in its reach."""
        with self._lock:
            if not self._closed:
                within_m = float(np.clip(place_m, *self._touched_m[link - 1]))
                label = self._words.links[link - 1]
                self._link.value = label  # type: ignore[misc]  # as in `_go_home`
                self._place.value = round(1e3 * within_m)  # type: ignore[misc]
                self._send_push()

    def pull(self, contact: Contact | None) -> None:
        """Push as a drag on the machine says, until None ends it.

        The force is brought into the sliders' ranges; along the link it is at most what
        friction carries. The sliders show it. A push of the button goes on after the drag.
        """
        with self._lock:
            if self._closed:
                return
            if contact is None:
                self._pulled = False
                self._send_push(released=not self._pushing)
                return
            self._pulled = True
            within_m = float(np.clip(contact.contact_m, *self._touched_m[contact.segment - 1]))
            newtons = min(contact.magnitude_n, self._newtons.max)
            carried_n = self._friction * newtons if self._friction else math.inf
            most_n = min(carried_n, self._along.max)
            along_n = min(max(contact.along_n, -most_n), most_n)
            pull = contact._replace(contact_m=within_m, magnitude_n=newtons, along_n=along_n)
            self._show_push(pull)
            self._actions.push(pull, bool(self._beside.value))

    def _show_push(self, push: Contact) -> None:
        """Sets the sliders to a push, as near as their steps allow."""
        step_deg = self._angle.step
        label = self._words.links[push.segment - 1]
        self._link.value = label  # type: ignore[misc]  # as in `_go_home`
        for slider, value in (
            (self._place, 1e3 * push.contact_m),
            (self._angle, step_deg * round(push.angle_deg / step_deg) % 360),
            (self._newtons, push.magnitude_n),
            (self._along, push.along_n),
        ):
            steps = round((value - slider.min) / slider.step)
            shown = slider.min + steps * slider.step
            if slider.value != shown:
                slider.value = shown  # type: ignore[misc]

    def _on(self, register: Callable[[Any], object], act: Callable[[], object]) -> None:
        """Lets a browser act: one thing at a time, as viser calls from many threads."""

        def heard(event: Any) -> None:
            with self._lock:
                if event.client is not None and not self._closed:
                    act()

        register(heard)

    def _toggle(self) -> None:
        self._pushing = not self._pushing
        self._button.label = "Release" if self._pushing else "Push"
        self._button.color = "gray" if self._pushing else "orange"
        self._send_push(released=not self._pushing)

    def _send_push(self, released: bool = False) -> None:
        """The push as the sliders stand, while the button is down; 0 N once it is released."""
        if released:
            self._actions.push(NO_CONTACT, False)
        elif self._pushing and self._link.value in self._link.options:
            segment = 1 + self._words.links.index(self._link.value)
            place_m = float(np.clip(1e-3 * _within(self._place), *self._touched_m[segment - 1]))
            force_n = _within(self._newtons)
            along_n = _within(self._along)
            contact = Contact(segment, _within(self._angle), force_n, place_m, along_n)
            self._actions.push(contact, bool(self._beside.value))

    def _send_command(self) -> None:
        self._command_values[:] = [_within(joint) for joint in self._joints]
        per_unit = np.array([slider.per_unit for slider in self._sliders])
        self._actions.command(np.array(self._command_values) / per_unit)

    def _go_home(self) -> None:
        for joint, slider in zip(self._joints, self._sliders, strict=True):
            joint.value = slider.home  # type: ignore[misc]  # mypy takes viser's setter for none
        self._send_command()


def _within(slider: viser.GuiSliderHandle[Any]) -> float:
    """The slider's value, brought into its range where a browser sent one outside."""
    value = float(min(max(slider.value, slider.min), slider.max))
    slider.value = value  # type: ignore[misc]
    return value
