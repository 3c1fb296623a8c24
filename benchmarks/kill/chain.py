"""The chain under test: sim, amplifiers, driver, estimator and a recorder, each a process.

What became of recordings: of one through all kills, and of those whose recorder was killed.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import CABLESENSE, END_WITHIN_S
from numpy.typing import NDArray

from cablesense_base.errors import CableSenseError
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.mcap_messages import McapMessages
from cablesense_msgs_py import topics
from cablesense_msgs_py.serialized import EffortReader
from cablesense_ros.processes import Process, node_command
from cablesense_sim.arm import Arm

STALE_AFTER_S = 0.05
VICTIMS = ("driver", "sim", "estimator")
_UP_LINES = {
    "driver": r"\[INFO\] \[([\d.]+)\] \[can_driver\]: arm ",
    "sim": r"\[INFO\] \[([\d.]+)\] \[sim\]: arm ",
    "estimator": r"\[INFO\] \[([\d.]+)\] \[estimator\]: arm .*: configured",
}


class Chain:
    """All processes; each can be killed and started again by its name."""

    def __init__(self, arm: str, rate_hz: float, folder: Path) -> None:
        """The sim takes samples at `rate_hz`; logs and files go to `folder`."""
        link = folder / "adapter"
        self.recording = folder / "kills.mcap"
        commands = {
            "sim": node_command(
                "sim",
                {"arm": arm, "rate_hz": float(rate_hz)},
                {"cable_tensions": "simulated_tensions"},
            ),
            "amplifiers": node_command("can_emulator", {"arm": arm, "channel": link}),
            "driver": node_command(
                "can_driver",
                {
                    "arm": arm,
                    "interface": "slcan",
                    "channel": link,
                    "bitrate_bit_s": 1_000_000,
                    "stale_after_s": STALE_AFTER_S,
                },
            ),
            "estimator": node_command(
                "estimator",
                {
                    "arm": arm,
                    "stale_after_s": STALE_AFTER_S,
                    "state_file": folder / "estimator_state.json",
                },
            ),
            "recorder": recorder_command(self.recording),
        }
        self.processes = {
            name: Process(name, command, folder / f"{name}.log")
            for name, command in commands.items()
        }

    def pids(self) -> dict[str, int]:
        """Process ids of those that live."""
        return {name: one.pid for name, one in self.processes.items() if one.alive}

    def up_epoch_s(self, victim: str) -> float:
        """When a victim last said that it was set up, s since the epoch; NaN before the first."""
        said = re.findall(_UP_LINES[victim], self.processes[victim].log)
        return float(said[-1]) if said else float("nan")

    def ups(self, victim: str) -> int:
        """How often it said so."""
        return len(re.findall(_UP_LINES[victim], self.processes[victim].log))

    def end(self) -> dict[str, int]:
        """End all; exit codes by name. The recorder goes first, so that its file is whole."""
        order = sorted(self.processes, key=lambda name: name != "recorder")
        return {name: self.processes[name].stop(END_WITHIN_S) for name in order}


def recorder_command(file: Path) -> list[str]:
    """The command that records the running nodes into a file."""
    return [*CABLESENSE, "record", "--out", str(file)]


WRITING_S = (0.0, 2.0)
"""A recorder is killed so long after the first tensions stand in its file."""

UP_WITHIN_S = 20.0
DRIVER_AWAY_S = 0.1


def whole(path: Path, heard_ns: Sequence[int], arm: Arm) -> dict[str, Any]:
    """Whether a recording has every sample between its first and its last that was heard here."""
    try:
        stamps_ns, _ = _samples(path)
        rows = len(read_recording(path, arm))
    except (CableSenseError, OSError) as error:
        return {"readable": False, "why": str(error), "samples missing": -1}
    heard = np.unique(np.array(heard_ns))
    heard = heard[(heard >= stamps_ns.min()) & (heard <= stamps_ns.max())]
    missing = ~np.isin(heard, stamps_ns)
    late = _not_yet_found(heard, missing)
    return {
        "readable": True,
        "size (MB)": round(path.stat().st_size / 1e6, 2),
        "samples": len(stamps_ns),
        "samples heard in its time": len(heard),
        "samples before the recorder had found the new driver": int(late.sum()),
        "samples missing": int((missing & ~late).sum()),
        "rows as the diagnosis reads it": rows,
    }


def _not_yet_found(heard_ns: NDArray[np.int64], missing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which samples lack because they came before the middleware knew of a driver that is new.

    That are those missing in a row behind a pause: the watcher had found the driver sooner.
    """
    late = np.zeros(len(heard_ns), dtype=bool)
    begins = np.flatnonzero(np.diff(heard_ns) > DRIVER_AWAY_S * 1e9) + 1
    for begin in begins:
        at = begin
        while at < len(heard_ns) and missing[at]:
            late[at] = True
            at += 1
    return late


def kill_recorders(times: int, folder: Path, spin: Callable[[float], None]) -> dict[str, Any]:
    """Kill recorders while they write, and read what they leave."""
    rng = np.random.default_rng(1)
    lost_s: list[float] = []
    problems: list[str] = []
    for number in range(times):
        path = folder / f"killed_{number}.mcap"
        with Process("killed", recorder_command(path), folder / "killed.log") as recorder:
            deadline_s = time.monotonic() + UP_WITHIN_S
            while not _begun(path) and time.monotonic() < deadline_s:
                spin(0.1)
            spin(float(rng.uniform(*WRITING_S)))
            recorder.kill()
            killed_ns = time.time_ns()
        try:
            _, logged_ns = _samples(path)
            lost_s.append((killed_ns - int(logged_ns.max())) * 1e-9)
        except (CableSenseError, OSError, ValueError) as error:
            problems.append(f"{number}: {error}")
    spread = np.percentile(lost_s, (50, 95, 100)).round(3).tolist() if lost_s else []
    return {
        "killed": times,
        "read": times - len(problems),
        "lost at the end (s): median, 95 %, worst": spread,
        "problems": problems[:10],
    }


def _begun(path: Path) -> bool:
    try:
        _samples(path)
    except (CableSenseError, OSError):
        return False
    return True


def _samples(path: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Stamps of the tensions in a file, and when each was recorded, ns."""
    read = EffortReader().read
    pairs = [
        (read(one.data).stamp_ns, one.log_ns)
        for one in McapMessages(path)
        if one.topic.rpartition("/")[2] == topics.CABLE_TENSIONS
    ]
    if not pairs:
        raise OSError(f"{path.name}: holds no tensions")
    columns = np.array(pairs, dtype=np.int64)
    return columns[:, 0], columns[:, 1]
