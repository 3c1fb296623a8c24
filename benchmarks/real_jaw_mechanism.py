"""The jaw's transmission: one joint, driven over two cables that stick and slip at their guides.

The spindle winds one cable up and lets the other out; the jaw's load pulls at their far ends. Each
cable is a chain under the law of `cablesense_sim.cable_chain`. Lengths are radians of the spindle
and tensions N·m at it, as neither radius is known. What turns the spindle against its torque, and
what loads the jaw against that motion, counts as positive: a tool's signs are found from its
recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from real_jaw_baselines import stops
from real_jaw_recordings import SAMPLE_S, JawRecording

from cablesense_base import Array
from cablesense_gap.diagnosis.problem import Problem, prepare
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.cable_chain import CableChains
from cablesense_sim.effects.effect import Parameter, shape

NOISE_NM = 0.002
"""Of the drive's torque: its ripple at constant speed."""

PIECES = 3
PIECE_RAD_NM, PRETENSION_NM = 0.1, 0.05
"""Nominal compliance of each piece, and tension before anything turns."""

CANDIDATES = (
    Candidate(
        "capstan_friction",
        ("cables",),
        (
            Parameter("limit", "1", 0.0, 2.0, 0.2, "ln of the ratio of tensions from end to end"),
            shape("run_rad_nm", "rad/(N·m)", 0.02, 2.0, 0.2, "compliance before the first guide",
                  PIECE_RAD_NM, starts=(0.3,)),
            shape("pretension_nm", "N·m", 0.002, 0.5, 0.05, "of both cables", PRETENSION_NM,
                  starts=(0.02,), trials=(0.01, 0.1)),
        ),
        history_dependent=True,
    ),
    Candidate(
        "coulomb_friction",
        ("drive", "jaw"),
        (
            Parameter("torque_nm", "N·m", 0.0, 0.3, 0.02, "against motion, whatever the load"),
        ),
        history_dependent=True,
    ),
    Candidate(
        "cable_elasticity",
        ("cables",),
        (Parameter("compliance_rad_nm", "rad/(N·m)", 0.0, 3.0, 0.3, "beyond the nominal"),),
    ),
    Candidate(
        "backlash", ("cables",), (Parameter("slack_rad", "rad", 0.0, 0.3, 0.02, "between cables"),)
    ),
    Candidate(
        "sensor_offset",
        ("drive_torque",),
        (Parameter("zero_nm", "N·m", -0.1, 0.1, 0.01, "reading without a torque"),),
    ),
    Candidate(
        "sensor_lag",
        ("drive_torque",),
        (Parameter("time_s", "s", 0.0, 2.0, 0.05, "until 63 % is there"),),
    ),
)  # fmt: skip
TOLERANCES = (
    Candidate("transmission", ("jaw",), (Parameter("ratio", "1", -0.5, 0.5, 0.1, "torque"),)),
    Candidate(
        "zeros", ("drive_torque",), (Parameter("zero_nm", "N·m", -0.05, 0.05, 0.005, "reading"),)
    ),
    Candidate(
        "return_spring",
        ("drive",),
        (Parameter("stiffness_nm_rad", "N·m/rad", -0.2, 0.2, 0.02, "of seals and wires"),),
    ),
)

LIMIT = Term("capstan_friction", "cables", "limit")
RUN_RAD_NM = Term("capstan_friction", "cables", "run_rad_nm")
PRETENSION = Term("capstan_friction", "cables", "pretension_nm")
AT_DRIVE_NM = Term("coulomb_friction", "drive", "torque_nm")
AT_JAW_NM = Term("coulomb_friction", "jaw", "torque_nm")
SOFT_RAD_NM = Term("cable_elasticity", "cables", "compliance_rad_nm")
SLACK_RAD = Term("backlash", "cables", "slack_rad")
OFFSET_NM = Term("sensor_offset", "drive_torque", "zero_nm")
LAG_S = Term("sensor_lag", "drive_torque", "time_s")
RATIO = Term("transmission", "jaw", "ratio")
ZERO_NM = Term("zeros", "drive_torque", "zero_nm")
SPRING_NM_RAD = Term("return_spring", "drive", "stiffness_nm_rad")

_ROWS_PER_PERIOD, _PERIODS = 40, 2
_MOST_STEPS = 25
_ENOUGH_NM = 1e-6
_LONGEST_RAD, _FARTHEST_RAD = 0.1, 10.0
_DIRECTION_RAD = 0.002


class Signs(NamedTuple):
    """Which way a tool's drive and jaw count."""

    drive: float
    jaw: float


def signs(recordings: Sequence[JawRecording]) -> Signs:
    """Friction opposes the drive's motion, and the drive's torque grows with the jaw's load."""
    turned = np.concatenate([np.diff(r.drive_angle_rad) for r in recordings])
    torque = np.concatenate([r.drive_torque_nm[1:] for r in recordings])
    load = np.concatenate([r.jaw_torque_nm[1:] for r in recordings])
    return Signs(
        float(np.sign(np.mean(np.sign(turned) * (torque - torque.mean())))) or 1.0,
        float(np.sign(np.cov(torque, load)[0, 1])) or 1.0,
    )


class Transmission:
    """Transmissions side by side, variant by variant; holds their state."""

    def __init__(self, variants: Sequence[Assignment], turned_rad: Array) -> None:
        """One of each variant, whose drive stands at `turned_rad` (B,) now."""
        more = _of(variants, SOFT_RAD_NM) / PIECES
        parts = np.repeat((PIECE_RAD_NM + more)[:, None], PIECES, axis=1)
        parts[:, 0] = _of(variants, RUN_RAD_NM, PIECE_RAD_NM) + more
        self._parts = np.repeat(parts[:, None], 2, axis=1)
        limit = _of(variants, LIMIT) / (PIECES - 1)
        self._limit = np.broadcast_to(limit[:, None, None], (len(limit), 2, PIECES - 1))
        pretension = _of(variants, PRETENSION, PRETENSION_NM)
        self._slack_rad = 0.5 * _of(variants, SLACK_RAD)
        self._evenly = self._parts * pretension[:, None, None]
        self._begin_rad, self._jaw_rad = turned_rad, np.zeros(len(limit))
        self._ratio, self._at_jaw_nm = 1.0 + _of(variants, RATIO), _of(variants, AT_JAW_NM)
        self._chains = CableChains(
            self._parts, self._lengths(turned_rad), self._limit, np.zeros_like(self._limit)
        )

    def rest(self, turned_rad: Array, load_nm: Array) -> tuple[Array, Array]:
        """Torque (B,) of the cables at the drive, and its derivative by the load.

        The jaw moves only as far as the load and the constant friction at it let it.
        """
        jaw, load = self._jaw_rad, self._ratio * load_nm
        low, high = jaw - _FARTHEST_RAD, jaw + _FARTHEST_RAD
        drive, far, drive_by_rad, far_by_rad = self._torques(turned_rad, jaw)
        way = np.sign(far - load) * (np.abs(far - load) > self._at_jaw_nm)
        for _ in range(_MOST_STEPS):
            left = np.where(way == 0.0, 0.0, far - load - way * self._at_jaw_nm)
            if np.abs(left).max() < _ENOUGH_NM:
                break
            # the far torque falls as the jaw goes on, so that its zero stays between two bounds
            low, high = np.where(left > 0.0, jaw, low), np.where(left < 0.0, jaw, high)
            steep = np.where(far_by_rad < -_ENOUGH_NM, far_by_rad, -_ENOUGH_NM)
            tried = jaw + np.clip(-left / steep, -_LONGEST_RAD, _LONGEST_RAD)
            inside = (tried > low) & (tried < high)
            jaw = np.where(
                np.abs(left) < _ENOUGH_NM, jaw, np.where(inside, tried, 0.5 * (low + high))
            )
            drive, far, drive_by_rad, far_by_rad = self._torques(turned_rad, jaw)
        self._at = turned_rad, jaw
        moves = (way != 0.0) & (far_by_rad < -_ENOUGH_NM)
        slope = self._ratio * drive_by_rad / np.where(moves, far_by_rad, 1.0)
        return drive, np.where(moves, slope, 0.0)

    def settle(self) -> None:
        """Stay where the last rest was."""
        turned_rad, self._jaw_rad = self._at
        self._chains.settle(self._lengths(turned_rad), self._limit)

    def _lengths(self, turned_rad: Array, jaw_rad: Array | None = None) -> Array:
        """(B, 2, K): one cable is wound up by the drive and let out by the jaw, the other not."""
        lengths = self._evenly.copy()
        lengths[..., -1] -= self._slack_rad[:, None]
        lengths[:, :, 0] += np.outer(turned_rad - self._begin_rad, [1.0, -1.0])
        jaw_rad = self._jaw_rad if jaw_rad is None else jaw_rad
        lengths[:, :, -1] -= np.outer(jaw_rad, [1.0, -1.0])
        return lengths

    def _torques(self, turned_rad: Array, jaw_rad: Array) -> tuple[Array, Array, Array, Array]:
        """(B,) at drive and jaw, and their derivatives by the jaw's angle."""
        tensions, by_length = self._chains.pull(self._lengths(turned_rad, jaw_rad), self._limit)
        ends = tensions[:, 0, [0, -1]] - tensions[:, 1, [0, -1]]
        slopes = -by_length[:, :, [0, -1], -1].sum(1)
        return ends[:, 0], ends[:, 1], slopes[:, 0], slopes[:, 1]


@dataclass(frozen=True)
class JawSimulator:
    """A `Simulator` of the drive's torque, from the drive's angle and the jaw's load.

    Rows are a fortieth of a period apart, two periods of each recording, one recording after the
    other: the law knows no time.
    """

    recordings: Sequence[JawRecording]
    signs: Signs
    candidates: Sequence[Candidate] = CANDIDATES
    tolerances: Sequence[Candidate] = TOLERANCES
    floor: float = NOISE_NM

    @cached_property
    def samples(self) -> list[Array]:
        """(T,) numbers of the samples that are rows, of each recording."""
        rows = np.arange(_ROWS_PER_PERIOD * _PERIODS)
        return [
            np.minimum(
                (rows / (r.frequency_hz * _ROWS_PER_PERIOD * SAMPLE_S)).astype(int),
                len(r.drive_angle_rad) - 1,
            )
            for r in self.recordings
        ]

    def rows(self, name: str) -> Array:
        """(N, T) of one signal."""
        return np.array(
            [getattr(r, name)[s] for r, s in zip(self.recordings, self.samples, strict=True)]
        )

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """The drive's torque (P, N T, 1), N·m, against the load."""
        turned = self.signs.drive * self.rows("drive_angle_rad")
        load = self.signs.jaw * self.rows("jaw_torque_nm")
        count, length = turned.shape
        each = [v for v in variants for _ in range(count)]
        turned, load = (np.tile(s, (len(variants), 1)) for s in (turned, load))
        transmission = Transmission(each, turned[:, 0])
        torque = np.empty_like(turned)
        for t in range(length):
            torque[:, t], _ = transmission.rest(turned[:, t], load[:, t])
            transmission.settle()
        torque += beside_cables(each, turned)
        interval_s = np.diff(np.array(self.samples), axis=1, prepend=0) * SAMPLE_S
        torque = lagging(torque, np.tile(interval_s, (len(variants), 1)), _of(each, LAG_S))
        return torque.reshape(len(variants), count * length, 1)


def beside_cables(variants: Sequence[Assignment], turned_rad: Array) -> Array:
    """(B, T) what the drive's torque has besides the cables': friction, spring and zero."""
    direction = np.array([stops(turned, [_DIRECTION_RAD])[:, 0] for turned in turned_rad])
    zero = _of(variants, ZERO_NM) + _of(variants, OFFSET_NM)
    return np.asarray(
        _of(variants, AT_DRIVE_NM)[:, None] * direction
        + _of(variants, SPRING_NM_RAD)[:, None] * turned_rad
        + zero[:, None]
    )


def lagging(signal: Array, interval_s: Array, time_s: Array) -> Array:
    """(B, T) through a first-order lag of each row's time."""
    kept = np.exp(-interval_s / np.maximum(time_s, 1e-6)[:, None])
    out = signal.copy()
    for t in range(1, signal.shape[1]):
        out[:, t] = signal[:, t] + kept[:, t] * (out[:, t - 1] - signal[:, t])
    return out


def problem_of(recordings: Sequence[JawRecording], by: Signs | None = None) -> Problem:
    """The recordings as the diagnosis works on them; levels of the brake are held out together.

    The first half period does not count: what friction held before is unknown.
    """
    simulator = JawSimulator(recordings, by or signs(recordings))
    readings = simulator.rows("drive_torque_nm")
    count, length = readings.shape
    trial = np.repeat(np.arange(count), length)
    levels = np.unique([r.brake_percent for r in recordings], return_inverse=True)[1]
    fold = levels if levels.any() else np.arange(count)
    used = np.tile(np.arange(length) >= _ROWS_PER_PERIOD // 2, count)
    return prepare(simulator, readings.reshape(-1, 1), trial, fold, used)


def _of(variants: Sequence[Mapping[Term, float]], term: Term, absent: float = 0.0) -> Array:
    return np.array([variant.get(term, absent) for variant in variants])
