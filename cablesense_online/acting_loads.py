"""The loads that act on a simulated arm or machine, which end when nobody repeats them."""

from __future__ import annotations

from cablesense_msgs_py.messages import Load


class ActingLoads:
    """One load on each link, from when it was put on."""

    def __init__(self, timeout_s: float) -> None:
        """A load ends this long after it was put on; with 0 it lasts."""
        self._timeout_s = timeout_s
        self._loads: dict[int, tuple[Load, float]] = {}

    @property
    def loads(self) -> list[Load]:
        """Those that act, by link."""
        return [load for _, (load, _) in sorted(self._loads.items())]

    def put(self, load: Load, now_s: float) -> None:
        """Replace the load on a link; a zero force removes it."""
        self._loads.pop(load.segment, None)
        if load.force_base_n.any():
            self._loads[load.segment] = load, now_s

    def ended(self, now_s: float) -> list[int]:
        """The links, from 1, whose loads have ended by now; these are removed."""
        links = [
            link
            for link, (_, since_s) in self._loads.items()
            if 0.0 < self._timeout_s < now_s - since_s
        ]
        for link in links:
            del self._loads[link]
        return links

    def clear(self) -> None:
        """Remove all."""
        self._loads.clear()
