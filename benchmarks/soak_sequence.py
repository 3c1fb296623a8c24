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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray

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

BITRATES_BIT_S = (500_000, 1_000_000)
SERIAL_BYTES_S = {
    "serial 115,200 bit/s": 11_520,
    "serial 1 Mbit/s": 100_000,
    "serial 3 Mbit/s": 300_000,
    "USB CDC, full speed (19 bulk packets of 64 bytes a ms)": 1_216_000,
}
"""A byte on a serial line is ten bits."""

FALSE_FORCE_N = 1.0
"""A wrench beyond this while nothing pushes is a false force."""

NEAR_CYCLES = 300
"""A sample that waited in the terminal is at most so many cycles old."""

JUDGED_AT_ONCE = 100_000
FIRST_MINUTE_S = 60.0


@dataclass(frozen=True)
class MarkedSequence:
    """A sequence of T rows that is played again and again.

    Attributes:
        even: (T, M) readings in steps of the signals, every one even.
        step_n: tension of one step, N.
        force_n: (T,) magnitude of the push.
        segment: (T,) the pushed one, 0 for none.
        held: (T,) whether the push, or its absence, is steady.
    """

    even: NDArray[np.int64]
    step_n: float
    force_n: NDArray[np.float64]
    segment: NDArray[np.int64]
    held: NDArray[np.bool_]

    @property
    def modulo(self) -> int:
        """The numbers that a row can spell."""
        return 1 << self.even.shape[1]

    def steps(self, cycle: NDArray[np.int64]) -> NDArray[np.int64]:
        """(C, M) readings of cycles (C,), in steps."""
        bits = (cycle[:, None] >> np.arange(self.even.shape[1])) & 1
        return self.even[cycle % len(self.even)] + bits

    def spelt(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """(C,) numbers, modulo `modulo`, that rows (C, M) bear."""
        return ((steps & 1) << np.arange(steps.shape[1])).sum(axis=1)


def marked_sequence(arm: Arm, channel_map: ChannelMap, database: Database, rate_hz: float) -> (
    MarkedSequence
):  # fmt: skip
    """The sequence of an arm in the steps of its amplifier; all channels have one step."""
    (step_n,) = {
        abs(signal_conversion(database, channel)[1] * channel.scale_n_per_unit)
        for channel in channel_map.channels.values()
    }
    rng = np.random.default_rng(0)
    rows: list[tuple[int, float, float, bool]] = []
    for segment, angle_deg, from_n, to_n, seconds in _pushes(arm.segment_count, rng):
        count = round(seconds * rate_hz)
        for force_n in np.linspace(from_n, to_n, count, endpoint=False):
            rows.append((segment, angle_deg, force_n, from_n == to_n))
    segment, angle_deg, force_n, held = map(np.array, zip(*rows, strict=True))
    mechanism = mechanism_of(arm)
    commands = np.zeros((len(rows), arm.joint_count))
    forces = normal_force_n(mechanism, commands, np.maximum(segment, 1), angle_deg, force_n)
    tensions = solve_equilibrium(mechanism, commands, forces).tensions_n
    readings = read_tensions_n(tensions, arm.sensors, rng)
    even = 2 * np.rint(readings / (2.0 * step_n)).astype(np.int64)
    return MarkedSequence(even, step_n, force_n, segment, held)


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
    `dropped` how many of its frames the terminal did not take, `real_time` whether the process
    was scheduled as such.
    """
    arm = open_arm(arm_name)
    channel_map, database = open_channel_map(map_name)
    channel_map = channel_map.arranged(arm.cable_names)
    sequence = marked_sequence(arm, channel_map, database, rate_hz)
    port = SlcanPort(link)
    emulator = Emulator(channel_map, database, lambda: port)
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
    real_time = os.sched_getscheduler(0) == os.SCHED_FIFO
    began_s = time.monotonic()
    for cycle in range(cycles):
        at = cycle % BLOCK
        if at == 0:
            rows = (sequence.steps(np.arange(cycle, cycle + BLOCK)) * sequence.step_n).tolist()
        wait_s = began_s + cycle / rate_hz - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        before = port.dropped
        emulator.cycle(rows[at])
        written_ns[cycle] = time.time_ns()
        dropped[cycle] = port.dropped - before
    np.savez(log, written_ns=written_ns, dropped=dropped, real_time=real_time)
    print("played", flush=True)
    sys.stdin.readline()  # the port stays until the benchmark has received all
    emulator.close()
    return 0


def line_limits(data_bytes: Sequence[int], rate_hz: float) -> dict[str, Any]:
    """Loads and limits of bus and adapter for a cycle of frames with so many data bytes each.

    A classical frame with an id of 11 bits, worst stuffing and the space after it; over slcan
    `tIIIL`, two digits a byte, and a return.
    """
    bits = sum(47 + 8 * size + (34 + 8 * size - 1) // 4 for size in data_bytes)
    line = sum(6 + 2 * size for size in data_bytes)
    return {
        "frames of a cycle": len(data_bytes),
        "bytes of a cycle over slcan": line,
        "frames (1/s)": len(data_bytes) * rate_hz,
        "bytes over slcan (1/s)": line * rate_hz,
        "bus": {
            f"{bitrate // 1000} kbit/s": {
                "load": round(bits * rate_hz / bitrate, 3),
                "most cycles (1/s)": bitrate // bits,
            }
            for bitrate in BITRATES_BIT_S
        },
        "adapter line": {
            name: {
                "load": round(line * rate_hz / bytes_s, 3),
                "most cycles (1/s)": bytes_s // line,
            }
            for name, bytes_s in SERIAL_BYTES_S.items()
        },
    }


class Log:
    """Arrivals of one topic, at most `size`, as bytes in memory that is reserved at once."""

    def __init__(self, size: int, numbers: int) -> None:
        """A message ends with so many `numbers`."""
        self.count = self.lost_at_sink = 0
        self._arrived_ns = np.zeros(size, dtype=np.int64)
        self._kind = np.dtype(
            [("s", "<i4"), ("ns", "<u4"), ("letter", "u1"), ("numbers", "<f8", numbers)]
        )
        self._bytes = bytearray(size * self._kind.itemsize)

    def note(self, raw: bytes) -> None:
        """Keep the stamp, the last letter of segment_N and the numbers at the end."""
        at, size = self.count, self._kind.itemsize
        if at < len(self._arrived_ns):
            self._arrived_ns[at] = time.time_ns()
            kept = raw[4:12] + raw[24:25] + raw[9 - size :]
            self._bytes[at * size : (at + 1) * size] = kept
            self.count = at + 1

    def lost(self, event: Any) -> None:
        """Count messages that did not reach this process, as the middleware reports."""
        self.lost_at_sink += event.total_count_change

    @property
    def arrived_ns(self) -> NDArray[np.int64]:
        """(C,) times of arrival."""
        return self._arrived_ns[: self.count]

    @property
    def _rows(self) -> NDArray[np.void]:
        return np.frombuffer(self._bytes, self._kind)[: self.count]

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(C,) the stamps in their headers."""
        return self._rows["s"].astype(np.int64) * 1_000_000_000 + self._rows["ns"]

    @property
    def numbers(self) -> NDArray[np.float64]:
        """(C, n) the last numbers of each."""
        return self._rows["numbers"]

    @property
    def segments(self) -> NDArray[np.int64]:
        """(C,) the digit that ends the frame's name, 0 where there is none."""
        digits = self._rows["letter"].astype(np.int64) - ord("0")
        return np.where((digits >= 0) & (digits <= 9), digits, 0)


def delivery(
    sequence: MarkedSequence,
    dropped: NDArray[np.int64],
    written_ns: NDArray[np.int64],
    tensions: Log,
    rate_hz: float,
) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Counts of what was delivered, by value; also the cycle (C,) of each sample, -1 for none.

    A sample's number is spelt modulo `sequence.modulo`; its time of arrival gives the rest.
    """
    steps = np.rint(tensions.numbers / sequence.step_n).astype(np.int64)
    guess = np.searchsorted(written_ns, tensions.arrived_ns) - 1
    off = (sequence.spelt(steps) - guess) % sequence.modulo
    off -= np.where(off > sequence.modulo // 2, sequence.modulo, 0)
    cycle = guess + off
    cycle[(cycle < 0) | (cycle >= len(written_ns))] = -1
    known = cycle >= 0
    right = np.zeros(len(cycle), dtype=bool)
    mixed = np.zeros(len(cycle), dtype=bool)
    for start in range(0, len(cycle), JUDGED_AT_ONCE):
        part = slice(start, start + JUDGED_AT_ONCE)
        right[part] = (sequence.steps(cycle[part]) == steps[part]).all(axis=1) & known[part]
    wrong = np.flatnonzero(~right)
    mixed[wrong] = _of_neighbours(sequence, guess[wrong], steps[wrong])
    on_wire = dropped == 0
    came = np.bincount(cycle[right], minlength=len(written_ns))
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
    sequence: MarkedSequence, near: NDArray[np.int64], steps: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether rows (C, M) are made of two cycles, one behind the other, near the cycles (C,).

    Without a counter in the frames that is what a lost one may do.
    """
    found = np.zeros(len(steps), dtype=bool)
    for back in range(NEAR_CYCLES):
        cycle = np.maximum(near - back, 1)
        one, other = sequence.steps(cycle), sequence.steps(cycle - 1)
        found |= ((steps == one) | (steps == other)).all(axis=1)
    return found


def answers(
    sequence: MarkedSequence,
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
    row = cycle[known] % len(sequence.even)
    tared = np.zeros(len(row), dtype=bool)
    tared[np.flatnonzero(sequence.force_n[row] > 0.0)[:1].sum() :] = True
    judged = sequence.held[row] & tared
    force = np.linalg.norm(wrenches.numbers[wrench[known]][:, :3], axis=1)
    segment = wrenches.segments[wrench[known]]
    pushed = judged & (sequence.segment[row] > 0)
    free = judged & (sequence.segment[row] == 0)
    error = np.abs(force - sequence.force_n[row])[pushed]
    hits = (segment == sequence.segment[row])[pushed]
    return {
        "wrenches heard": wrenches.count,
        "samples answered": int(answered.sum()),
        "samples not answered": int((~answered).sum()),
        "latency from the last frame to the wrench (ms)": _spread_ms(to_wrench),
        "latency from the last frame to the sample (ms)": _spread_ms(to_sample),
        "force": {
            "samples judged, pushed": int(pushed.sum()),
            "right segment (%)": round(100.0 * float(hits.mean()), 3),
            "error (N): median, 99 %, worst": _percentiles(error, (50.0, 99.0, 100.0)),
            "samples judged, untouched": int(free.sum()),
            "false forces": int((force[free] > FALSE_FORCE_N).sum()),
        },
    }


def memory(notes: Sequence[tuple[float, dict[str, float]]]) -> dict[str, Any]:
    """MB of each process: at a minute, at the end, the line through what is between, and most.

    Runs of up to two minutes count from their first quarter.
    """
    times = np.array([elapsed_s for elapsed_s, _ in notes])
    settled_s = FIRST_MINUTE_S if times[-1] > 2 * FIRST_MINUTE_S else times[-1] / 4
    later = times >= settled_s
    at, grown = times[later], {}
    for name in notes[0][1]:
        rss = np.array([mb[name] for _, mb in notes])[later]
        slope = np.polyfit(at, rss, 1)[0]
        numbers = {
            "MB when settled": rss[0],
            "MB at the end": rss[-1],
            "growth at most (MB)": rss.max() - rss[0],
            "growth by the fitted line (MB)": slope * (at[-1] - at[0]),
            "fitted line (kB a minute)": slope * 60e3,
        }
        grown[name] = {key: round(float(value), 2) for key, value in numbers.items()}
    return {"settled after (s)": round(float(settled_s), 1), **grown}


def _spread_ms(ns: NDArray[np.int64]) -> dict[str, float]:
    names = ("median", "95 %", "99 %", "99.9 %", "worst")
    values = _percentiles(ns / 1e6, (50.0, 95.0, 99.0, 99.9, 100.0))
    return dict(zip(names, values, strict=True))


def _percentiles(values: NDArray[np.float64], at: Sequence[float]) -> list[float]:
    return np.percentile(values, at).round(3).tolist() if len(values) else []
