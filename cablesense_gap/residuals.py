"""A residual by place, regime and time, each part next to the noise floor.

Places are cables, and the modes of the cables that end on one segment. Regimes are conditions of
the arm: load, pose, motion, time. `regimes` names those in which the gap is clearly larger.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of

ALL = "all"
CABLE = "cable"
SET = "cable set"
LOOP = "hysteresis"
LOADED = "loaded segment"
LEVEL = "load level"
TRIAL = "trial"
LOAD_PLACE = "place of the load"
_THIRDS = "near the joint", "amid a segment", "far from the joint"
BRANCHES = ("before the load", "loading", "unloading", "after the load")
EVERYWHERE = "everywhere alike"
_REGIME_TEXT = {
    LOADED: "load on {}",
    "pose": "{} poses",
    "joint bent most": "{} bent most",
    LEVEL: "loads {}",
    LOAD_PLACE: "loads {}",
    "loading and unloading": "{}",
    "rest and motion": "{}",
    "time": "{} in the recording",
}
"""The text of a regime, by its group."""

BENT_RAD = float(np.deg2rad(1.5))
"""A joint bent by less counts as straight: the small reversals of the protocol stay below."""
_LOAD_TOLERANCE = 0.05
"""Share of a trial's peak by which a measured load must move before it counts as moved."""
_MOVED_RAD = 1e-5
"""Change of a command from row to row from which on the arm moves."""
_LARGER_TIMES = 1.4
"""Times the RMS of the rest of its group that a regime has: twice the mean square."""
_ABOVE_FLOORS = 2.0
"""Noise floors (RMS) that a regime has at least."""
_FEWEST_ROWS = 20
"""Of a regime: a shorter one, of 4 s at 5 Hz, can be large by chance."""

Rows = NDArray[np.bool_]


@dataclass(frozen=True)
class Part:
    """The residual in one member of a group.

    Attributes:
        group: the property that divides the residual.
        member: a place by its name, or a regime in plain text.
        over_floor: RMS in noise floors.
        mean_n: signed mean over all its numbers.
        systematic_share: of the mean square, what one constant per channel explains.
        count: rows in it.
    """

    group: str
    member: str
    rms_n: float
    over_floor: float
    mean_n: float
    systematic_share: float
    count: int


@dataclass(frozen=True)
class Decomposition:
    """The parts of one residual, and its noise floor."""

    parts: tuple[Part, ...]
    floor_n: float

    @property
    def rms_n(self) -> float:
        """Root mean square of the whole residual, N."""
        return self.of_group(ALL)[0].rms_n

    def of_group(self, group: str) -> tuple[Part, ...]:
        """The parts of one group, such as `cable`, in their order."""
        return tuple(part for part in self.parts if part.group == group)


def decompose(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Decomposition:
    """Divide a residual (R, M), measured minus predicted; rows with NaN do not count.

    `floor_n` is the root mean square that a perfect model would leave in one reading.

    Raises:
        ValueError: the residual has another shape than the readings, or no finite row.
    """
    if residual_n.shape != recording.tensions_n.shape:
        raise ValueError(
            f"the residual is {residual_n.shape}, the readings are {recording.tensions_n.shape}"
        )
    modes = segment_modes_n(residual_n, arm)
    names = ("common mode", "bending, y", "bending, z", "self-stress")
    pieces = [
        (ALL, "all", residual_n),
        *((CABLE, f"cable_{i + 1}", residual_n[:, i : i + 1]) for i in range(arm.cable_count)),
        *(
            (SET, f"segment_{n + 1}, {name}", columns)
            for n in range(arm.segment_count)
            for name, columns in zip(names, np.split(modes[:, n], [1, 2, 3], axis=1), strict=True)
        ),
        (LOOP, "half the width of the loop", loop_n(recording, residual_n)),
        *((group, member, residual_n[rows]) for group, member, rows in row_groups(recording, arm)),
    ]
    measured = (_measured_part(*piece, floor_n) for piece in pieces)
    parts = tuple(part for part in measured if part is not None)
    if not parts:
        raise ValueError("the residual has no number that is finite")
    return Decomposition(parts, floor_n)


def _measured_part(group: str, member: str, values_n: Array, floor_n: float) -> Part | None:
    """The sizes of values (R, C) in N; None without a finite row."""
    values_n = values_n[np.isfinite(values_n).all(axis=1)]
    if not values_n.size:
        return None
    mean_square = float((values_n**2).mean())
    constant = float((values_n.mean(axis=0) ** 2).mean())
    rms_n = mean_square**0.5
    return Part(
        group=group,
        member=member,
        rms_n=rms_n,
        over_floor=rms_n / floor_n if floor_n > 0.0 else np.inf,
        mean_n=float(values_n.mean()),
        systematic_share=constant / mean_square if mean_square > 0.0 else 0.0,
        count=len(values_n),
    )


def segment_modes_n(residual_n: Array, arm: Arm) -> Array:
    """The modes (R, N, K) of a residual (R, M) in the K cables of each of N segments, N.

    The first is the common mode, as of pretension, creep and compression. The next two are bending
    towards +y and +z of the holes, as of weight, loads, tilt and joint springs. The other K - 3
    are self-stress, which neither compresses nor bends the segment. All are orthonormal: each has
    the noise of one cable, and their squares add up to those of the cables.
    """
    angles = arm.cables.angle_deg
    count = arm.cables.per_segment
    n = np.arange(arm.segment_count)[:, None]
    k = np.arange(count)
    hole = np.deg2rad(angles.first + n * angles.per_segment + k * angles.per_cable)
    spans = np.stack([np.ones_like(hole), np.sin(hole), np.cos(hole)], axis=-1)
    basis, triangle = np.linalg.qr(spans, mode="complete")
    basis[..., :3] *= np.sign(np.diagonal(triangle, axis1=1, axis2=2))[:, None, :]
    by_segment = residual_n.reshape(len(residual_n), arm.segment_count, count)
    return np.einsum("rnk,nkm->rnm", by_segment, basis)


def load_branch(recording: Recording) -> NDArray[np.int64]:
    """Position (R,) in `BRANCHES` by the load's last move; -1 in trials without a load."""
    size = np.linalg.norm(recording.load_n, axis=-1)
    branch = np.full(len(recording), -1)
    for trial in np.unique(recording.trial):
        rows = np.flatnonzero(recording.trial == trial)
        step = _LOAD_TOLERANCE * float(size[rows].max())
        if step == 0.0:
            continue
        extreme = float(size[rows[0]])
        rising = bool(size[rows[0]] > step)
        loaded = False
        for row, value in zip(rows, size[rows].tolist(), strict=True):
            if (value >= extreme) if rising else (value <= extreme):
                extreme = value
            elif abs(value - extreme) > step:
                extreme = value
                rising = not rising
            if value > step:
                branch[row] = 1 if rising else 2
                loaded = True
            else:
                branch[row] = 3 if loaded else 0
    return branch


def loop_n(recording: Recording, residual_n: Array) -> Array:
    """Half the residual's difference (L, M) between loading and unloading, at L equal levels.

    Friction causes such a difference. An effect that depends on the present load alone does not.
    """
    size = np.linalg.norm(recording.load_n, axis=-1)
    branch = load_branch(recording)
    differences = []
    for trial in np.unique(recording.trial[branch >= 0]):
        of_trial = recording.trial == trial
        level = np.round(size / (_LOAD_TOLERANCE * size[of_trial].max())).astype(int)
        for load_level in np.unique(level[of_trial]).tolist():
            ways = [
                of_trial & (level == load_level) & np.isin(branch, which)
                for which in ((0, 1), (2, 3))
            ]
            if all(way.any() for way in ways):
                up, down = (residual_n[way].mean(axis=0) for way in ways)
                differences.append((up - down) / 2.0)
    return np.array(differences).reshape(-1, residual_n.shape[1])


def row_groups(recording: Recording, arm: Arm) -> Iterator[tuple[str, str, Rows]]:
    """Group, member and its rows (R,); members of a group share no row."""
    segment = recording.load_segment
    size = np.linalg.norm(recording.load_n, axis=-1)
    yield LOADED, "no load", segment == 0
    for n in range(1, recording.command_rad.shape[1] // 2 + 1):
        yield LOADED, f"segment_{n}", segment == n
    if (third_n := float(size.max()) / 3.0) > 0.0:
        digits = max(0, -int(np.floor(np.log10(third_n))))
        for low, high in pairwise((0.0, third_n, 2.0 * third_n, np.inf)):
            name = f"{low:.{digits}f} to {high:.{digits}f} N"
            name = name if high < np.inf else f"above {low:.{digits}f} N"
            yield LEVEL, name, (segment > 0) & (size > low) & (size <= high)
    if recording.load_at_m is not None:
        mechanism = mechanism_of(arm)
        segment_index = np.maximum(segment, 1) - 1
        unstated = np.isnan(recording.load_at_m)
        at_m = np.where(unstated, mechanism.contact_m[segment_index], recording.load_at_m)
        third = np.minimum(3.0 * at_m / mechanism.segment_length_m[segment_index], 2.0).astype(int)
        for i, name in enumerate(_THIRDS):
            yield LOAD_PLACE, name, (segment > 0) & (third == i)
    bend = np.linalg.norm(recording.command_rad.reshape(len(recording), -1, 2), axis=-1)
    bent = bend.max(axis=1) > BENT_RAD
    most = bend.argmax(axis=1)
    yield "pose", "straight", ~bent
    yield "pose", "bent", bent
    for n in range(bend.shape[1]):
        yield "joint bent most", f"joint_{n + 1}", bent & (most == n)
    branch = load_branch(recording)
    for i, name in enumerate(BRANCHES):
        yield "loading and unloading", name, branch == i
    # a moving row has another command than the row before or after it, in the same trial
    step = np.abs(np.diff(recording.command_rad, axis=0)).max(axis=1) > _MOVED_RAD
    step &= np.diff(recording.trial) == 0
    moving = np.append(step, False) | np.append(False, step)
    yield "rest and motion", "at rest", ~moving
    yield "rest and motion", "moving", moving
    elapsed = recording.time_s - recording.time_s[0]
    third = np.minimum((3.0 * elapsed / max(float(elapsed[-1]), 1e-9)).astype(int), 2)
    for i, name in enumerate(("early", "middle", "late")):
        yield "time", name, third == i
    for trial in np.unique(recording.trial).tolist():
        yield TRIAL, f"trial {trial}", recording.trial == trial


def regimes(decomposition: Decomposition) -> list[str]:
    """Regimes in plain text, the largest gap first; none if the whole gap is near the floor.

    `EVERYWHERE` if there is a gap and no regime in which it is clearly larger.
    """
    clear: list[tuple[float, str]] = []
    for group, text in _REGIME_TEXT.items():
        parts = decomposition.of_group(group)
        for part in parts:
            others = [other for other in parts if other is not part]
            rows = sum(other.count for other in others)
            square = sum(other.count * other.rms_n**2 for other in others)
            if (
                others
                and part.count >= _FEWEST_ROWS
                and part.over_floor >= _ABOVE_FLOORS
                and part.rms_n >= _LARGER_TIMES * np.sqrt(square / rows)
            ):
                name = part.member.replace("_", " ")
                clear.append((part.rms_n, name if name == "no load" else text.format(name)))
    for loop in decomposition.of_group(LOOP):
        if loop.over_floor >= _ABOVE_FLOORS:
            clear.append((loop.rms_n, "loading against unloading"))
    if not clear and decomposition.rms_n >= _ABOVE_FLOORS * decomposition.floor_n:
        return [EVERYWHERE]
    return [text for _, text in sorted(clear, key=lambda each: -each[0])]
