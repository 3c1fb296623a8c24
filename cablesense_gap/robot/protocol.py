"""The protocol to record of a robot so that effects differ, and the next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.robot.amending import changed
from cablesense_gap.robot.inverse import InverseDynamics
from cablesense_gap.robot.model import Robot, RobotError
from cablesense_gap.robot.motion import Trajectory, derivatives
from cablesense_gap.simulator import Assignment
from cablesense_recording.csv_file import write_table
from cablesense_sim.mujoco_file import JointTie, joint_ties

RATE_HZ = 100.0
_RANGE_SHARE = 0.8
_MOST_RAD = 1.6
_FREE_RAD = 1.2
_FREE_M = 0.1
"""To either side, where the model has no range of a hinge or a slide."""
_LEAST_PERIOD_S = 4.0
_RAD_S = 0.5
_M_S = 0.1
"""Peak speeds of a slow sweep of a hinge and of a slide."""
_FAST_PACE = 2.0
_FURTHER_SWEEPS = (
    ("very slow sweep", 1.0, 0.3),
    ("very fast sweep", 1.0, 4.0),
    ("short sweep", 0.1, 2.0),
)
"""Further sweeps: kind, share of the reach, and how often the usual pace."""
_TOGETHER_S = 20.0
_TOGETHER_TRIALS = 4
_TRIED_POSITIONS = 401
"""Positions of a joint at which those that follow it are looked up."""
_SLOW_SPEED = 0.02
_COMPARED_STRIDE = 10


@dataclass(frozen=True)
class RobotBlock:
    """One trial: its kind, the instruction, and the positions (T, J) at `RATE_HZ`."""

    kind: str
    does: str
    position: Array

    @property
    def duration_s(self) -> float:
        """How long it takes."""
        return len(self.position) / RATE_HZ


def standard_protocol(robot: Robot) -> list[RobotBlock]:
    """Each joint alone slowly and faster, then all at once."""
    ties = _followed_ties(robot)
    following = {tie.joint for tie in ties}
    leading = [j for j in range(len(robot.joints)) if j not in following]
    middle, reach = _ranges(robot, ties)
    speed = np.where([unit == "rad" for unit in robot.position_units], _RAD_S, _M_S)
    period_s = np.maximum(2.0 * np.pi * reach / speed, _LEAST_PERIOD_S)
    blocks = []
    for j in leading:
        for kind, times in (("slow sweep", 1.0), ("fast sweep", _FAST_PACE)):
            swept = _Sweep(j, middle, float(reach[j]), period_s[j] / times)
            blocks.append(_sweep_block(robot, ties, kind, swept))
    rng = np.random.default_rng(0)
    for _ in range(_TOGETHER_TRIALS):
        time_s = np.arange(0.0, _TOGETHER_S, 1.0 / RATE_HZ)
        waves = np.zeros((len(time_s), len(reach)))
        for times in (1.0, _FAST_PACE, 2.0 * _FAST_PACE):
            begin = rng.uniform(0.0, 2.0 * np.pi, len(reach))
            phase_rad = 2.0 * np.pi * times * time_s[:, None] / period_s + begin
            waves += np.sin(phase_rad) * reach / (3.0 * times)
        does = "move all joints at once, each as a sum of three sines"
        if ties:
            named = [robot.joints[tie.joint] for tie in ties]
            does += f"; {' and '.join(named)} {'follow' if len(named) > 1 else 'follows'}"
        blocks.append(RobotBlock("all joints", does, _with_followers(middle + waves, ties)))
    return blocks


class _Sweep(NamedTuple):
    """A sine of one joint about the middle (J,) of all, how far, and how long each time."""

    joint: int
    middle: Array
    reach: float
    period_s: float


def further_blocks(robot: Robot) -> list[RobotBlock]:
    """Blocks beside the protocol's, of which a question may ask for some.

    Each joint goes alone: slower, faster, and to and fro over a short way, which shows how it
    turns round.
    """
    ties = _followed_ties(robot)
    following = {tie.joint for tie in ties}
    middle, reach = _ranges(robot, ties)
    speed = np.where([unit == "rad" for unit in robot.position_units], _RAD_S, _M_S)
    period_s = np.maximum(2.0 * np.pi * reach / speed, _LEAST_PERIOD_S)
    blocks = []
    for j in range(len(robot.joints)):
        if j in following:
            continue
        for kind, share, times in _FURTHER_SWEEPS:
            swept = _Sweep(j, middle, share * float(reach[j]), period_s[j] / times)
            blocks.append(_sweep_block(robot, ties, kind, swept))
    return blocks


def _sweep_block(robot: Robot, ties: Sequence[JointTie], kind: str, swept: _Sweep) -> RobotBlock:
    time_s = np.arange(0.0, max(2.0 * swept.period_s, 6.0), 1.0 / RATE_HZ)
    position = np.tile(swept.middle, (len(time_s), 1))
    position[:, swept.joint] += swept.reach * np.sin(2.0 * np.pi * time_s / swept.period_s)
    centre = float(swept.middle[swept.joint])
    ends = centre - swept.reach, centre + swept.reach
    does = _sweep(robot, swept.joint, ties, *ends, swept.period_s)
    return RobotBlock(kind, does, _with_followers(position, ties))


def _sweep(
    robot: Robot, joint: int, ties: Sequence[JointTie], low: float, high: float, period_s: float
) -> str:
    """What to do with one joint."""
    unit = robot.position_units[joint]
    free = "" if robot.model.jnt_limited[joint] else " (the model has no range of it)"
    moved = [joint]
    for tie in ties:
        moved += [tie.joint] if tie.leader in moved else []
    named = [robot.joints[each] for each in moved[1:]]
    follow = (
        f"{' and '.join(named)} {'follow' if len(named) > 1 else 'follows'}; " if named else ""
    )
    return (
        f"move {robot.joints[joint]} alone between {low:.2g} and {high:.2g} {unit}{free} as a "
        f"sine, {period_s:.0f} s each time; {follow}the others stay at the middle of their ranges"
    )


def _followed_ties(robot: Robot) -> list[JointTie]:
    """Ties by which joints follow, each behind that of its leader.

    In a ring of joints that follow each other the first leads.
    """
    ties = joint_ties(robot.model, robot.path, RobotError)
    pending = {tie.joint: tie for tie in ties}
    ordered: list[JointTie] = []
    while pending:
        ready = [tie for tie in pending.values() if tie.leader not in pending]
        if not ready:
            del pending[next(iter(pending))]
        for tie in ready:
            del pending[tie.joint]
        ordered += ready
    return ordered


def _with_followers(position: Array, ties: Sequence[JointTie]) -> Array:
    """Positions (T, J) with those of joints that follow."""
    followed = position.copy()
    for tie in ties:
        leading = np.zeros(len(position)) if tie.leader is None else followed[:, tie.leader]
        followed[:, tie.joint] = tie.followed(leading)
    return followed


def write_protocol(path: Path, robot: Robot, blocks: Sequence[RobotBlock]) -> int:
    """Write positions as rows of a recording without torques; gives how many.

    Raises:
        RecordingError: the place cannot be written to.
    """
    rows = _rows_of(blocks)
    count = len(rows.position)
    columns = {"time_s": np.arange(count) / RATE_HZ, "trial": rows.block + 1}
    columns |= {f"position.{name}": rows.position[:, j] for j, name in enumerate(robot.joints)}
    write_table(path, columns, "%.6f")
    return count


def next_experiment(robot: Robot, rivals: Sequence[Assignment], floor: Array) -> str:
    """The block of the protocol in which explanations differ most, as text; empty without any.

    `rivals` are the fitted numbers of each, `floor` (J,) the noise of each joint's torque. With
    one of them it is the block that shows most of it.
    """
    if not rivals:
        return ""
    blocks = standard_protocol(robot)
    rows = _rows_of(blocks, _COMPARED_STRIDE)
    moved = [derivatives(block.position, RATE_HZ) for block in blocks]
    speed, acceleration = (
        np.concatenate([each[k][::_COMPARED_STRIDE] for each in moved]) for k in range(2)
    )
    trajectory = Trajectory(
        time_s=np.arange(len(rows.position)) * _COMPARED_STRIDE / RATE_HZ,
        trial=rows.block,
        position=rows.position,
        speed=speed,
        acceleration=acceleration,
        direction=np.clip(speed / _SLOW_SPEED, -1.0, 1.0),
        load=np.zeros_like(rows.position),
        command=np.full((len(rows.position), robot.model.nu), np.nan),
    )
    dynamics = InverseDynamics(robot, trajectory)
    weighed = rivals if len(rivals) > 1 else [{}, *rivals]
    torques = [dynamics.torques(changed(robot, [values])) / floor for values in weighed]
    pairs = [(a - b) ** 2 for a, b in combinations(torques, 2)]
    nearest = np.min([np.bincount(rows.block, pair.mean(1)) for pair in pairs], axis=0)
    size = np.sqrt(nearest / np.bincount(rows.block))
    if not size.max() > 0.0:  # play, which no trajectory shows that was not measured
        return ""
    best = blocks[int(size.argmax())]
    part = "The explanations differ there by" if len(rivals) > 1 else "It shows there as"
    return (
        f"Record several times, as {best.kind}: {best.does}. {part} {size.max():.2g} floors RMS."
    )


def _ranges(robot: Robot, ties: Sequence[JointTie]) -> tuple[Array, Array]:
    """Middle and half width (J,) of what each joint goes through; those that follow stay inside.

    A joint that follows has the width 0 of its own.
    """
    low, high = robot.model.jnt_range.T.copy()
    limited = robot.model.jnt_limited.astype(bool)
    hinges = np.array([unit == "rad" for unit in robot.position_units])
    free = np.where(hinges, _FREE_RAD, _FREE_M)
    start = np.where(limited, 0.5 * (low + high), robot.model.qpos0)
    reach = np.where(limited, np.minimum(0.5 * _RANGE_SHARE * (high - low), _MOST_RAD), free)
    middle = _with_followers(start[None], ties)[0]
    following = [tie.joint for tie in ties]
    for leader in sorted({tie.leader for tie in ties if tie.leader is not None} - {*following}):
        path = np.tile(start, (_TRIED_POSITIONS, 1))
        path[:, leader] += reach[leader] * np.linspace(-1.0, 1.0, _TRIED_POSITIONS)
        followed = _with_followers(path, ties)[:, following]
        inside = (followed >= low[following]) & (followed <= high[following])
        possible = path[(inside | ~limited[following]).all(axis=1), leader]
        if possible.size:
            middle[leader] = 0.5 * (possible.min() + possible.max())
            reach[leader] = 0.5 * (possible.max() - possible.min())
    reach[following] = 0.0
    return _with_followers(middle[None], ties)[0], reach


class _BlockRows(NamedTuple):
    """Rows of blocks, one after the other.

    Attributes:
        position: (R, J).
        block: (R,) numbers of their blocks.
    """

    position: Array
    block: NDArray[np.int64]


def _rows_of(blocks: Sequence[RobotBlock], every: int = 1) -> _BlockRows:
    """All rows of blocks, or one in `every` of them."""
    positions = [block.position[::every] for block in blocks]
    number = np.repeat(np.arange(len(blocks)), [len(each) for each in positions])
    return _BlockRows(np.concatenate(positions), number)
