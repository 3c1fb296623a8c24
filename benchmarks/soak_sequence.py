"""Tensions in which every cycle bears its number, how they are played, and how runs are judged.

The lowest bit of each of the twelve values spells the cycle's number modulo 4096, so that no
cycle can be mistaken for another; the rest is an arm under changing pushes, as its sensors read
it. The amplifiers' process plays them as frames on a pseudo-terminal and keeps a log.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from cantools.database.can import Database
from harness import percentiles
from live_run import Arrivals, Integers
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_online.can.channel_map import ChannelMap, open_channel_map, signal_conversion
from cablesense_online.can.emulator import Emulator
from cablesense_online.can.slcan import SlcanPort
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n

PUSHES = 24
HOLD_S, REST_S, RAMP_S = 1.0, 0.6, 0.2
UNTOUCHED_S = 3.0
"""Before the first push, for the tare."""

REAL_TIME_PRIORITY = 10
BLOCK = 1000
"""Cycles whose tensions are made at once: in a cycle's own time numpy would be expensive."""

FALSE_FORCE_N = 1.0
"""A wrench beyond this while nothing pushes is a false force."""

JUDGED_AT_ONCE = 100_000
FIRST_MINUTE_S = 60.0


class MarkedSequence(NamedTuple):
    """A sequence of T rows that is played again and again.

    Attributes:
        even: (T, M) readings in steps of the signals, every one even.
        step_n: tension of one step, N.
        force_n: (T,) magnitude of the push.
        segment: (T,) the pushed one, 0 for none.
        held: (T,) whether the push, or its absence, is steady.
    """

    even: Integers
    step_n: float
    force_n: Array
    segment: Integers
    held: NDArray[np.bool_]

    @property
    def modulo(self) -> int:
        """The numbers that a row can spell."""
        return 1 << self.even.shape[1]

    def steps(self, cycle: Integers) -> Integers:
        """(C, M) readings of cycles (C,), in steps."""
        bits = (cycle[:, None] >> np.arange(self.even.shape[1])) & 1
        return self.even[cycle % len(self.even)] + bits

    def spelt(self, steps: Integers) -> Integers:
        """(C,) numbers, modulo `modulo`, that rows (C, M) bear."""
        return ((steps & 1) << np.arange(steps.shape[1])).sum(axis=1)


def marked_sequence(
    arm: Arm, channel_map: ChannelMap, database: Database, rate_hz: float
) -> MarkedSequence:
    """The sequence of an arm in the steps of its amplifier; all channels have one step."""
    (step_n,) = {
        abs(signal_conversion(database, channel)[1] * channel.scale_n_per_unit)
        for channel in channel_map.channels.values()
    }
    rng = np.random.default_rng(0)
    rows = [
        (segment, angle_deg, force_n, from_n == to_n)
        for segment, angle_deg, from_n, to_n, seconds in _pushes(arm.segment_count, rng)
        for force_n in np.linspace(from_n, to_n, round(seconds * rate_hz), endpoint=False)
    ]
    segments, angles_deg, forces_n, held = (np.array(one) for one in zip(*rows, strict=True))
    mechanism = mechanism_of(arm)
    commands = np.zeros((len(rows), arm.joint_count))
    forces = normal_force_n(mechanism, commands, np.maximum(segments, 1), angles_deg, forces_n)
    tensions = solve_equilibrium(mechanism, commands, forces).tensions_n
    readings = read_tensions_n(tensions, arm.sensors, rng)
    even = 2 * np.rint(readings / (2.0 * step_n)).astype(np.int64)
    return MarkedSequence(even, step_n, forces_n, segments, held)


def _pushes(
    segments: int, rng: np.random.Generator
) -> Iterator[tuple[int, float, float, float, float]]:
    """Segment, angle (degrees), force at the beginning and at the end (N), and seconds."""
    yield 0, 0.0, 0.0, 0.0, UNTOUCHED_S
    for number in range(PUSHES):
        segment = 1 + number % segments
        angle_deg, force_n = float(rng.uniform(0.0, 360.0)), float(rng.uniform(20.0, 100.0))
        yield segment, angle_deg, 0.0, force_n, RAMP_S
        yield segment, angle_deg, force_n, force_n, HOLD_S
        yield segment, angle_deg, force_n, 0.0, RAMP_S
        yield 0, 0.0, 0.0, 0.0, REST_S


def play(arm_name: str, map_name: str, link: str, rate_hz: float, cycles: int, log: Path) -> int:
    """Wait for a line on stdin, play `cycles`, write the log.

    The log's `written_ns` is when the last frame of each cycle was on the pseudo-terminal, and
    `dropped` how many of its frames the terminal did not take.
    """
    arm = open_arm(arm_name)
    channel_map, database = open_channel_map(map_name)
    channel_map = channel_map.arranged(arm.cable_names)
    sequence = marked_sequence(arm, channel_map, database, rate_hz)
    emulator = Emulator(channel_map, database, lambda: SlcanPort(link))
    written_ns = np.zeros(cycles, dtype=np.int64)
    dropped = np.zeros(cycles, dtype=np.int64)
    print("ready", flush=True)
    if not sys.stdin.readline():
        return 1
    rows: list[list[float]] = []
    gc.collect()
    gc.freeze()
    with contextlib.suppress(OSError):  # hardware does not wait for this machine's scheduler
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
    began_s = time.monotonic()
    for cycle in range(cycles):
        at = cycle % BLOCK
        if at == 0:
            rows = (sequence.steps(np.arange(cycle, cycle + BLOCK)) * sequence.step_n).tolist()
        wait_s = began_s + cycle / rate_hz - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        before = emulator.dropped
        emulator.cycle(rows[at])
        written_ns[cycle] = time.time_ns()
        dropped[cycle] = emulator.dropped - before
    np.savez(log, written_ns=written_ns, dropped=dropped)
    print("played", flush=True)
    sys.stdin.readline()  # the port stays until the benchmark has received all
    emulator.close()
    return 0


def delivery(
    sequence: MarkedSequence, dropped: Integers, written_ns: Integers, tensions: Arrivals
) -> tuple[dict[str, Any], Integers]:
    """Counts of delivered cycles, by value; also the cycle (C,) of each sample, -1 for none.

    A sample's number is spelt modulo `sequence.modulo`; its time of arrival gives the rest.
    """
    steps = np.rint(tensions.numbers / sequence.step_n).astype(np.int64)
    guess = np.searchsorted(written_ns, tensions.arrived_ns) - 1
    off = (sequence.spelt(steps) - guess) % sequence.modulo
    cycle = guess + off - np.where(off > sequence.modulo // 2, sequence.modulo, 0)
    cycle[(cycle < 0) | (cycle >= len(written_ns))] = -1
    right = cycle >= 0
    for start in range(0, len(cycle), JUDGED_AT_ONCE):
        part = slice(start, start + JUDGED_AT_ONCE)
        right[part] &= (sequence.steps(cycle[part]) == steps[part]).all(axis=1)
    came = np.bincount(cycle[right], minlength=len(written_ns))
    lost = (dropped == 0) & (came == 0)
    return {
        "cycles played": len(written_ns),
        "cycles whole on the terminal": int((dropped == 0).sum()),
        "frames that the terminal did not take": int(dropped.sum()),
        "samples published, as heard": len(cycle),
        "samples with a value that was not sent": int((~right).sum()),
        "samples heard twice": int((came > 1).sum()),
        "samples out of order": int((np.diff(cycle[right]) <= 0).sum()),
        "cycles delivered but not published": int(lost.sum()),
    }, np.where(right, cycle, -1)


def answers(
    sequence: MarkedSequence,
    cycle: Integers,
    written_ns: Integers,
    tensions: Arrivals,
    wrenches: Arrivals,
) -> dict[str, Any]:
    """Whether each sample was answered, how soon, and how well."""
    order = np.argsort(wrenches.stamps_ns, kind="stable")
    stamps = wrenches.stamps_ns[order]
    at = np.minimum(np.searchsorted(stamps, tensions.stamps_ns), len(stamps) - 1)
    answered = stamps[at] == tensions.stamps_ns
    known = answered & (cycle >= 0)
    wrench = order[at][known]
    to_wrench = wrenches.arrived_ns[wrench] - written_ns[cycle[known]]
    row = cycle[known] % len(sequence.even)
    tared = np.cumsum(sequence.force_n[row] > 0.0) > 0
    judged = sequence.held[row] & tared
    force = np.linalg.norm(wrenches.numbers[wrench][:, :3], axis=1)
    pushed = judged & (sequence.segment[row] > 0)
    free = judged & (sequence.segment[row] == 0)
    hits = (wrenches.segments[wrench] == sequence.segment[row])[pushed]
    error_n = np.abs(force - sequence.force_n[row])[pushed]
    return {
        "samples answered": int(answered.sum()),
        "samples not answered": int((~answered).sum()),
        "latency from the last frame to the wrench (ms)": percentiles(
            to_wrench / 1e6, ("median", "99 %", "worst")
        ),
        "force": {
            "samples judged, pushed": int(pushed.sum()),
            "right segment (%)": round(100.0 * float(hits.mean()), 3),
            "error (N)": percentiles(error_n, ("median", "99 %", "worst")),
            "samples judged, untouched": int(free.sum()),
            "false forces": int((force[free] > FALSE_FORCE_N).sum()),
        },
    }


def memory(notes: Sequence[tuple[float, dict[str, float]]]) -> dict[str, Any]:
    """MB of each process: at a minute, at the end, and by how much it grew at most.

    Runs of up to two minutes count from their first quarter.
    """
    taken = pd.DataFrame([mb for _, mb in notes], index=[elapsed_s for elapsed_s, _ in notes])
    later = taken[taken.index >= min(FIRST_MINUTE_S, taken.index[-1] / 4)]
    metrics = {
        "MB when settled": later.iloc[0],
        "MB at the end": later.iloc[-1],
        "growth at most (MB)": later.max() - later.iloc[0],
    }
    return dict(pd.DataFrame(metrics).round(2).to_dict(orient="index"))
