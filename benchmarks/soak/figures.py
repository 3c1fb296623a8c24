"""From the logs of a run to its figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soak.course import MarkedCourse
from soak.sink import Log

FALSE_FORCE_N = 1.0
"""A wrench beyond this while nothing pushes is a false force."""

NEAR_CYCLES = 300
"""A sample that waited in the terminal is at most so many cycles old."""

BLOCK = 100_000
FIRST_MINUTE_S = 60.0


def delivery(
    course: MarkedCourse,
    dropped: NDArray[np.int64],
    written_ns: NDArray[np.int64],
    tensions: Log,
    rate_hz: float,
) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """What came of what was sent, value by value; also the cycle (C,) of each sample, -1 for none.

    A sample's number is spelt modulo `course.modulo`; which one it is, its time of arrival tells.
    """
    steps = np.rint(tensions.numbers / course.step_n).astype(np.int64)
    guess = np.searchsorted(written_ns, tensions.arrived_ns) - 1
    off = (course.spelt(steps) - guess) % course.modulo
    off -= np.where(off > course.modulo // 2, course.modulo, 0)
    cycle = guess + off
    cycle[(cycle < 0) | (cycle >= len(written_ns))] = -1
    known = cycle >= 0
    right = np.zeros(len(cycle), dtype=bool)
    mixed = np.zeros(len(cycle), dtype=bool)
    for start in range(0, len(cycle), BLOCK):
        part = slice(start, start + BLOCK)
        right[part] = (course.steps(cycle[part]) == steps[part]).all(axis=1) & known[part]
    wrong = np.flatnonzero(~right)
    mixed[wrong] = _of_neighbours(course, guess[wrong], steps[wrong])
    on_wire = dropped == 0
    came = np.zeros(len(written_ns), dtype=np.int64)
    np.add.at(came, cycle[right], 1)
    lost = on_wire & (came == 0)
    return {
        "cycles played": len(written_ns),
        "cycles whole on the terminal": int(on_wire.sum()),
        "frames that the terminal did not take": int(dropped.sum()),
        "samples published, as heard": len(cycle),
        "samples with a value that was not sent": int((~right & ~mixed).sum()),
        "samples of two cycles": int(mixed.sum()),
        "samples heard twice": int((came > 1).sum()),
        "samples out of order": int((np.diff(cycle[right]) <= 0).sum()),
        "cycles delivered but not published": int(lost.sum()),
        "first of these": np.flatnonzero(lost)[:20].tolist(),
        "longest pause of the amplifiers (ms)": round(float(np.diff(written_ns).max()) / 1e6, 1),
        "rate played (1/s)": round(
            (len(written_ns) - 1) / ((written_ns[-1] - written_ns[0]) * 1e-9), 2
        ),
        "rate asked (1/s)": rate_hz,
    }, np.where(right, cycle, -1)


def _of_neighbours(
    course: MarkedCourse, near: NDArray[np.int64], steps: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether rows (C, M) are made of two cycles, one behind the other, near the cycles (C,).

    Without a counter in the frames that is what a lost one may do.
    """
    found = np.zeros(len(steps), dtype=bool)
    for back in range(NEAR_CYCLES):
        cycle = np.maximum(near - back, 1)
        one, other = course.steps(cycle), course.steps(cycle - 1)
        found |= ((steps == one) | (steps == other)).all(axis=1)
    return found


def answers(
    course: MarkedCourse,
    cycle: NDArray[np.int64],
    written_ns: NDArray[np.int64],
    tensions: Log,
    wrenches: Log,
) -> dict[str, Any]:
    """Whether each sample was answered, how soon, and how well."""
    stamps = wrenches.stamps_ns
    order = np.argsort(stamps, kind="stable")
    at = np.searchsorted(stamps[order], tensions.stamps_ns)
    at = np.minimum(at, len(stamps) - 1)
    answered = stamps[order][at] == tensions.stamps_ns
    wrench = order[at]
    known = answered & (cycle >= 0)
    to_wrench = wrenches.arrived_ns[wrench[known]] - written_ns[cycle[known]]
    to_sample = tensions.arrived_ns[cycle >= 0] - written_ns[cycle[cycle >= 0]]
    row = cycle[known] % len(course.even)
    tared = np.zeros(len(row), dtype=bool)
    tared[np.flatnonzero(course.force_n[row] > 0.0)[:1].sum() :] = True
    judged = course.held[row] & tared
    force = np.linalg.norm(wrenches.numbers[wrench[known]][:, :3], axis=1)
    segment = wrenches.segments[wrench[known]]
    pushed = judged & (course.segment[row] > 0)
    free = judged & (course.segment[row] == 0)
    error = np.abs(force - course.force_n[row])[pushed]
    return {
        "wrenches heard": wrenches.count,
        "samples answered": int(answered.sum()),
        "samples not answered": int((~answered).sum()),
        "latency from the last frame to the wrench (ms)": _spread_ms(to_wrench),
        "latency from the last frame to the sample (ms)": _spread_ms(to_sample),
        "force": {
            "samples judged, pushed": int(pushed.sum()),
            "right segment (%)": _percent((segment == course.segment[row])[pushed]),
            "error (N): median, 99 %, worst": _percentiles(error, (50.0, 99.0, 100.0)),
            "samples judged, untouched": int(free.sum()),
            "false forces": int((force[free] > FALSE_FORCE_N).sum()),
        },
    }


def memory(looks: Sequence[tuple[float, dict[str, float]]]) -> dict[str, Any]:
    """MB of each process: at a minute, at the end, the line through what is between, and most.

    Runs of up to two minutes count from their first quarter.
    """
    times = np.array([elapsed_s for elapsed_s, _ in looks])
    settled_s = FIRST_MINUTE_S if times[-1] > 2 * FIRST_MINUTE_S else times[-1] / 4
    later = times >= settled_s
    figures = {}
    for name in looks[0][1]:
        rss = np.array([mb[name] for _, mb in looks])[later]
        at = times[later]
        slope = float(np.polyfit(at, rss, 1)[0])
        figures[name] = {
            "MB when settled": round(float(rss[0]), 2),
            "MB at the end": round(float(rss[-1]), 2),
            "growth at most (MB)": round(float(rss.max() - rss[0]), 2),
            "growth by the fitted line (MB)": round(slope * float(at[-1] - at[0]), 2),
            "fitted line (kB a minute)": round(slope * 60e3, 2),
        }
    return {"settled after (s)": round(float(settled_s), 1), **figures}


def _spread_ms(ns: NDArray[np.int64]) -> dict[str, float]:
    names = ("median", "95 %", "99 %", "99.9 %", "worst")
    values = _percentiles(ns / 1e6, (50.0, 95.0, 99.0, 99.9, 100.0))
    return dict(zip(names, values, strict=True))


def _percentiles(values: NDArray[np.float64], at: Sequence[float]) -> list[float]:
    return np.percentile(values, at).round(3).tolist() if len(values) else []


def _percent(true: NDArray[np.bool_]) -> float:
    return round(100.0 * float(true.mean()), 3) if len(true) else float("nan")
