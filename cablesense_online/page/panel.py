"""The page's panels: controls, status and numbers as HTML, and the tension traces."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
import viser

from cablesense_base import Array
from cablesense_msgs_py.messages import Level
from cablesense_online.page.drawing import (
    ESTIMATE_RGB,
    TENSION_GRADIENT_CSS,
    TRUE_RGB,
    css,
    segment_rgb,
)
from cablesense_online.page.live_arm import ShownStatus, Snapshot
from cablesense_online.page.score import Errors
from cablesense_sim.mechanism import Mechanism

JOINT_LIMIT_DEG = 20.0


@dataclass(frozen=True)
class Actions:
    """Requests of the page to the nodes, from any thread.

    Attributes:
        push: takes segment 1 … N, contact angle in degrees from the segment's +z towards its +y
            at the commanded pose, force in N, 0 N lets go, and whether other pushes stay.
        command: takes joint angles (2N,), rad.
        tare: takes a tare.
        undo_tare: goes back to the tare before.
        breathe: asks for a breath.
        choose_arm: takes the name of another arm, which is to be shown in place of this one.
        arms: names that it takes; without any there is no choice.
    """

    push: Callable[[int, float, float, bool], None]
    command: Callable[[Array], None]
    tare: Callable[[], None]
    undo_tare: Callable[[], None]
    breathe: Callable[[], None]
    choose_arm: Callable[[str], None] = lambda _: None
    arms: Sequence[str] = ()


class Controls:
    """Sliders and buttons in the main panel; what a person sets goes to `Actions`.

    A browser may send any number for a slider, which is brought into the slider's range, and any
    text for a segment, which does nothing unless it is one.

    Attributes:
        joints_deg: (2N,) the joint angles that were asked for last.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        mechanism: Mechanism,
        actions: Actions,
        joints_deg: Sequence[float],
        force_limit_n: float,
    ) -> None:
        """`joints_deg` (2N,) is where the joints' sliders begin."""
        self._actions = actions
        self._pushing = self._closed = False
        self._lock = threading.RLock()
        self.joints_deg = list(joints_deg)
        segments = [str(n) for n in range(1, mechanism.segment_count + 1)]
        with gui.add_folder("Push the arm"):
            self._segment = gui.add_dropdown("segment", segments, initial_value=segments[-1])
            self._angle = gui.add_slider(
                "angle, °", 0, 355, 5, 215, hint="direction of the force: 0° up, 90° to +y"
            )
            self._newtons = gui.add_slider(
                "force, N", 0.0, force_limit_n, force_limit_n / 200.0, 0.3 * force_limit_n
            )
            self._beside = gui.add_checkbox(
                "keep other pushes", False, hint="on other segments: several contacts at once"
            )
            self._button = gui.add_button("Push", color="orange", icon=viser.Icon.HAND_FINGER)
        limit_deg = joint_limit_deg(mechanism)
        with gui.add_folder("Move the joints", expand_by_default=True):
            self._joints = [
                gui.add_slider(
                    f"joint {1 + n // 2} {'yaw' if n % 2 else 'pitch'}, °",
                    min=-limit_deg,
                    max=limit_deg,
                    step=0.5,
                    initial_value=angle_deg,
                )
                for n, angle_deg in enumerate(joints_deg)
            ]
            home = gui.add_button("Home", icon=viser.Icon.HOME)
        with gui.add_folder("Estimator"):
            hint = "takes the present tensions as the unloaded state"
            tare = gui.add_button("Tare", icon=viser.Icon.SCALE, hint=hint)
            hint = "goes back to the tare before the last, after one under load"
            undo = gui.add_button(
                "Undo the tare", icon=viser.Icon.ARROW_BACK_UP, color="gray", hint=hint
            )
            hint = "moves the arm a little, so that friction shows what it hides"
            breathe = gui.add_button("Breathe", icon=viser.Icon.LUNGS, hint=hint)
        if actions.arms:
            hint = "starts the demo again with another arm"
            arms = gui.add_dropdown("arm", actions.arms, initial_value=actions.arms[0], hint=hint)
            arms.on_update(
                self._act(
                    lambda _: (
                        actions.choose_arm(arms.value) if arms.value in actions.arms[1:] else None
                    )
                )
            )
        self._button.on_click(self._act(lambda _: self._toggle()))
        for handle in (self._segment, self._angle, self._newtons):
            handle.on_update(self._act(lambda _: self._send_push() if self._pushing else None))
        for joint in self._joints:
            joint.on_update(
                self._act(lambda event: self._send_command() if event.client else None)
            )
        home.on_click(self._act(lambda _: self._go_home()))
        tare.on_click(self._act(lambda _: actions.tare()))
        undo.on_click(self._act(lambda _: actions.undo_tare()))
        breathe.on_click(self._act(lambda _: actions.breathe()))

    def close(self) -> None:
        """Let go of the arm; nothing that is still under way from the browser does anything."""
        with self._lock:
            self._closed = True
            if self._pushing:
                self._actions.push(1, 0.0, 0.0, False)

    def _act(self, handle: Callable[[Any], None]) -> Callable[[Any], None]:
        """One at a time, as viser calls from many threads, and none after `close`."""

        def act(event: Any) -> None:
            with self._lock:
                if not self._closed:
                    handle(event)

        return act

    def _toggle(self) -> None:
        self._pushing = not self._pushing
        self._button.label = "Release" if self._pushing else "Push"
        self._button.color = "gray" if self._pushing else "orange"
        self._send_push()

    def _send_push(self) -> None:
        """The push as the sliders stand; 0 N unless the button is down."""
        if self._segment.value not in self._segment.options:
            return
        force_n = _within(self._newtons) if self._pushing else 0.0
        beside = self._pushing and bool(self._beside.value)
        self._actions.push(int(self._segment.value), _within(self._angle), force_n, beside)

    def _send_command(self) -> None:
        self.joints_deg = [_within(joint) for joint in self._joints]
        self._actions.command(np.deg2rad(self.joints_deg))

    def _go_home(self) -> None:
        for joint in self._joints:
            joint.value = 0.0  # type: ignore[misc]  # mypy takes viser's setter for none
        self._send_command()


def _within(slider: viser.GuiSliderHandle[Any]) -> float:
    """The slider's value, brought into its range where a browser sent one outside."""
    value = float(min(max(slider.value, slider.min), slider.max))
    slider.value = value  # type: ignore[misc]
    return value


def joint_limit_deg(mechanism: Mechanism) -> float:
    """How far sliders turn: no guide plates touch, even with both axes of a joint so far."""
    bend_rad = float(mechanism.bend_limit_rad.min())
    both_deg = math.degrees(math.acos(math.sqrt(max(0.0, math.cos(bend_rad)))))
    return min(JOINT_LIMIT_DEG, math.ceil(2.0 * both_deg) / 2.0 - 0.5)


_GREY = "#8a93a3"
_LEVEL_CSS = {
    Level.OK: "#00b280",
    Level.WARN: "#f0a832",
    Level.ERROR: "#e8604c",
    Level.STALE: _GREY,
}


def style_html() -> str:
    """The style of the panels, once for the page."""
    text = files("cablesense_online.page").joinpath("panel.css").read_text(encoding="utf-8")
    return f"<style>{text}</style>"


def _panel(content: str) -> str:
    return f"<div class='cablesense'>{content}</div>"


def visitors_html(visitor: int, commander: int, count: int) -> str:
    """Who of `count` visitors commands; visitors are numbered from 1 as they come."""
    if visitor == commander:
        others = {1: "nobody else watches", 2: "one other watches"}
        text = f"<b>You command the arm</b>, {others.get(count, f'{count - 1} others watch')}."
    else:
        text = (
            f"<b>Visitor {commander} commands the arm</b>; you are visitor {visitor} and watch. "
            "When those before you leave, the controls are yours."
        )
    return _panel(f"<div id='cablesense-visitors'>{text}</div>")


def status_html(status: ShownStatus) -> str:
    """The estimator's state as a coloured badge with its notes."""
    notes = "".join(f"<div class='note'>{escape(note)}</div>" for note in status.notes)
    return _panel(
        f"<span class='level' style='background:{_LEVEL_CSS[status.level]}'></span>"
        f"<b id='cablesense-status'>{escape(status.headline)}</b>{notes}"
    )


def forces_html(snapshot: Snapshot) -> str:
    """True and estimated contact, one below the other, and the stated 95 % interval."""
    rows = "<tr class='small'><td></td><td>segment</td><td>angle</td><td>force</td></tr>"
    none = "<td>none</td><td class='dim'>–</td><td class='dim'>0.0 N</td>"
    unknown = "<td>no answer</td><td class='dim'>–</td><td class='dim'>–</td>"
    for name, rgb, contacts, otherwise in (
        ("true", TRUE_RGB, snapshot.all_true, none),
        (
            "estimated",
            ESTIMATE_RGB,
            snapshot.all_estimated,
            none if snapshot.state.known else unknown,
        ),
    ):
        cells = [
            f"<td>{contact.segment}</td><td>{contact.angle_deg:.1f}°</td>"
            f"<td>{force_text(contact.magnitude_n)}</td>"
            for contact in contacts
        ]
        first, *more = cells or [otherwise]
        title = f"<td class='force' style='color:{css(rgb)}'>▶ {name}</td>"
        rows += f"<tr id='cablesense-{name}'>{title}{first}</tr>"
        rows += "".join(f"<tr class='more'><td></td>{cells}</tr>" for cells in more)
    angles = forces = "–"
    if (bounds := snapshot.bounds) is not None:
        forces = f"{bounds.low_n:.2f} to {force_text(bounds.high_n, 2)}"
        if bounds.angles_deg is not None:
            angles = "{:.1f} to {:.1f}°".format(*bounds.angles_deg)
        elif snapshot.estimate is not None:
            angles = "any"
    for what, ends in (("direction", angles), ("force", forces)):
        interval = f"<td colspan='2'>95 % of the {what}</td><td colspan='2'>{ends}</td>"
        rows += f"<tr class='small'>{interval}</tr>"
    return _panel(f"<table>{rows}</table>")


def force_text(force_n: float, digits: int = 1) -> str:
    """A force with its unit; forces below 10 N have a digit more."""
    return f"{force_n:.{digits + (digits < 2 and force_n < 9.95)}f} N"


def probabilities_html(probabilities: Array | None, segment_count: int) -> str:
    """One bar for no contact and one for each segment."""
    content = "<div class='small'>contact probability</div>"
    for segment in range(segment_count + 1):
        name = f"segment {segment}" if segment else "no contact"
        colour = css(segment_rgb(segment)) if segment else _GREY
        percent = None if probabilities is None else 100.0 * float(probabilities[segment])
        content += (
            f"<div class='probability'><span>{name}</span><span class='bar'>"
            f"<span style='width:{percent or 0.0:.1f}%;background:{colour}'></span></span>"
            f"<span>{'–' if percent is None else f'{percent:.1f} %'}</span></div>"
        )
    return _panel(content)


def errors_html(errors: Errors) -> str:
    """Mean errors so far, missed contacts and wrong segments among them."""
    right = None if errors.segment_right is None else 100.0 * errors.segment_right
    cells = "".join(
        f"<div><div class='small'>{name}</div>"
        f"<b>{'–' if value is None else text.format(value)}</b></div>"
        for name, value, text in (
            ("segment right", right, "{:.1f} %"),
            ("direction error", errors.angle_mae_deg, "{:.2f}°"),
            ("force error", errors.magnitude_mae_n, "{:.2f} N"),
        )
    )
    count = f"mean over {errors.count} moments at rest"
    if errors.unanswered:
        count += f", {100.0 * errors.unanswered:.1f} % more had no answer"
    count = f"<div class='small'>{count}</div>"
    return _panel(f"<div class='errors'>{cells}</div>{count}")


def legend_html(full_scale_n: float, tensions_n: Array | None) -> str:
    """The colours of the cables, from slack to full scale, with the range at this moment."""
    now = ""
    if tensions_n is not None:
        now = f"now {round(float(tensions_n.min()))} to {round(float(tensions_n.max()))} N"
    return _panel(
        f"<div class='ends'><span>cable tension</span><span class='dim'>{now}</span></div>"
        f"<div class='scale' style='background:{TENSION_GRADIENT_CSS}'></div>"
        f"<div class='ends small'><span>0 N (slack)</span><span>{full_scale_n / 2:.0f} N</span>"
        f"<span>{full_scale_n:.0f} N</span></div>"
    )


def traces_legend_html(segment_count: int) -> str:
    """The legend of the traces: a colour for each segment that a cable ends on."""
    marks = " ".join(
        f"<span class='trace'><b style='color:{css(segment_rgb(n))}'>━</b> ends on segment {n}"
        "</span>"
        for n in range(1, segment_count + 1)
    )
    return _panel(f"<div class='small'>{marks}</div>")
