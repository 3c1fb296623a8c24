"""A residual taken apart by place, regime and time, each part beside the noise floor.

Places are cables, and the modes of the cables that end on one segment. Regimes are what the arm
was doing: load, pose, motion, time; `regimes` names those in which the gap is clearly larger.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.recordings.recording import Recording
from cablesense_sim.arm import Arm

ALL, CABLE, SET, LOOP = "all", "cable", "cable set", "hysteresis"
LOADED, POSE, JOINT, LEVEL, BRANCH, MOTION, TIME, TRIAL = (
    "loaded segment", "pose", "joint bent most", "load level", "loading and unloading",
    "rest and motion", "time", "trial",
)  # fmt: skip
REGIMES = (LOADED, POSE, JOINT, LEVEL, BRANCH, MOTION, TIME)
"""The groups that name a regime; trials only name a time."""
MODES = ("common mode", "bending, y", "bending, z", "self-stress")
BRANCHES = ("before the load", "loading", "unloading", "after the load")
EVERYWHERE = "everywhere alike"

_TOLERANCE = 0.05
"""Share of a trial's peak by which a measured load must move before it counts as moved."""
_BENT_RAD = float(np.deg2rad(1.5))
"""A joint bent by less counts as straight: the small reversals of the protocol stay below."""
_MOVED_RAD = 1e-5
_LARGER = 1.4
"""How many times the RMS of the rest of its group a regime must have: twice the mean square."""
_ABOVE_FLOORS = 2.0
_FEWEST_ROWS = 20
"""Four seconds at 5 Hz; what is shorter can be large by chance."""
_TEXT = {
    LOADED: "load on {}",
    POSE: "{} poses",
    JOINT: "{} bent most",
    LEVEL: "loads {}",
    BRANCH: "{}",
    MOTION: "{}",
    TIME: "{} in the recording",
    LOOP: "loading against unloading",
}

Rows = NDArray[np.bool_]


@dataclass(frozen=True)
class Part:
    """The residual in one member of a group.

    Attributes:
        group: by what the residual is taken apart.
        member: which of that; a place by its name, a regime in plain text.
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


def _measure(group: str, member: str, values_n: Array, floor_n: float) -> Part | None:
    """Measure values (R, C) in N, NaN where a number is missing; None where all are."""
    known = np.isfinite(values_n)
    count = known.sum(axis=0)
    if not count.any():
        return None
    seen = count > 0
    known, values_n, count = known[:, seen], values_n[:, seen], count[seen]
    filled = np.where(known, values_n, 0.0)
    square, mean = (filled**2).sum(axis=0), filled.sum(axis=0) / count
    total = float(square.sum())
    rms_n = float(np.sqrt(total / count.sum()))
    return Part(
        group=group,
        member=member,
        rms_n=rms_n,
        over_floor=rms_n / floor_n if floor_n > 0.0 else np.inf,
        mean_n=float(filled.sum() / count.sum()),
        systematic_share=float((count * mean**2).sum()) / total if total > 0.0 else 0.0,
        count=int(known.any(axis=1).sum()),
    )


def segment_modes_n(residual_n: Array, arm: Arm) -> Array:
    """The modes (R, N, K) of a residual (R, M) in the K cables of each of N segments, N.

    First the common mode, which pretension, creep and compression are in; then bending towards +y
    and +z of the holes, as weight, loads, tilt and joint springs; the other K - 3 are self-stress,
    which neither compresses nor bends the segment. All are orthonormal: each has the noise of one
    cable, and their squares add up to those of the cables. NaN where a cable of the segment has
    none.
    """
    angles, count = arm.cables.angle_deg, arm.cables.per_segment
    n, k = np.arange(arm.segment_count)[:, None], np.arange(count)
    hole = np.deg2rad(angles.first + n * angles.per_segment + k * angles.per_cable)
    spans = np.stack([np.ones_like(hole), np.sin(hole), np.cos(hole)], axis=-1)
    basis, triangle = np.linalg.qr(spans, mode="complete")
    basis[..., :3] *= np.sign(np.diagonal(triangle, axis1=1, axis2=2))[:, None, :]
    by_segment = residual_n.reshape(len(residual_n), arm.segment_count, count)
    return np.einsum("rnk,nkm->rnm", by_segment, basis)


def load_branch(recording: Recording) -> NDArray[np.int64]:
    """Position (R,) in `BRANCHES`, -1 in trials without a load.

    By the load's last move beyond the tolerance.
    """
    size = np.linalg.norm(recording.load_n, axis=-1)
    branch = np.full(len(recording), -1)
    for trial in np.unique(recording.trial):
        rows = np.flatnonzero(recording.trial == trial)
        step = _TOLERANCE * float(size[rows].max())
        if step == 0.0:
            continue
        extreme, rising, loaded = float(size[rows[0]]), bool(size[rows[0]] > step), False
        for row in rows:
            value = float(size[row])
            if (value - extreme) * (1.0 if rising else -1.0) >= 0.0:
                extreme = value
            elif abs(value - extreme) > step:
                extreme, rising = value, not rising
            if value > step:
                branch[row], loaded = 1 if rising else 2, True
            else:
                branch[row] = 3 if loaded else 0
    return branch


def loop_n(recording: Recording, residual_n: Array) -> Array:
    """Half the residual's difference (L, M) between loading and unloading, at L equal levels.

    What friction leaves behind, and nothing that depends on the load alone.
    """
    size, branch = np.linalg.norm(recording.load_n, axis=-1), load_branch(recording)
    found = []
    for trial in np.unique(recording.trial[branch >= 0]):
        here = recording.trial == trial
        level = np.round(size / (_TOLERANCE * size[here].max())).astype(int)
        for at in np.unique(level[here]).tolist():
            ways = [here & (level == at) & np.isin(branch, which) for which in ((0, 1), (2, 3))]
            if all(way.any() for way in ways):
                up, down = (residual_n[way].mean(axis=0) for way in ways)
                found.append((up - down) / 2.0)
    return np.array(found).reshape(-1, residual_n.shape[1])


def row_groups(recording: Recording) -> Iterator[tuple[str, str, Rows]]:
    """Group, member and its rows (R,), members of a group apart from each other."""
    yield from _loads(recording)
    bend = np.linalg.norm(recording.command_rad.reshape(len(recording), -1, 2), axis=-1)
    bent, most = bend.max(axis=1) > _BENT_RAD, bend.argmax(axis=1)
    yield POSE, "straight", ~bent
    yield POSE, "bent", bent
    for n in range(bend.shape[1]):
        yield JOINT, f"joint_{n + 1}", bent & (most == n)
    branch = load_branch(recording)
    for i, name in enumerate(BRANCHES):
        yield BRANCH, name, branch == i
    # the command differs from that of the row before or after, in the same trial
    step = np.abs(np.diff(recording.command_rad, axis=0)).max(axis=1) > _MOVED_RAD
    step &= np.diff(recording.trial) == 0
    moving = np.append(step, False) | np.append(False, step)
    yield MOTION, "at rest", ~moving
    yield MOTION, "moving", moving
    elapsed = recording.time_s - recording.time_s[0]
    third = np.minimum((3.0 * elapsed / max(float(elapsed[-1]), 1e-9)).astype(int), 2)
    for i, name in enumerate(("early", "middle", "late")):
        yield TIME, name, third == i
    for trial in np.unique(recording.trial).tolist():
        yield TRIAL, f"trial {trial}", recording.trial == trial


def _loads(recording: Recording) -> Iterator[tuple[str, str, Rows]]:
    segment = recording.load_segment
    yield LOADED, "no load", segment == 0
    for n in range(1, recording.command_rad.shape[1] // 2 + 1):
        yield LOADED, f"segment_{n}", segment == n
    size = np.linalg.norm(recording.load_n, axis=-1)
    third_n = float(size.max()) / 3.0
    if third_n == 0.0:
        return
    digits = max(0, -int(np.floor(np.log10(third_n))))
    for low, high in pairwise((0.0, third_n, 2.0 * third_n, np.inf)):
        name = f"{low:.{digits}f} to {high:.{digits}f} N"
        name = name if high < np.inf else f"above {low:.{digits}f} N"
        yield LEVEL, name, (segment > 0) & (size > low) & (size <= high)


@dataclass(frozen=True)
class Decomposition:
    """The parts of one residual, and the noise floor beside them."""

    parts: tuple[Part, ...]
    floor_n: float

    @property
    def rms_n(self) -> float:
        """Of the whole residual."""
        return self.of_group(ALL)[0].rms_n

    def of_group(self, group: str) -> tuple[Part, ...]:
        """The members of one group."""
        return tuple(part for part in self.parts if part.group == group)


def decompose(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Decomposition:
    """Take a residual (R, M), measured less predicted, apart; NaN is left out.

    `floor_n` is the root mean square that a perfect model would leave in one reading.

    Raises:
        ValueError: the residual is of other shape than the readings, or has no number at all.
    """
    if residual_n.shape != recording.tensions_n.shape:
        raise ValueError(
            f"the residual is {residual_n.shape}, the readings are {recording.tensions_n.shape}"
        )
    modes = segment_modes_n(residual_n, arm)
    pieces = [
        (ALL, "all", residual_n),
        *((CABLE, f"cable_{i + 1}", residual_n[:, i : i + 1]) for i in range(arm.cable_count)),
        *(
            (SET, f"segment_{n + 1}, {name}", columns)
            for n in range(arm.segment_count)
            for name, columns in zip(MODES, np.split(modes[:, n], [1, 2, 3], axis=1), strict=True)
        ),
        (LOOP, "half the width of the loop", loop_n(recording, residual_n)),
        *((group, member, residual_n[rows]) for group, member, rows in row_groups(recording)),
    ]
    measured = (_measure(*piece, floor_n) for piece in pieces)
    parts = tuple(part for part in measured if part is not None)
    if not parts:
        raise ValueError("the residual has no number that is finite")
    return Decomposition(parts, floor_n)


def regimes(decomposition: Decomposition) -> list[str]:
    """Regimes in plain text, the largest gap first; none where all is within the floor.

    Where a gap is there and no regime stands out, `EVERYWHERE`.
    """
    clear = []
    for group in REGIMES:
        parts = decomposition.of_group(group)
        for part in parts:
            others = [other for other in parts if other is not part]
            rows = sum(other.count for other in others)
            square = sum(other.count * other.rms_n**2 for other in others)
            if (
                others
                and part.count >= _FEWEST_ROWS
                and part.over_floor >= _ABOVE_FLOORS
                and part.rms_n >= _LARGER * np.sqrt(square / rows)
            ):
                clear.append(part)
    clear += [p for p in decomposition.of_group(LOOP) if p.over_floor >= _ABOVE_FLOORS]
    if not clear and decomposition.rms_n >= _ABOVE_FLOORS * decomposition.floor_n:
        return [EVERYWHERE]
    return [
        part.member
        if part.member == "no load"
        else _TEXT[part.group].format(part.member.replace("_", " "))
        for part in sorted(clear, key=lambda part: -part.rms_n)
    ]
