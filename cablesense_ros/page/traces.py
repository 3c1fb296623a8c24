"""The tension traces: the last seconds of every cable, as one plot."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from cablesense_ros.page.colours import css, segment_rgb
from cablesense_ros.page.snapshot import Array
from cablesense_sim.mechanism import Mechanism

WINDOW_S = 12.0
SAMPLES = 240
_DASHES: tuple[list[int], ...] = ([], [6, 3], [2, 3])
_AXIS_CSS = "#9aa3b2"
_SOFT_ZERO = {"soft": 0.0, "mode": 1, "pad": 0.05}
_SOFT_100 = {"soft": 100.0, "mode": 1, "pad": 0.05}
"""The y axis covers 0 to 100 N and grows in the browser: new scales would rebuild the plot."""


class TraceBuffer:
    """A ring of the last samples of M cables, thinned to an even spacing in time."""

    def __init__(
        self, cable_count: int, window_s: float = WINDOW_S, samples: int = SAMPLES
    ) -> None:
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
        """The largest tension held, 0 before the first."""
        held = self._tensions_n[np.isfinite(self._times_s)]
        return float(held.max()) if held.size else 0.0

    @property
    def columns(self) -> tuple[Array, ...]:
        """Seconds before the newest sample, then N of each cable; at least two samples long."""
        held = np.isfinite(self._times_s)
        if held.sum() < 2:
            empty = np.array([-self._window_s, 0.0])
            return (empty, *(np.full(2, np.nan) for _ in range(self._tensions_n.shape[1])))
        times = self._times_s[held] - self._newest_s
        inside = times >= -self._window_s
        return (times[inside], *np.ascontiguousarray(self._tensions_n[held][inside].T))


class TracePlot:
    """A TraceBuffer drawn in the page."""

    def __init__(self, gui: viser.GuiApi, mechanism: Mechanism) -> None:
        self._buffer = TraceBuffer(mechanism.cable_count)
        self._plot = gui.add_uplot(
            self._buffer.columns,
            ({"label": "s"}, *_series(mechanism)),
            scales={"x": {"time": False}, "y": {"range": {"min": _SOFT_ZERO, "max": _SOFT_100}}},
            axes=(
                _axis("x", "time, s", 28),
                _axis("y", "tension, N", 46),
            ),
            legend={"show": False},
            cursor={"show": False},
            height=290,
            padding=(10, 14, 0, 0),
        )

    @property
    def peak_n(self) -> float:
        """The largest tension in the plot, N."""
        return self._buffer.peak_n

    def add(self, time_s: float, tensions_n: Array) -> None:
        """Remembers a sample; `draw` shows it."""
        self._buffer.add(time_s, tensions_n)

    def draw(self) -> None:
        """Sends the traces to the page."""
        self._plot.data = self._buffer.columns


def _series(mechanism: Mechanism) -> list[Any]:
    series: list[Any] = []
    seen: dict[int, int] = {}
    for cable, segment in enumerate(mechanism.cable_segment):
        turn = seen[int(segment)] = seen.get(int(segment), -1) + 1
        series.append(
            {
                "label": f"cable_{cable + 1}",
                "stroke": css(segment_rgb(int(segment))),
                "width": 1.5,
                "dash": _DASHES[turn % len(_DASHES)],
                "points": {"show": False},
            }
        )
    return series


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
