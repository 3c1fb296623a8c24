"""The charts of the last seconds: force with its stated interval, and every reading."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import viser

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState
from cablesense_online.page.colours import ESTIMATE_RGB, TRUE_RGB, css, segment_rgb
from cablesense_online.page.figures import GREY
from cablesense_online.page.shown import ReadingPanel
from cablesense_online.page.snapshot import Snapshot

_DASHES: tuple[list[int], ...] = ([], [6, 3], [2, 3], [9, 3, 2, 3], [5, 2, 2, 2, 2, 2])
"""Lines of the readings of a group, in turn: lengths of strokes and gaps, px; none is solid."""
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
        """The largest size of a value kept, 0 before the first."""
        return float(max((np.abs(row[1:]).max() for row in self._rows), default=0.0))

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
        least: float,
        height: int,
        bands: Any = None,
        *,
        signed: bool = False,
    ) -> None:
        """The y axis covers `least` and grows in the browser: new scales rebuild a plot.

        It begins at zero, or where values are `signed` at -`least`.
        """
        self.buffer = TraceBuffer(len(series))
        line = {"stroke": "#2c323c", "width": 1}
        font = "11px sans-serif"
        look = {"labelSize": 18, "labelFont": font, "font": font, "stroke": GREY}
        axes: list[Any] = [
            {"scale": scale, "label": label, "size": size, "grid": line, "ticks": line, **look}
            for scale, label, size in (("x", "time, s", 28), ("y", label, 46))
        ]
        lowest: dict[str, float] = {"soft": -least} if signed else {"hard": 0.0, "soft": 0.0}
        y_range: Any = {
            "min": {**lowest, "mode": 1, "pad": 0.05},
            "max": {"soft": least, "mode": 1, "pad": 0.05},
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
        """Keeps an instant; an unknown force is drawn below the axis, as uPlot bears no NaN.

        An unconfirmed one has no band: while the arm swings it would be wider than the axis.
        """
        true = now.true[0].magnitude_n if now.true else 0.0
        nothing = 0.0 if now.state.known and now.known_by_moment is None else _UNKNOWN_N
        estimate = now.estimated[0].magnitude_n if now.estimated else nothing
        bounds = None if now.state is ForceState.UNCONFIRMED else now.bounds
        ends = (0.0, 0.0) if bounds is None else bounds[:2]
        self.buffer.add(now.time_s, np.array([*ends, true, estimate]))


class NamedLine(NamedTuple):
    """How one reading is drawn, and under which name.

    Attributes:
        name: of the cable or joint.
        group: the heading that it is listed under.
        colour: of the group, `#rrggbb`.
        dash: lengths of strokes and gaps, px; empty for a solid line.
    """

    name: str
    group: str
    colour: str
    dash: list[int]


def reading_lines(panel: ReadingPanel) -> list[NamedLine]:
    """The line of each reading of a panel, in its order.

    A group has a colour of its own, and the next one once there are no more dashes.
    """
    headings = list(dict.fromkeys(panel.groups))
    lines: list[NamedLine] = []
    for name, group in zip(panel.names, panel.groups, strict=True):
        of_group = sum(line.group == group for line in lines)
        number = 1 + headings.index(group) + of_group // len(_DASHES)
        colour = css(segment_rgb(number))
        lines.append(NamedLine(name, group, colour, _DASHES[of_group % len(_DASHES)]))
    return lines


class ReadingTrace(Trace):
    """Every reading of a panel, by its line."""

    def __init__(self, gui: viser.GuiApi, panel: ReadingPanel, lines: Sequence[NamedLine]) -> None:
        series = [{"label": line.name, "stroke": line.colour, "dash": line.dash} for line in lines]
        label = f"{panel.quantity}, {panel.unit}"
        super().__init__(gui, series, label, panel.least, 210, signed=panel.signed)
