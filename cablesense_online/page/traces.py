"""Traces of the last seconds in the page: the force, true against estimated, and the tensions."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import viser

from cablesense_base import Array
from cablesense_online.page.drawing import ESTIMATE_RGB, TRUE_RGB, css, segment_rgb
from cablesense_online.page.live_arm import Snapshot
from cablesense_sim.mechanism import Mechanism

_GREY = "#9aa3b2"
_NOTHING = "rgba(0, 0, 0, 0)"
_UNKNOWN_N = -3.0
_DASHES: tuple[list[int], ...] = ([], [6, 3], [2, 3])


class TraceBuffer:
    """A ring of the last samples of some columns, thinned to an even spacing in time."""

    def __init__(self, columns: int, window_s: float = 12.0, samples: int = 240) -> None:
        self._step_s = window_s / samples
        self._window_s = window_s
        self._columns = columns
        self._rows: deque[Array] = deque(maxlen=samples)  # time, then the columns

    def add(self, time_s: float, values: Array) -> bool:
        """Keeps a sample unless it follows too closely; a clock that jumps back starts anew."""
        since_s = time_s - self._rows[-1][0] if self._rows else np.inf
        if since_s < -self._window_s:
            self._rows.clear()
        elif since_s < self._step_s:
            return False
        self._rows.append(np.append(time_s, values))
        return True

    @property
    def peak(self) -> float:
        """The largest value kept, 0 before the first."""
        return float(max((row[1:].max() for row in self._rows), default=0.0))

    @property
    def columns(self) -> tuple[Array, ...]:
        """Seconds before the newest sample, then the columns; at least two samples long."""
        if len(self._rows) < 2:
            empty = np.array([-self._window_s, 0.0])
            return (empty, *np.zeros((self._columns, 2)))
        times, *columns = np.array(self._rows).T
        times = times - times[-1]
        inside = times >= -self._window_s
        return (times[inside], *(column[inside] for column in columns))


class _Plot:
    """A TraceBuffer drawn in the page; `draw` shows what it holds."""

    def __init__(
        self,
        gui: viser.GuiApi,
        series: list[dict[str, Any]],
        label: str,
        soft_n: float,
        height: int,
        bands: tuple[Any, ...] | None = None,
    ) -> None:
        """The y axis covers 0 to `soft_n`, and grows in the browser: new scales rebuild a plot."""
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
            "max": {"soft": soft_n, "mode": 1, "pad": 0.05},
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


class ForcePlot(_Plot):
    """True and estimated force, with the stated 95 % interval as a band."""

    def __init__(self, gui: viser.GuiApi, soft_n: float) -> None:
        """The axis covers at least `soft_n`."""
        fill = f"rgba({', '.join(map(str, ESTIMATE_RGB))}, 0.3)"
        ends = [{"label": end, "width": 0, "stroke": fill} for end in ("from", "to")]
        true = {"label": "true", "stroke": css(TRUE_RGB), "width": 2.5}
        dots = {"show": True, "size": 3, "width": 0, "fill": css(ESTIMATE_RGB)}
        estimated = {"label": "estimated", "width": 0, "stroke": _NOTHING, "points": dots}
        band: Any = {"series": [2, 1], "fill": fill}
        super().__init__(gui, [*ends, true, estimated], "force, N", soft_n, 170, (band,))

    def add(self, snapshot: Snapshot) -> None:
        """Keeps a moment; what is unknown leaves a gap, below the axis, as uPlot bears no NaN."""
        true = 0.0 if snapshot.true is None else snapshot.true.magnitude_n
        estimate = 0.0 if snapshot.state.known else _UNKNOWN_N
        if snapshot.estimate is not None:
            estimate = snapshot.estimate.magnitude_n
        ends = (0.0, 0.0) if snapshot.bounds is None else snapshot.bounds[:2]
        self.buffer.add(snapshot.time_s, np.array([*ends, true, estimate]))


class TensionPlot(_Plot):
    """Every cable's tension, in the colour of the segment that it ends on."""

    def __init__(self, gui: viser.GuiApi, mechanism: Mechanism) -> None:
        segments = mechanism.cable_segment.tolist()
        series = [
            {
                "label": f"cable_{cable + 1}",
                "stroke": css(segment_rgb(segment)),
                "dash": _DASHES[segments[:cable].count(segment) % len(_DASHES)],
            }
            for cable, segment in enumerate(segments)
        ]
        super().__init__(gui, series, "tension, N", 100.0, 210)
