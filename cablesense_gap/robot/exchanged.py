"""Columns of a recording that look exchanged or reversed, sought before any effect is fitted.

Such a column is no property of a robot. Effects that imitate it get impossible numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_gap.robot.model import Robot
from cablesense_gap.robot.recording import RobotRecording

_LEAVES, _GAIN = 0.6, 0.5
"""Columns are tried where the model's residual is more than the first share of a measured channel.
Changed columns are believed if it is then less, and at most the second share of the former."""
_TOUCHED, _MOST = 0.02, 2.0
"""By how much changed columns alter the share of a channel that they touch; no share is larger."""

Left = Callable[[RobotRecording], Mapping[str, float]]
"""By channel, the nominal model's residual as a share of the measured values, RMS."""


def exchanged(recording: RobotRecording, robot: Robot, left: Left) -> list[str]:
    """Exchanges and reversals with which the nominal model fits far better, as sentences."""
    found: list[str] = []
    while max((now := left(recording)).values()) >= _LEAVES:
        tried = [(_gain(now, left(each)), text, each) for text, each in _changes(recording, robot)]
        gain, text, changed = max(tried, key=lambda each: each[0])
        if gain <= 0.0 or text in found:
            break
        found.append(text)
        recording = changed
    return found


def _gain(before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """By how much the channels that a change of columns touches are better, if that is plain."""
    pairs = np.array([(before[c], after.get(c, np.inf)) for c in before])
    one, other = np.minimum(pairs[np.abs(np.diff(pairs)[:, 0]) > _TOUCHED], _MOST).T
    was, left = float(one @ one), float(other @ other)
    much = len(one) * _LEAVES**2
    return was - left if was >= much > left and left <= _GAIN**2 * was else 0.0


def _changes(recording: RobotRecording, robot: Robot) -> Iterator[tuple[str, RobotRecording]]:
    """Every exchange of two columns of one kind, and every column with the other sign."""
    units = robot.position_units
    driven = "torque" if np.isfinite(recording.torque).any() else "command"
    names = robot.joints if driven == "torque" else robot.actuators
    for kind, labels, alike in (
        (driven, names, units if driven == "torque" else [""] * len(names)),
        ("position", robot.joints, units),
    ):
        values: Array = getattr(recording, kind)

        def changed(values: Array, kind: str = kind) -> RobotRecording:
            columns: dict[str, Any] = {kind: values}
            return replace(recording, **columns)

        known = np.flatnonzero(np.isfinite(values).all(0)).tolist()
        for a, b in combinations(known, 2):
            if alike[a] == alike[b]:
                order = np.arange(values.shape[1])
                order[[a, b]] = b, a
                text = f"{kind}.{labels[a]} and {kind}.{labels[b]} look exchanged"
                yield text, changed(values[:, order])
        for a in known:
            sign = np.where(np.arange(values.shape[1]) == a, -1.0, 1.0)
            text = f"{kind}.{labels[a]} looks as if it had the other sign"
            yield text, changed(values * sign)
