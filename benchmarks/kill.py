"""Kill −9: driver, sim and estimator killed under load again and again, seen from outside.

    python benchmarks/kill.py [--times 50] [--write]

The sim, amplifiers as CAN frames over slcan on a pseudo-terminal, `can_driver`, `estimator` and a
recorder run as processes while the load on the arm changes. Each victim in turn is killed at a
random moment (in half of the kills the load changes while it is dead), started again, and watched
from here: do the others continue, how soon is the wrench reported as stale, how soon is it right
again, is any false force published. Then recorders are killed, and their files are read.

When driver or sim are dead, stale is a zero wrench with a fresh stamp. When the estimator itself
is dead nothing is published on its topic; the subscriber's own middleware reports it, by the
liveliness that the estimator offers on `~/wrench`. Right is a force on the right segment within 2
N or 3 % of the load, ten times in a row.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import harness
import numpy as np
import pandas as pd
from kill_trials import (
    LEASE_S,
    STALE_AFTER_S,
    VICTIMS,
    KillTrials,
    start_chain,
)
from live_run import LiveRun
from numpy.typing import NDArray

from cablesense_base import CableSenseError
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.mcap_messages import McapMessages
from cablesense_msgs_py import topics
from cablesense_msgs_py.serialized import EffortReader
from cablesense_sim.arm import Arm, open_arm

STALE_WITHIN_S, RIGHT_WITHIN_S = 0.1, 1.0
ARM, RATE_HZ = "cdsm", 200.0
WRITING_S = (0.0, 2.0)
"""A recorder is killed at such a time after the first tensions are in its file."""
DRIVER_AWAY_S = 0.1


def measure(times: int) -> dict[str, Any]:
    """All kills; statistics by victim, and of the recordings."""
    arm = open_arm(ARM)
    kills: dict[str, list[dict[str, float]]] = {victim: [] for victim in VICTIMS}
    shared_mb = harness.shared_memory_mb()
    with LiveRun() as run:
        start_chain(run, ARM, RATE_HZ)
        trials = KillTrials(arm, run.processes, seed=0)
        trials.bring_up()
        for _, victim in itertools.product(range(times), VICTIMS):
            kills[victim].append(trials.kill(victim))
        trials.spin(1.0)
        recorders = _kill_recorders(times, run, trials)
        codes = run.stop()
        trials.destroy_node()
        recording = _whole(run.folder / "recorder.mcap", trials.samples, arm)
    statistics = {victim: _statistics(pd.DataFrame(ones)) for victim, ones in kills.items()}
    return {
        "arm": ARM,
        "rate_hz": RATE_HZ,
        "stale_after_s": STALE_AFTER_S,
        "lease_s": LEASE_S,
        "kills": statistics,
        "recording through all kills": recording,
        "recorders killed": recorders,
        "left in /dev/shm (MB)": round(harness.shared_memory_mb() - shared_mb, 1),
        "exit codes": codes,
        "bars": _bars(statistics, recording, recorders),
    }


def _whole(path: Path, received_ns: Sequence[int], arm: Arm) -> dict[str, Any]:
    """Whether a recording has every sample between its first and its last that came here.

    Samples missing in a row behind a pause came before the middleware of the recorder knew of a
    driver that is new; the watcher had found the driver sooner. They are counted apart.
    """
    try:
        stamps_ns, _ = _samples(path)
        rows = len(read_recording(path, arm))
    except (CableSenseError, OSError) as error:
        return {"readable": False, "why": str(error), "samples missing": -1}
    here = np.unique(np.array(received_ns))
    here = here[(here >= stamps_ns.min()) & (here <= stamps_ns.max())]
    missing = ~np.isin(here, stamps_ns)
    early = np.zeros_like(missing)
    for begin in np.flatnonzero(np.diff(here) > DRIVER_AWAY_S * 1e9) + 1:
        early[begin : begin + int(np.argmin([*missing[begin:], False]))] = True
    return {
        "readable": True,
        "size (MB)": round(path.stat().st_size / 1e6, 2),
        "samples": len(stamps_ns),
        "samples heard in its time": len(here),
        "samples before the recorder had found the new driver": int(early.sum()),
        "samples missing": int((missing & ~early).sum()),
        "rows as the diagnosis reads it": rows,
    }


def _kill_recorders(times: int, run: LiveRun, trials: KillTrials) -> dict[str, Any]:
    """Kill recorders while they write, and read their files."""
    rng = np.random.default_rng(1)
    lost_s: list[float] = []
    problems: list[str] = []
    for number in range(times):
        path = run.folder / f"killed_{number}.mcap"
        killed = run.record(path.stem)
        trials.spin_until(partial(_begun, path), "tensions in a recording")
        trials.spin(float(rng.uniform(*WRITING_S)))
        killed_ns = time.time_ns()
        killed.kill()
        del run.processes[path.stem]
        try:
            _, logged_ns = _samples(path)
            lost_s.append((killed_ns - int(logged_ns.max())) * 1e-9)
        except (CableSenseError, OSError, ValueError) as error:
            problems.append(f"{number}: {error}")
    spread = harness.percentiles(lost_s, ("median", "95 %", "worst"))
    return {
        "killed": times,
        "read": times - len(problems),
        "lost at the end (s): median, 95 %, worst": list(spread.values()),
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


def _statistics(kills: pd.DataFrame) -> dict[str, Any]:
    return {
        "kills": len(kills),
        "others lived": int(kills["others_lived"].sum()),
        "wrong forces": int(kills["wrong"].sum()),
        "estimator taken for dead while it lived": int(kills["false_deaths"].sum()),
        **{
            name: {"seen": int(kills[name].count())}
            | harness.percentiles(kills[name].dropna(), ("median", "95 %", "worst"), 4)
            for name in kills.filter(regex="_s$")
        },
    }


def _bars(
    statistics: dict[str, Any], recording: dict[str, Any], recorders: dict[str, Any]
) -> dict[str, bool]:
    bars: dict[str, bool] = {}
    for victim, one in statistics.items():
        stale, right = one["stale_s"], one["right_after_set_up_s"]
        bars |= {
            f"{victim}: the others go on": one["others lived"] == one["kills"],
            f"{victim}: stale said within {STALE_WITHIN_S:g} s": stale["seen"] == one["kills"]
            and stale["worst"] <= STALE_WITHIN_S,
            f"{victim}: right within {RIGHT_WITHIN_S:g} s of its being set up": right["worst"]
            <= RIGHT_WITHIN_S,
            f"{victim}: no wrong force": one["wrong forces"] == 0,
        }
    return bars | {
        "the recording is whole": recording["readable"] and recording["samples missing"] == 0,
        "killed recorders leave files that are read": recorders["read"] == recorders["killed"],
    }


def main() -> int:
    """Measure."""
    parser = harness.parser(__doc__, "results/kill.json")
    parser.add_argument("--times", type=int, default=50, help="kills of each")
    given = parser.parse_args()
    result = harness.origin("rclpy") | measure(given.times)
    harness.publish("kill.json", result, given)
    return 0 if all(result["bars"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
