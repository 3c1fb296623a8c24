"""The page's panels: controls, status and numbers as HTML, and the tension traces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import viser

from cablesense_base.arrays import Array
from cablesense_msgs_py.messages import Level
from cablesense_online.page.drawing import (
    ESTIMATE_RGB,
    TENSION_GRADIENT_CSS,
    TRUE_RGB,
    Rgb,
    css,
    segment_rgb,
)
from cablesense_online.page.live_arm import Contact, Errors, Status
from cablesense_sim.mechanism import Mechanism

FORCE_LIMIT_N = 200.0
JOINT_LIMIT_DEG = 20.0


@dataclass(frozen=True)
class Push:
    """A push on request, normal to the segment at the commanded pose.

    Attributes:
        segment: 1 … N.
        angle_deg: from the segment's +z towards its +y.
        magnitude_n: newtons; 0 lets go.
    """

    segment: int
    angle_deg: float
    magnitude_n: float


@dataclass(frozen=True)
class Actions:
    """Requests of the page to the nodes, from any thread; `command` takes (2N,) angles, rad."""

    push: Callable[[Push], None]
    command: Callable[[Array], None]
    tare: Callable[[], None]


class Controls:
    """Sliders and buttons in the main panel; what a person sets goes to `Actions`."""

    def __init__(self, gui: viser.GuiApi, segment_count: int, actions: Actions) -> None:
        self._actions = actions
        self._pushing = False
        with gui.add_folder("Push the arm"):
            self._segment = gui.add_dropdown(
                "segment",
                [str(n) for n in range(1, segment_count + 1)],
                initial_value=str(segment_count),
            )
            self._angle = gui.add_slider(
                "angle, °", 0, 355, 5, 215, hint="direction of the force: 0° up, 90° to +y"
            )
            self._newtons = gui.add_slider("force, N", 0, int(FORCE_LIMIT_N), 1, 60)
            self._button = gui.add_button("Push", color="orange", icon=viser.Icon.HAND_FINGER)
        with gui.add_folder("Move the joints", expand_by_default=True):
            self._joints = [
                gui.add_slider(f"joint {n} {axis}, °", -JOINT_LIMIT_DEG, JOINT_LIMIT_DEG, 0.5, 0.0)
                for n in range(1, segment_count + 1)
                for axis in ("pitch", "yaw")
            ]
            home = gui.add_button("Home", icon=viser.Icon.HOME)
        with gui.add_folder("Estimator"):
            hint = "takes the present tensions as the unloaded state"
            tare = gui.add_button("Tare", icon=viser.Icon.SCALE, hint=hint)
        self._button.on_click(lambda _: self._toggle())
        for handle in (self._segment, self._angle, self._newtons):
            handle.on_update(lambda _: self._send_push() if self._pushing else None)
        for joint in self._joints:
            joint.on_update(lambda event: self._send_command() if event.client else None)
        home.on_click(lambda _: self._go_home())
        tare.on_click(lambda _: actions.tare())

    def _toggle(self) -> None:
        self._pushing = not self._pushing
        self._button.label = "Release" if self._pushing else "Push"
        self._button.color = "gray" if self._pushing else "orange"
        self._send_push()

    def _send_push(self) -> None:
        """The push as the sliders stand; 0 N unless the button is down."""
        force_n = float(self._newtons.value) if self._pushing else 0.0
        self._actions.push(Push(int(self._segment.value), float(self._angle.value), force_n))

    def _send_command(self) -> None:
        self._actions.command(np.deg2rad([float(joint.value) for joint in self._joints]))

    def _go_home(self) -> None:
        for joint in self._joints:
            joint.value = 0.0  # type: ignore[misc]  # mypy takes viser's setter for none
        self._send_command()


_GREY = "#8a93a3"
_LEVEL_CSS = {
    Level.OK: "#00b280",
    Level.WARN: "#f0a832",
    Level.ERROR: "#e8604c",
    Level.STALE: _GREY,
}
_DIM = f"color:{_GREY}"
_SMALL = f"{_DIM};font-size:11px"


def _box(content: str, style: str = "") -> str:
    return (
        "<div style='padding:2px 10px 10px 10px;font-size:13px;line-height:1.45;"
        f"font-variant-numeric:tabular-nums;{style}'>{content}</div>"
    )


def status_html(status: Status) -> str:
    """The estimator's state as a coloured badge with its notes."""
    notes = "".join(f"<div style='{_DIM};font-size:12px'>{escape(n)}</div>" for n in status.notes)
    return _box(
        "<span style='display:inline-block;width:10px;height:10px;border-radius:5px;"
        f"background:{_LEVEL_CSS[status.level]};margin-right:8px'></span>"
        f"<b id='cablesense-status'>{escape(status.headline)}</b>{notes}",
        "padding-top:8px",
    )


def forces_html(true: Contact | None, estimate: Contact | None) -> str:
    """True and estimated contact, side by side, with units."""
    rows = _force_row("true", TRUE_RGB, true) + _force_row("estimated", ESTIMATE_RGB, estimate)
    return _box(
        "<table style='width:100%;border-collapse:collapse'>"
        f"<tr style='{_SMALL};text-align:right'><td></td><td>segment</td>"
        f"<td>angle</td><td>force</td></tr>{rows}</table>"
    )


def _force_row(word: str, rgb: Rgb, contact: Contact | None) -> str:
    if contact is None:
        cells = f"<td>none</td><td style='{_DIM}'>–</td><td style='{_DIM}'>0.0 N</td>"
    else:
        cells = (
            f"<td>{contact.segment}</td><td>{contact.angle_deg:.1f}°</td>"
            f"<td>{contact.magnitude_n:.1f} N</td>"
        )
    return (
        f"<tr id='cablesense-{word}' style='text-align:right;font-size:15px'>"
        f"<td style='text-align:left;color:{css(rgb)};font-weight:600'>▶ {word}</td>{cells}</tr>"
    )


def probabilities_html(probabilities: Array | None, segment_count: int) -> str:
    """One bar for no contact and one for each segment."""
    bars = []
    for segment in range(segment_count + 1):
        share = 0.0 if probabilities is None else float(probabilities[segment])
        name = f"segment {segment}" if segment else "no contact"
        colour = css(segment_rgb(segment)) if segment else _GREY
        percent = "–" if probabilities is None else f"{100 * share:.1f} %"
        bars.append(
            f"<div style='display:flex;align-items:center;gap:8px;font-size:12px'>"
            f"<span style='width:74px'>{name}</span>"
            "<span style='flex:1;height:9px;background:#30353f;border-radius:3px;overflow:hidden'>"
            f"<span style='display:block;height:100%;width:{100 * share:.1f}%;"
            f"background:{colour}'></span></span>"
            f"<span style='width:52px;text-align:right'>{percent}</span></div>"
        )
    return _box(f"<div style='{_SMALL}'>contact probability</div>{''.join(bars)}")


def errors_html(errors: Errors) -> str:
    """Mean errors so far."""
    right = errors.segment_right
    cells = "".join(
        f"<div style='flex:1'><div style='{_SMALL}'>{name}</div><div style='font-size:16px;"
        f"font-weight:600'>{'–' if value is None else text.format(value)}</div></div>"
        for name, value, text in (
            ("segment right", None if right is None else 100 * right, "{:.1f} %"),
            ("direction error", errors.angle_mae_deg, "{:.2f}°"),
            ("force error", errors.magnitude_mae_n, "{:.2f} N"),
        )
    )
    return _box(
        f"<div style='display:flex;gap:6px'>{cells}</div>"
        f"<div style='{_SMALL}'>mean over {errors.count} steady moments</div>"
    )


def legend_html(full_scale_n: float, tensions_n: Array | None) -> str:
    """The colours of the cables, from slack to full scale, with the range at this moment."""
    now = ""
    if tensions_n is not None:
        now = f"now {round(float(tensions_n.min()))} to {round(float(tensions_n.max()))} N"
    return _box(
        "<div style='display:flex;justify-content:space-between'>"
        f"<span>cable tension</span><span style='{_DIM}'>{now}</span></div>"
        f"<div style='height:10px;border-radius:3px;background:{TENSION_GRADIENT_CSS}'></div>"
        f"<div style='display:flex;justify-content:space-between;{_SMALL}'>"
        f"<span>0 N (slack)</span><span>{full_scale_n / 2:.0f} N</span>"
        f"<span>{full_scale_n:.0f} N</span></div>",
        "padding-bottom:2px",
    )


def traces_legend_html(segment_count: int) -> str:
    """The legend of the traces: a colour for each segment that a cable ends on."""
    marks = " ".join(
        "<span style='white-space:nowrap;margin-right:10px'>"
        f"<b style='color:{css(segment_rgb(n))}'>━</b> ends on segment {n}</span>"
        for n in range(1, segment_count + 1)
    )
    return _box(marks, f"{_SMALL};padding-bottom:4px")


_DASHES: tuple[list[int], ...] = ([], [6, 3], [2, 3])
_AXIS_CSS = "#9aa3b2"
_RANGE_N = {
    end: {"soft": soft, "mode": 1, "pad": 0.05} for end, soft in (("min", 0.0), ("max", 100.0))
}
"""The y axis covers 0 to 100 N and grows in the browser: new scales would rebuild the plot."""


class TraceBuffer:
    """A ring of the last samples of M cables, thinned to an even spacing in time."""

    def __init__(self, cable_count: int, window_s: float = 12.0, samples: int = 240) -> None:
        self._step_s = window_s / samples
        self._window_s = window_s
        self._times_s = np.full(samples, np.nan)
        self._tensions_n = np.full((samples, cable_count), np.nan)
        self._newest_s = -np.inf

    def add(self, time_s: float, tensions_n: Array) -> bool:
        """Keeps a sample unless it follows too closely; a clock that jumps back starts anew."""
        if time_s < self._newest_s - self._window_s:
            self._times_s[:] = np.nan
        elif time_s - self._newest_s < self._step_s:
            return False
        self._times_s = np.roll(self._times_s, -1)
        self._tensions_n = np.roll(self._tensions_n, -1, axis=0)
        self._times_s[-1], self._tensions_n[-1] = time_s, tensions_n
        self._newest_s = time_s
        return True

    @property
    def peak_n(self) -> float:
        """The largest tension kept, 0 before the first."""
        known = self._tensions_n[np.isfinite(self._times_s)]
        return float(known.max()) if known.size else 0.0

    @property
    def columns(self) -> tuple[Array, ...]:
        """Seconds before the newest sample, then N of each cable; at least two samples long."""
        known = np.isfinite(self._times_s)
        if known.sum() < 2:
            empty = np.array([-self._window_s, 0.0])
            return (empty, *(np.full(2, np.nan) for _ in range(self._tensions_n.shape[1])))
        times = self._times_s[known] - self._newest_s
        inside = times >= -self._window_s
        return (times[inside], *np.ascontiguousarray(self._tensions_n[known][inside].T))


class TracePlot:
    """A TraceBuffer drawn in the page; `draw` shows what it holds."""

    def __init__(self, gui: viser.GuiApi, mechanism: Mechanism) -> None:
        self.buffer = TraceBuffer(mechanism.cable_count)
        self._plot = gui.add_uplot(
            self.buffer.columns,
            ({"label": "s"}, *_series(mechanism)),
            scales={"x": {"time": False}, "y": {"range": _RANGE_N}},
            axes=(_axis("x", "time, s", 28), _axis("y", "tension, N", 46)),
            legend={"show": False},
            cursor={"show": False},
            height=290,
            padding=(10, 14, 0, 0),
        )

    def draw(self) -> None:
        """Sends the traces to the page."""
        self._plot.data = self.buffer.columns


def _series(mechanism: Mechanism) -> list[Any]:
    segments = mechanism.cable_segment.tolist()
    return [
        {
            "label": f"cable_{cable + 1}",
            "stroke": css(segment_rgb(segment)),
            "width": 1.5,
            "dash": _DASHES[segments[:cable].count(segment) % len(_DASHES)],
            "points": {"show": False},
        }
        for cable, segment in enumerate(segments)
    ]


def _axis(scale: str, label: str, size: int) -> Any:
    return {
        "scale": scale,
        "label": label,
        "labelSize": 18,
        "labelFont": "11px sans-serif",
        "font": "11px sans-serif",
        "size": size,
        "stroke": _AXIS_CSS,
        "grid": {"stroke": "#2c323c", "width": 1},
        "ticks": {"stroke": "#2c323c", "width": 1},
    }
