"""A tare in words: for the log, so that what was in force can be told later, and diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_ros.tare import Tare, TareModel


def tare_taken_line(tare: Tare, cable_names: Sequence[str], how: str) -> str:
    """What was taken, when and how, cable by cable; `cable_names` (M,) in the tare's order."""
    return f"tare taken {how} {_described(tare, cable_names)}"


def tare_undone_line(
    undone: Tare, earlier: Tare | None, cable_names: Sequence[str], undoable: int
) -> str:
    """What counts no more, and what counts again; `undoable` tares are left."""
    line = f"tare of {time_text(undone.taken_ns)} undone; "
    if earlier is None:
        return line + "there is none now, so no estimate"
    return (
        f"{line}again in force is the one {_described(earlier, cable_names)}; {undoable} left to "
        "undo"
    )


def tare_status(tares: TareModel) -> Status:
    """Whether there is a tare, since when, and how far it lies from the arm's model."""
    tare = tares.present
    if tare is None:
        return Status(
            "tare", Level.WARN, "none taken: no estimate; call ~/tare with the arm unloaded"
        )
    since = time_text(tare.taken_ns)
    values = {
        "tared since": since,
        "readings averaged": str(tare.sample_count),
        "largest deviation from the arm file (N)": f"{tare.offset_n:.2f}",
        "unloaded tensions (N)": ", ".join(f"{tension:.2f}" for tension in tare.measured_n),
        "tares that can be undone": str(tares.undoable),
    }
    return Status("tare", Level.OK, f"tared since {since}", values)


def time_text(time_ns: int) -> str:
    """A time in ns since the epoch, to the second, in UTC; 0 is one that was not kept."""
    if not time_ns:
        return "before the estimator's start"
    return datetime.fromtimestamp(time_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _described(tare: Tare, cable_names: Sequence[str]) -> str:
    deviations_n = tare.measured_n - tare.predicted_n
    cables = ", ".join(
        f"{name} {measured:.2f} ({deviation:+.2f})"
        for name, measured, deviation in zip(
            cable_names, tare.measured_n, deviations_n, strict=True
        )
    )
    return (
        f"at {time_text(tare.taken_ns)}: average of {tare.sample_count} readings, at most "
        f"{tare.offset_n:.2f} N from the arm file's unloaded tensions; in N, with the deviation: "
        f"{cables}"
    )
