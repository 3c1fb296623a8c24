"""Tensions in which every cycle bears its number, so that none can be taken for another.

The lowest bit of each of the twelve values spells the cycle's number modulo 4096; the rest is an
arm that is pushed here and there, as its sensors read it.

The amplifiers' process: plays the course as frames on a pseudo-terminal and keeps a log.

What bus and adapter can carry of a map's frames: arithmetic, not measurement.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray

from cablesense_online.can.channel_map import ChannelMap, channel_signal, open_channel_map
from cablesense_online.can.emulator import Emulator
from cablesense_online.can.slcan import SlcanPort
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.sensors import read_tensions_n

PUSHES = 24
HOLD_S, REST_S, RAMP_S = 1.0, 0.6, 0.2
UNTOUCHED_S = 3.0
"""Of each course's beginning, for the tare."""


@dataclass(frozen=True)
class MarkedCourse:
    """A course of T rows that is gone through again and again.

    Attributes:
        even: (T, M) readings in steps of the signals, every one even.
        step_n: tension of one step, N.
        force_n: (T,) magnitude of the push.
        segment: (T,) that is pushed, 0 for none.
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


def marked_course(arm: Arm, channel_map: ChannelMap, database: Database, rate_hz: float) -> (
    MarkedCourse
):  # fmt: skip
    """The course of an arm in the steps of its amplifier; all channels have one step."""
    (step_n,) = {
        abs(channel_signal(database, channel).factor * channel.scale_n_per_unit)
        for channel in channel_map.channels.values()
    }
    rng = np.random.default_rng(0)
    segment, angle_deg, force_n, held = _pushes(arm, rate_hz, rng)
    mechanism = mechanism_of(arm)
    forces = np.stack([
        normal_force_n(
            mechanism,
            np.zeros(arm.joint_count),
            segment=max(1, int(one)),
            angle_deg=float(angle),
            magnitude_n=float(force),
        )
        for one, angle, force in zip(segment, angle_deg, force_n, strict=True)
    ])  # fmt: skip
    tensions = solve_equilibrium(
        mechanism, np.zeros((len(forces), arm.joint_count)), forces
    ).tensions_n
    readings = read_tensions_n(tensions, arm.sensors, rng)
    even = 2 * np.rint(readings / (2.0 * step_n)).astype(np.int64)
    return MarkedCourse(even, step_n, force_n, segment, held)


def _pushes(
    arm: Arm, rate_hz: float, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    columns: Sequence[list[NDArray[np.float64]]] = ([], [], [], [])

    def add(seconds: float, segment: int, angle: float, from_n: float, to_n: float) -> None:
        rows = round(seconds * rate_hz)
        ramp = from_n != to_n
        for column, values in zip(
            columns,
            (
                np.full(rows, segment if max(from_n, to_n) else 0),
                np.full(rows, angle),
                np.linspace(from_n, to_n, rows, endpoint=False),
                np.full(rows, not ramp),
            ),
            strict=True,
        ):
            column.append(values)

    add(UNTOUCHED_S, 0, 0.0, 0.0, 0.0)
    for number in range(PUSHES):
        segment = 1 + number % arm.segment_count
        angle, force = float(rng.uniform(0.0, 360.0)), float(rng.uniform(20.0, 100.0))
        add(RAMP_S, segment, angle, 0.0, force)
        add(HOLD_S, segment, angle, force, force)
        add(RAMP_S, segment, angle, force, 0.0)
        add(REST_S, 0, 0.0, 0.0, 0.0)
    segment, angle_deg, force_n, held = (np.concatenate(column) for column in columns)
    return segment.astype(np.int64), angle_deg, force_n, held.astype(bool)


REAL_TIME_PRIORITY = 10
BLOCK = 1000
"""Cycles whose tensions are made at once: in a cycle's own time numpy would be dear."""


def play(arm_name: str, map_name: str, link: str, rate_hz: float, cycles: int, log: Path) -> int:
    """Wait for a line on stdin, play `cycles`, write the log.

    The log's `written_ns` is when the last frame of each cycle was on the pseudo-terminal, and
    `dropped` how many of its frames the terminal did not take, `real_time` whether the process
    was scheduled as such.
    """
    arm = open_arm(arm_name)
    channel_map, database = open_channel_map(map_name)
    channel_map = channel_map.arranged(arm.cable_names)
    course = marked_course(arm, channel_map, database, rate_hz)
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
            rows = (course.steps(np.arange(cycle, cycle + BLOCK)) * course.step_n).tolist()
        wait_s = began_s + cycle / rate_hz - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        before = port.dropped
        emulator.cycle(rows[at])
        written_ns[cycle] = time.time_ns()
        dropped[cycle] = port.dropped - before
    np.savez(log, written_ns=written_ns, dropped=dropped, real_time=real_time)
    print("played", flush=True)
    sys.stdin.readline()  # the port stays until the benchmark has heard all
    emulator.close()
    return 0


BITRATES_BIT_S = (500_000, 1_000_000)
SERIAL_BYTES_S = {
    "serial 115,200 bit/s": 11_520,
    "serial 1 Mbit/s": 100_000,
    "serial 3 Mbit/s": 300_000,
    "USB CDC, full speed (19 bulk packets of 64 bytes a ms)": 1_216_000,
}
"""A byte on a serial line is ten bits."""


def frame_bits(data_bytes: int) -> int:
    """Bits of a classical frame with an id of 11 bits, worst stuffing and the space after it."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def line_bytes(data_bytes: int) -> int:
    """Bytes of a frame over slcan: `tIIIL`, two digits a byte, and a return."""
    return 6 + 2 * data_bytes


def line_limits(data_bytes: Sequence[int], rate_hz: float) -> dict[str, Any]:
    """Loads and limits of a cycle whose frames have so many data bytes each."""
    bits = sum(map(frame_bits, data_bytes))
    line = sum(map(line_bytes, data_bytes))
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
