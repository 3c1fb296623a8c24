"""Tensions in which every cycle bears its number, so that none can be taken for another.

The lowest bit of each of the twelve values spells the cycle's number modulo 4096; the rest is an
arm that is pushed here and there, as its sensors read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray

from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.can.signal_database import channel_signal
from cablesense_sim.arm import Arm
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
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
    mechanism = Mechanism.from_arm(arm)
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
