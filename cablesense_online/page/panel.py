"""The page's panels: the controls, the figures as HTML, and the traces of the last seconds."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, NamedTuple

import jinja2
import numpy as np
import viser

from cablesense_base import Array
from cablesense_msgs_py.messages import NO_CONTACT, Contact, ForceState, Level
from cablesense_online.page.snapshot import (
    ESTIMATE_RGB,
    TENSION_CSS,
    TRUE_RGB,
    PlaceInterval,
    Snapshot,
    css,
    segment_rgb,
)
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.touch import TouchedPlaces

JOINT_LIMIT_DEG = 20.0
"""Largest angle that the sliders offer."""


@dataclass(frozen=True)
class Actions:
    """Requests of the page to the nodes, from any thread.

    Attributes:
        push: takes a contact, which lets go where its forces are zero, and whether other pushes
            stay.
        command: takes joint angles (2N,), rad.
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
    text for a segment, which does nothing unless it is one.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        mechanism: Mechanism,
        actions: Actions,
        joints_deg: list[float],
        force_limit_n: float,
        places: TouchedPlaces,
    ) -> None:
        """`joints_deg` (2N,) is where the joints' sliders begin; it is kept up to date.

        `places` says where each segment can be touched, and how far a drag can go along it.
        """
        self._actions = actions
        self._joints_deg = joints_deg
        reach_m = places.touched_m
        self._reach_m = reach_m
        self._friction = places.friction
        self._pushing = False
        self._pulled = False
        self._closed = False
        self._lock = threading.RLock()
        segments = [str(n) for n in range(1, mechanism.segment_count + 1)]
        limit_deg = joint_limit_deg(mechanism)
        with gui.add_folder("Push the arm"):
            self._segment = gui.add_dropdown("segment", segments, initial_value=segments[-1])
            nearest_mm = 1e3 * reach_m.min()
            farthest_mm = 1e3 * reach_m.max()
            self._place = gui.add_slider(
                "place, mm",
                *(nearest_mm, farthest_mm, 1.0),
                float(np.clip(1e3 * mechanism.contact_m[-1], nearest_mm, farthest_mm)),
                hint="along the segment from its joint; a click on the arm sets it, too",
            )
            self._angle = gui.add_slider(
                "angle, °", 0, 355, 5, 215, hint="direction of the force: 0° up, 90° to +y"
            )
            self._newtons = gui.add_slider(
                "force, N", 0.0, force_limit_n, force_limit_n / 200.0, 0.3 * force_limit_n
            )
            self._along = gui.add_slider(
                "along, N",
                *(-0.5 * force_limit_n, 0.5 * force_limit_n, force_limit_n / 200.0, 0.0),
                hint="force along the segment, towards its end",
            )
            self._beside = gui.add_checkbox(
                "keep other pushes", False, hint="on other segments: several contacts at once"
            )
            self._button = gui.add_button("Push", color="orange", icon=viser.Icon.HAND_FINGER)
        with gui.add_folder("Move the joints", expand_by_default=True):
            self._joints = [
                gui.add_slider(
                    f"joint {1 + n // 2} {'yaw' if n % 2 else 'pitch'}, °",
                    *(-limit_deg, limit_deg, 0.5, angle_deg),
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
            hint = "moves the arm a little, so that friction hides no force"
            self._breathe = gui.add_button(
                "Breathe", icon=viser.Icon.LUNGS, hint=hint, visible=actions.can_breathe()
            )
            hint = "visits some poses untouched, to learn how the arm was built"
            self._commission = gui.add_button(
                "Commission", icon=viser.Icon.ROUTE, hint=hint, visible=actions.can_commission()
            )
        for joint in self._joints:
            self._on(joint.on_update, self._send_command)
        for handle in (self._segment, self._place, self._angle, self._newtons, self._along):
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
        """Let go of the arm; nothing that is still under way from the browser does anything."""
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

    def touch(self, segment: int, place_m: float) -> None:
        """Choose where to push: segment 1 … N and the place nearest to `place_m` in its reach."""
        with self._lock:
            if not self._closed:
                within_m = float(np.clip(place_m, *self._reach_m[segment - 1]))
                self._segment.value = str(segment)  # type: ignore[misc]  # as in `_go_home`
                self._place.value = round(1e3 * within_m)  # type: ignore[misc]
                self._send_push()

    def pull(self, contact: Contact | None) -> None:
        """Push as a drag on the arm says, until None ends it.

        The force is brought into the sliders' ranges; along the segment it is at most what
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
            within_m = float(np.clip(contact.contact_m, *self._reach_m[contact.segment - 1]))
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
        self._segment.value = str(push.segment)  # type: ignore[misc]  # as in `_go_home`
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
        elif self._pushing and self._segment.value in self._segment.options:
            segment = int(self._segment.value)
            place_m = float(np.clip(1e-3 * _within(self._place), *self._reach_m[segment - 1]))
            force_n = _within(self._newtons)
            along_n = _within(self._along)
            contact = Contact(segment, _within(self._angle), force_n, place_m, along_n)
            self._actions.push(contact, bool(self._beside.value))

    def _send_command(self) -> None:
        self._joints_deg[:] = [_within(joint) for joint in self._joints]
        self._actions.command(np.deg2rad(self._joints_deg))

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
    """Range of the sliders: no guide plates touch with both axes of a joint at its end."""
    each_deg = math.degrees(float(mechanism.bend_limit_rad.min())) / math.sqrt(2.0)
    return min(JOINT_LIMIT_DEG, math.floor(2.0 * each_deg) / 2.0)


_GREY = "#8a93a3"
_COLOURS: dict[str, Any] = {
    "grey": _GREY,
    "true_css": css(TRUE_RGB),
    "estimate_css": css(ESTIMATE_RGB),
    "tension_css": ", ".join(TENSION_CSS),
    "segment_css": lambda number: css(segment_rgb(number)),
    "level_css": {
        Level.OK: "#00b280",
        Level.WARN: "#f0a832",
        Level.ERROR: "#e8604c",
        Level.STALE: _GREY,
    },
}


def newtons_text(force_n: float) -> str:
    """A force without its unit; forces below 10 N have a digit more."""
    return f"{force_n:.{2 if force_n < 9.95 else 1}f}"


def _decimals(low: float, high: float) -> int:
    """The number of decimals, at most two, that leaves one digit of the interval's width.

    Two digits where the first is 1. The ends of an interval of angles may be on both sides of
    360°.
    """
    width = high - low if high >= low else high - low + 360.0
    if width <= 0.0:
        return 2
    power = math.floor(math.log10(width))
    second = width < 2.0 * 10.0**power
    return min(2, max(0, second - power))


def interval_text(low: float, high: float) -> str:
    """`59.33 to 59.38`: both ends with the digits that their distance leaves."""
    digits = _decimals(low, high)
    return f"{low:.{digits}f} to {high:.{digits}f}"


def known_text(value: float, low: float, high: float) -> str:
    """A value with as many digits as its interval has."""
    return f"{value:.{_decimals(low, high)}f}"


def covered_m(region: Sequence[PlaceInterval]) -> float:
    """The length of an interval of places along the arm."""
    return sum(part.high_m - part.low_m for part in region)


def places_text(region: Sequence[PlaceInterval]) -> str:
    """`52 to 73 mm`, or `121 mm of 2 to 14 mm of 3` where it ends on another segment."""
    low_mm = 1e3 * region[0].low_m
    high_mm = 1e3 * region[-1].high_m
    if len(region) == 1:
        return f"{interval_text(low_mm, high_mm)} mm"
    first = region[0].segment
    last = region[-1].segment
    return f"{low_mm:.0f} mm of {first} to {high_mm:.0f} mm of {last}"


def _number_text(value: float | None, form: str) -> str:
    return "–" if value is None else form % value


def _macros() -> Any:
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters.update(newtons=newtons_text, number=_number_text)
    environment.globals.update(_COLOURS, interval=interval_text, known=known_text)
    environment.globals.update(covered=covered_m, places=places_text)
    text = files("cablesense_online.page").joinpath("panel.html").read_text(encoding="utf-8")
    return environment.from_string(text).module


_MACROS = _macros()


def html(what: str, *values: Any) -> str:
    """A part of the panels, by its macro in `panel.html`, of the values that the macro takes."""
    return str(getattr(_MACROS, what)(*values)).strip()


_DASHES: tuple[list[int], ...] = ([], [6, 3], [2, 3], [9, 3, 2, 3], [5, 2, 2, 2, 2, 2])
"""Lines of the cables of a segment, in turn: lengths of strokes and gaps, px; none is solid."""
_UNKNOWN_N = -3.0
"""Where the chart draws an unknown force: below zero, where no force is."""
_WINDOW_S = 12.0
"""That the chart shows."""
_SAMPLES = 240
"""In this window: 20 a second."""


class TraceBuffer:
    """A ring of the last samples of some columns, thinned to an even spacing in time."""

    def __init__(self, columns: int, window_s: float = _WINDOW_S, samples: int = _SAMPLES) -> None:
        self._step_s = window_s / samples
        self._window_s = window_s
        self._rows: deque[Array] = deque(maxlen=samples)  # time, then the columns
        self._empty = (np.array([-window_s, 0.0]), *np.zeros((columns, 2)))

    def add(self, time_s: float, values: Array) -> None:
        """Keeps a sample unless it follows too closely; a clock that jumps back empties it."""
        since_s = time_s - self._rows[-1][0] if self._rows else np.inf
        if since_s < -self._window_s:
            self._rows.clear()
        elif since_s < self._step_s:
            return
        self._rows.append(np.append(time_s, values))

    @property
    def peak(self) -> float:
        """The largest value kept, 0 before the first."""
        return float(max((row[1:].max() for row in self._rows), default=0.0))

    @property
    def columns(self) -> tuple[Array, ...]:
        """Seconds before the newest sample, then the columns; at least two samples long."""
        if len(self._rows) < 2:
            return self._empty
        rows = np.array(self._rows)
        rows[:, 0] -= rows[-1, 0]
        return tuple(rows[rows[:, 0] >= -self._window_s].T)


class Trace:
    """A TraceBuffer drawn in the page; `draw` shows its samples."""

    def __init__(
        self,
        gui: viser.GuiApi,
        series: list[dict[str, Any]],
        label: str,
        least_n: float,
        height: int,
        bands: Any = None,
    ) -> None:
        """The y axis covers `least_n` and grows in the browser: new scales rebuild a plot."""
        self.buffer = TraceBuffer(len(series))
        line = {"stroke": "#2c323c", "width": 1}
        font = "11px sans-serif"
        look = {"labelSize": 18, "labelFont": font, "font": font, "stroke": _GREY}
        axes: list[Any] = [
            {"scale": scale, "label": label, "size": size, "grid": line, "ticks": line, **look}
            for scale, label, size in (("x", "time, s", 28), ("y", label, 46))
        ]
        y_range: Any = {
            "min": {"hard": 0.0, "soft": 0.0, "mode": 1, "pad": 0.05},
            "max": {"soft": least_n, "mode": 1, "pad": 0.05},
        }
        drawn: list[Any] = [{"points": {"show": False}, "width": 1.5, **each} for each in series]
        self._plot = gui.add_uplot(
            self.buffer.columns,
            ({"label": "s"}, *drawn),
            bands=bands,
            scales={"x": {"time": False}, "y": {"range": y_range}},
            axes=tuple(axes),
            legend={"show": False},
            cursor={"show": False},
            height=height,
            padding=(10, 14, 0, 0),
        )

    def draw(self) -> None:
        """Sends the traces to the page."""
        self._plot.data = self.buffer.columns


class ForceTrace(Trace):
    """True and estimated force, with the stated 95 % interval as a band."""

    def __init__(self, gui: viser.GuiApi, least_n: float) -> None:
        fill = f"rgba({', '.join(map(str, ESTIMATE_RGB))}, 0.3)"
        ends = [{"label": end, "width": 0, "stroke": fill} for end in ("from", "to")]
        true = {"label": "true", "stroke": css(TRUE_RGB), "width": 2.5}
        dots = {"show": True, "size": 3, "width": 0, "fill": css(ESTIMATE_RGB)}
        transparent = "rgba(0, 0, 0, 0)"
        estimated = {"label": "estimated", "width": 0, "stroke": transparent, "points": dots}
        band = {"series": [2, 1], "fill": fill}
        super().__init__(gui, [*ends, true, estimated], "force, N", least_n, 170, (band,))

    def add(self, now: Snapshot) -> None:
        """Keeps a moment; an unknown force is drawn below the axis, as uPlot bears no NaN.

        An unconfirmed one has no band: while the arm swings it would be wider than the axis.
        """
        true = now.true[0].magnitude_n if now.true else 0.0
        nothing = 0.0 if now.state.known and now.moment is None else _UNKNOWN_N
        estimate = now.estimated[0].magnitude_n if now.estimated else nothing
        bounds = None if now.state is ForceState.UNCONFIRMED else now.bounds
        ends = (0.0, 0.0) if bounds is None else bounds[:2]
        self.buffer.add(now.time_s, np.array([*ends, true, estimate]))


class NamedLine(NamedTuple):
    """How one cable's tension is drawn, and under which name.

    Attributes:
        name: of the cable.
        segment: that it ends on, from 1; it gives the colour.
        dash: lengths of strokes and gaps, px; empty for a solid line.
    """

    name: str
    segment: int
    dash: list[int]


def cable_lines(names: Sequence[str], mechanism: Mechanism) -> list[NamedLine]:
    """The line of each cable, in the order of the `names` (M)."""
    lines: list[NamedLine] = []
    for name, segment in zip(names, mechanism.cable_segment.tolist(), strict=True):
        of_segment = sum(line.segment == segment for line in lines)
        lines.append(NamedLine(name, segment, _DASHES[of_segment % len(_DASHES)]))
    return lines


def tension_trace(gui: viser.GuiApi, lines: Sequence[NamedLine]) -> Trace:
    """Every cable's tension, by its line."""
    series = [
        {"label": line.name, "stroke": css(segment_rgb(line.segment)), "dash": line.dash}
        for line in lines
    ]
    return Trace(gui, series, "tension, N", 100.0, 210)
