"""The amplifiers' process: plays the course as frames on a pseudo-terminal and keeps a log."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import time
from pathlib import Path

import numpy as np

from cablesense_ros.can.emulation.emulator import Emulator
from cablesense_ros.can.emulation.slcan_port import SlcanPort
from cablesense_ros.can.signal_database import open_channel_map
from cablesense_sim.arm_files import open_arm
from soak.marked_course import marked_course

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
