"""Kill −9: driver, sim and estimator killed under load again and again, seen from outside.

    python benchmarks/kill.py [--times 50] [--rate-hz 200] [--write]

Sim, amplifiers as CAN frames over slcan on a pseudo-terminal, `can_driver`, `estimator` and a
recorder run as processes of their own while the load on the arm changes. Each victim in turn is
killed at a random moment (in half of the kills the load changes while it is dead), started again,
and watched from here: do the others go on, how soon is it said that the answer is stale, how soon
is the answer right again, is any force told that is not there. Then recorders are killed, and
what they leave is read.

Stale is said by a zero wrench with a fresh stamp when driver or sim are dead. When the estimator
itself is dead nobody speaks on its topic; the subscriber's own middleware tells, by the liveliness
that the estimator offers on `~/wrench`. Right is a force on the right segment within 2 N or 3 % of
the load, ten times in a row.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import harness
import numpy as np
import rclpy
from kill.chain import STALE_AFTER_S, VICTIMS, Chain, kill_recorders, whole
from kill.trials import LEASE_S, Kill, KillTrials, Watcher
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.utilities import try_shutdown

from cablesense_ros.discovery import own_graph
from cablesense_sim.arm import open_arm

STALE_WITHIN_S, RIGHT_WITHIN_S = 0.1, 1.0
RATE_HZ = 200.0
_SPREADS = (
    "stale_s",
    "last_force_s",
    "zero_age_s",
    "set_up_s",
    "first_sample_s",
    "right_s",
    "right_after_set_up_s",
)


def measure(arm_name: str, rate_hz: float, times: int) -> dict[str, Any]:
    """All kills; figures by victim, and what became of the recordings."""
    arm = open_arm(arm_name)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shared_mb = harness.shared_memory_mb()
        chain = Chain(arm_name, rate_hz, folder)
        rclpy.init()
        watcher = Watcher(arm)
        executor = EventsExecutor()
        executor.add_node(watcher)
        try:
            trials = KillTrials(arm, chain, watcher, executor, seed=0)
            trials.bring_up()
            kills = {victim: [] for victim in VICTIMS}
            for _ in range(times):
                for victim in VICTIMS:
                    kills[victim].append(trials.kill(victim))
            watcher.spin(executor, 1.0)
            recorders = kill_recorders(times, folder, lambda s: watcher.spin(executor, s))
            codes = chain.end()
            recording = whole(chain.recording, watcher.samples, arm)
        except TimeoutError as error:
            logs = "\n".join(
                f"--- {name}\n{one.log[-1500:]}" for name, one in chain.processes.items()
            )
            raise SystemExit(f"{error}\n{logs}") from error
        finally:
            chain.end()
            executor.shutdown()
            watcher.destroy_node()
            try_shutdown()
    left_mb = harness.shared_memory_mb() - shared_mb
    figures = {victim: _figures(ones) for victim, ones in kills.items()}
    return {
        "arm": arm_name,
        "rate_hz": rate_hz,
        "stale_after_s": STALE_AFTER_S,
        "lease_s": LEASE_S,
        "kills": figures,
        "recording through all kills": recording,
        "recorders killed": recorders,
        "left in /dev/shm (MB)": round(left_mb, 1),
        "exit codes": codes,
        "bars": _bars(figures, recording, recorders),
    }


def _figures(kills: Sequence[Kill]) -> dict[str, Any]:
    return {
        "kills": len(kills),
        "others lived": sum(one.others_lived for one in kills),
        "wrong forces": sum(one.wrong for one in kills),
        "estimator taken for dead while it lived": sum(one.false_deaths for one in kills),
        **{name: _spread([getattr(one, name) for one in kills]) for name in _SPREADS},
    }


def _spread(values: Sequence[float]) -> dict[str, float | int]:
    known = np.array(values)[np.isfinite(values)]
    if not len(known):
        return {"seen": 0}
    median, late, worst = np.percentile(known, (50.0, 95.0, 100.0)).round(4).tolist()
    return {"seen": len(known), "median": median, "95 %": late, "worst": worst}


def _bars(
    figures: dict[str, Any], recording: dict[str, Any], recorders: dict[str, Any]
) -> dict[str, bool]:
    bars = {}
    for victim, one in figures.items():
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
    parser.add_argument("--rate-hz", type=float, default=RATE_HZ, help="samples a second")
    parser.add_argument("--arm", default="cdsm", help="bundled arm, or a path")
    given = parser.parse_args()
    os.environ.update(own_graph())
    options = f"--times {given.times} --rate-hz {given.rate_hz:g} --write"
    measured = measure(given.arm, given.rate_hz, given.times)
    origin = harness.origin(f"python benchmarks/kill.py {options}", ["rclpy"])
    result = {**origin, **measured}
    print(json.dumps(result, indent=2))
    if given.write:
        harness.write_result("kill.json", result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
