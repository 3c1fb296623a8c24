"""The protocol: poses, loads and holds to record, so that effects can be distinguished.

docs/recordings.md says which effects each part shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_recording.recording import Recording, given_places
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import reading_variance_n2
from cablesense_sim.touch import touched_places

STRONGEST_N = 60.0
"""A person can hang this on an arm, or pull it over a pulley, without a crane."""
DIRECTIONS: dict[str, tuple[float, float, float]] = {
    "down": (0.0, 0.0, -1.0),
    "to the left": (0.0, 1.0, 0.0),
    "to the right": (0.0, -1.0, 0.0),
    "up and to the right": (0.0, -(0.5**0.5), 0.5**0.5),
    "down and to the left": (0.0, 0.5**0.5, -(0.5**0.5)),
    "down and to the right": (0.0, -(0.5**0.5), -(0.5**0.5)),
}
"""Unit vectors of the base frame, as someone sees them who looks along the arm from its base."""

_LOAD_STEPS = 30
"""Loads are whole multiples of the strongest by this, so that they can be set by hand."""
_TAUT_SHARE = 0.1
"""Cables keep this share of their pretension, so that manufacturing tolerances leave them taut."""
_BEYOND_SLACK = 1.5
"""A load that is to slacken a cable, by the weakest one that does: slack for part of the way."""
_REST_MARGIN = 1.3
"""By how much the nominal arm bears more than a load of the protocol: the real one may bear
less."""
_RANGE_SHARE = 0.9
"""Share of a sensor's range that a load may reach."""
_WORTH_FLOORS = 20.0
"""Noise floors by which a load must change the reading of some cable: it is then known to 5 %."""
_FROM_THE_ENDS = 1.0 / 6.0
"""Near and far loads act this share of the contact range from its ends, in its outer thirds."""

_STRAIGHT_SIDES = ("down", "to the left", "up and to the right")
_SLACKENING_SIDES = ("down", "to the right")
_NEAR_PLACE, _MIDDLE_PLACE, _FAR_PLACE = range(3)
_RISING_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the peak at which a load that rises in steps is held."""
_SPEED_RAD_S = float(np.deg2rad(5.0))
"""Of joints on their way: slow enough that the arm does not swing."""
_LARGEST_ANGLE_RAD = float(np.deg2rad(11.0))
"""Of joints in a pose of the protocol."""
_SHORTEST_MOVE_S = 0.2
"""Duration of a move, however small."""
_LEAST_TAUT_SHARE = 0.1
"""Share of the pretension that every cable keeps in the poses of the protocol."""
_SMALL_ANGLE_RAD = float(np.deg2rad(1.0))
"""Of joints that turn twice to either side, which shows play and friction."""
_HOLD_S = 40.0
"""How long a load is held to show creep."""
_RELEASE_S = 20.0
"""How long the arm is left alone thereafter: creep recovers."""
_REST_S = 5.0
"""How long the arm rests before and after it moves."""


class BlockKind(StrEnum):
    """The action in a block."""

    REST = "rest"
    LOAD_CYCLE = "load cycle"
    SLACKENING = "slackening cycle"
    STEP_LOAD = "step load"
    HOLD = "hold and release"
    MOVE = "move"
    SWEEP = "pose sweep"
    REVERSALS = "small reversals"


_CYCLE = (0.0, *_RISING_SHARES, *_RISING_SHARES[::-1], 0.0)
_LEVELS: dict[BlockKind, tuple[Sequence[float], float | Sequence[float]]] = {
    BlockKind.LOAD_CYCLE: (_CYCLE, 1.0),
    BlockKind.SLACKENING: (_CYCLE, 1.0),
    BlockKind.STEP_LOAD: ([0.0, 1.0] * 3 + [0.0], 2.0),
    BlockKind.HOLD: ((0.0, 1.0, 0.0), (1.0, _HOLD_S, _RELEASE_S)),
}
"""Levels of loads by the strongest, and how long each is held, s."""


@dataclass(frozen=True)
class Block:
    """One thing done to the arm without a break, recorded as one trial.

    Commands and a load on one segment over time are straight lines between knots. Two knots at one
    time are a step; from then on the second holds.

    Attributes:
        kind: what is done.
        does: the same for a person at the arm, in one sentence.
        knots_s: (K,) ascending from 0; the last is the block's duration.
        commands_rad: (K, 2N) commanded joint angles.
        segment: 1 to N where the load acts, 0 in a block without one.
        loads_n: (K, 3) the load, base frame.
        at_m: where on the segment's axis it acts, from the joint centre; NaN without a load.
    """

    kind: BlockKind
    does: str
    knots_s: Array
    commands_rad: Array
    segment: int
    loads_n: Array
    at_m: float = np.nan

    @property
    def duration_s(self) -> float:
        """How long the block takes."""
        return float(self.knots_s[-1])


def standard_protocol(arm: Arm) -> tuple[Block, ...]:
    """The blocks to record on an arm, in their order; about eight minutes for four segments.

    Loads are as strong as leaves every cable of the nominal arm taut (`bearable_load_n`), but for
    slackening cycles; poses are as bent as its guide plates and cables allow.

    Raises:
        EquilibriumError: the nominal arm finds no rest.
    """
    straight = np.zeros(arm.joint_count)
    reach_rad = _reach_rad(arm)
    bent = reach_rad * _pattern(arm.joint_count)
    tip = arm.segment_count
    segments = range(1, arm.segment_count + 1)
    first = "first bent pose"
    second = "second bent pose"
    cycle, slackening, steps, hold = _LEVELS
    places_m = load_places_m(arm)

    def load(kind: BlockKind, command: Array, n: int, place: int, side: str, pose: str) -> Block:
        return _load(arm, kind, command, (n, float(places_m[n - 1, place % 3])), side, pose)

    return (
        _rest(straight, "straight, at the start"),
        *(
            load(cycle, straight, n, n + k, side, "straight")
            for n in segments
            for k, side in enumerate(_STRAIGHT_SIDES)
        ),
        *(
            load(slackening, straight, tip, place, side, "straight")
            for side, place in zip(_SLACKENING_SIDES, (_FAR_PLACE, _NEAR_PLACE), strict=True)
        ),
        load(steps, straight, tip, _MIDDLE_PLACE, "to the left", "straight"),
        _rest(straight, "straight, in the middle"),
        *_single_sweeps(arm, reach_rad),
        _joint_sweep(arm.joint_count, reach_rad, 1.0),
        _reversals(straight, "straight"),
        _move(straight, bent, f"to the {first}"),
        *(load(slackening, bent, n, n, "down and to the left", first) for n in segments),
        load(hold, bent, tip, _MIDDLE_PLACE, "down and to the right", first),
        load(steps, bent, 1, _MIDDLE_PLACE, "down", first),
        _reversals(bent, first),
        _move(bent, -bent, f"to the {second}, the mirror of the first"),
        *(load(slackening, -bent, n, n + 1, "down and to the right", second) for n in segments),
        _move(-bent, straight, "back to straight"),
        _joint_sweep(arm.joint_count, reach_rad, -1.0),
        _rest(straight, "straight, at the end"),
    )


def load_places_m(arm: Arm) -> Array:
    """(N, 3) where loads act on each segment: near its joint, at its contact point, and far out.

    All are within the range of `touched_places`, in whole mm, so that a person can measure them. A
    recording may have loads beyond it, anywhere on a segment (`loadable_m` of its layout): a known
    load is compared wherever it acts, while the range says where unknown contacts are sought.
    """
    touched_m = touched_places(arm).touched_m
    inside = _FROM_THE_ENDS * (touched_m[:, 1] - touched_m[:, 0])
    near = touched_m[:, 0] + inside
    far = touched_m[:, 1] - inside
    middle = np.clip(mechanism_of(arm).contact_m, near, far)
    return np.asarray(np.round(np.stack([near, middle, far], axis=1), 3))


def rows_of(blocks: Sequence[Block], rate_hz: float) -> Recording:
    """One row every 1 / `rate_hz`, block after block, each block one trial; no tensions."""
    counts = [max(1, round(block.duration_s * rate_hz)) for block in blocks]
    times = [np.arange(count) / rate_hz for count in counts]

    def sampled(knots: Sequence[Array]) -> Array:
        return np.concatenate(
            [
                np.stack(
                    [np.interp(block_s, block.knots_s, column) for column in block_knots.T],
                    axis=-1,
                )
                for block_s, block, block_knots in zip(times, blocks, knots, strict=True)
            ]
        )

    load_n = sampled([block.loads_n for block in blocks])
    segment = np.repeat([block.segment for block in blocks], counts)
    loaded = (load_n != 0.0).any(axis=1)
    at_m = np.where(loaded, np.repeat([block.at_m for block in blocks], counts), np.nan)
    return Recording(
        name="protocol",
        time_s=np.arange(sum(counts)) / rate_hz,
        trial=np.repeat(np.arange(len(blocks)), counts),
        command_rad=sampled([block.commands_rad for block in blocks]),
        load_segment=np.where(loaded, segment, 0),
        load_n=load_n,
        tensions_n=np.empty((sum(counts), 0)),
        load_at_m=given_places(at_m),
    )


def bearable_load_n(
    arm: Arm,
    command_rad: Array,
    segment: int,
    direction: Array,
    at_m: float,
    *,
    slacken: bool = False,
) -> float:
    """Largest force in N along `direction` (3,) on segment 1..N that leaves every cable taut.

    It acts `at_m` from the segment's joint centre. It is at most `STRONGEST_N`, in steps of a
    thirtieth; less on a weak arm. The nominal arm still has an equilibrium at 1.3 times the force.
    If no visible force (20 noise floors in some cable) leaves all cables taut, the result is the
    weakest visible one.

    To `slacken` a cable it is 1.5 times the weakest force that does, where the arm bears that and
    no sensor comes near the end of its range.

    Raises:
        EquilibriumError: the arm finds no rest at the command (2N,) even unloaded.
    """
    where = segment, at_m
    loads_n, tensions, readable, most = _increasing_loads(arm, command_rad, where, direction)
    slack = (tensions <= 0.0).any(axis=1)
    weakest = int(np.argmax(slack))
    wanted = min(int(_BEYOND_SLACK * weakest), most, _last_in_row(readable))
    if slacken and slack.any() and wanted > weakest:
        return float(loads_n[wanted])
    tensions = tensions[: most + 1]
    readable = readable[: most + 1]
    unloaded = tensions[0]
    least = np.minimum(_TAUT_SHARE * mechanism_of(arm).pretension_n, 0.5 * unloaded)
    taut = _last_in_row((tensions >= least).all(axis=1) & readable)
    floor_n = float(np.sqrt(reading_variance_n2(arm.sensors)))
    shows = np.abs(tensions - unloaded).max(axis=1) >= _WORTH_FLOORS * floor_n
    visible = int(np.argmax(shows)) if shows.any() else len(shows) - 1
    return float(loads_n[max(taut, visible)])


def _increasing_loads(
    arm: Arm, command_rad: Array, where: tuple[int, float], direction: Array
) -> tuple[Array, Array, NDArray[np.bool_], int]:
    """Loads from 0 to 1.3 times the strongest, N; as far as the arm finds rest, the tensions.

    Tensions (L, M), and whether (L,) no sensor is near the end of its range that is not there
    unloaded. The last value is the position of the greatest load of which the arm bears 1.3 times.
    A step is a thirtieth of the strongest load: 2 N, or less, by 1, 2 or 5 times 10^k N. The
    strongest is at most three times the moment of the pretension about the axis, by the reach.
    It is so weak that the arm bears a third of it.
    """
    mechanism = mechanism_of(arm)
    (segment, at_m) = where
    mechanism = replace(mechanism, contact_m=np.full(mechanism.segment_count, at_m))
    radius_m = np.hypot(mechanism.hole_y_m, mechanism.hole_z_m)
    moment_n_m = float((mechanism.pretension_n * radius_m).sum())
    most_n = min(STRONGEST_N, 3.0 * moment_n_m / float(mechanism.segment_length_m.sum()))
    loads_n: Array = np.zeros(1)
    tensions: Array = np.zeros((1, mechanism.cable_count))
    most = 0
    for step_n in (10.0**k * digit for k in range(0, -10, -1) for digit in (2.0, 1.0, 0.5)):
        if _LOAD_STEPS * step_n > most_n:
            continue
        loads_n = step_n * np.arange(_REST_MARGIN * _LOAD_STEPS + 0.5)
        tensions = _borne_tensions_n(mechanism, command_rad, segment, loads_n[:, None] * direction)
        most = min(_LOAD_STEPS, int((len(tensions) - 1) / _REST_MARGIN + 1e-9))
        if 3 * most >= _LOAD_STEPS:
            break
    limit_n = np.inf if arm.sensors.range_n is None else _RANGE_SHARE * arm.sensors.range_n[1]
    readable = (tensions <= max(limit_n, tensions[0].max())).all(axis=1)
    return loads_n, tensions, readable, most


def _borne_tensions_n(
    mechanism: Mechanism, command_rad: Array, segment: int, loads_n: Array
) -> Array:
    """(K, M) tensions under the first K of loads (L, 3) on a segment, as far as it finds rest."""
    forces_n = np.zeros((len(loads_n), mechanism.segment_count, 3))
    forces_n[:, segment - 1] = loads_n
    try:
        return solve_equilibrium(mechanism, command_rad, forces_n).tensions_n
    except EquilibriumError as error:
        if not error.failed.size or error.failed[0] == 0:
            raise
        borne = forces_n[: int(error.failed[0])]
        return solve_equilibrium(mechanism, command_rad, borne).tensions_n


def _last_in_row(holds: NDArray[np.bool_]) -> int:
    """Position of the last entry before the first that does not hold."""
    return len(holds) - 1 if holds.all() else int(np.argmin(holds)) - 1


def _rest(command: Array, where: str) -> Block:
    does = f"Leave the arm alone, {where}."
    return _unloaded(BlockKind.REST, does, [command] * 2, [0.0, _REST_S])


def _move(start: Array, end: Array, where: str) -> Block:
    took_s = _way_s(start, end)
    listed = ", ".join(f"{angle:.1f}" for angle in np.rad2deg(end))
    does = f"Move {where} (joints at {listed} degrees), and wait."
    knots_s = [0.0, took_s, took_s + _REST_S / 2]
    return _unloaded(BlockKind.MOVE, does, [start, end, end], knots_s)


def _load(
    arm: Arm, kind: BlockKind, command: Array, where: tuple[int, float], side: str, pose: str
) -> Block:
    """A load that holds each level for a while, and steps to the next."""
    (segment, at_m) = where
    direction = np.asarray(DIRECTIONS[side])
    slacken = kind is BlockKind.SLACKENING
    peak_n = bearable_load_n(arm, command, segment, direction, at_m, slacken=slacken)
    shares, each_s = _LEVELS[kind]
    levels = ", ".join(f"{share * peak_n:.3g}" for share in _RISING_SHARES)
    place = f"segment {segment}, {1e3 * at_m:.0f} mm from its joint"
    cycle = f"load {place}, {side}, {levels} N, and back"
    does = {
        BlockKind.LOAD_CYCLE: f"{cycle}.",
        BlockKind.SLACKENING: f"{cycle}; a cable may go slack.",
        BlockKind.STEP_LOAD: f"put {peak_n:.3g} N {side} on {place}, at once, take it off at "
        "once, three times.",
        BlockKind.HOLD: f"hold {peak_n:.3g} N {side} on {place}, for {_HOLD_S:g} s, take it off, "
        f"and wait {_RELEASE_S:g} s.",
    }[kind]
    edges_s = np.append(0.0, np.cumsum(np.broadcast_to(each_s, len(shares))))
    knots_s = np.repeat(edges_s, 2)[1:-1]
    loads_n = np.outer(np.repeat(peak_n * np.array(shares), 2), DIRECTIONS[side])
    commands = np.tile(command, (len(knots_s), 1))
    does = f"{pose.capitalize()}: {does}"
    return Block(kind, does, knots_s, commands, segment, loads_n, at_m)


def _single_sweeps(arm: Arm, reach_rad: float) -> Iterator[Block]:
    """Each joint angle alone, to one side, through to the other and back."""
    for joint, name in enumerate(arm.joint_names):
        way = reach_rad * np.outer([0.0, 1.0, -1.0, 0.0], np.eye(arm.joint_count)[joint])
        does = f"Sweep {name} to +{np.rad2deg(reach_rad):.2g}°, to the other side, and back."
        yield _unloaded(BlockKind.SWEEP, does, way)


def _joint_sweep(joint_count: int, reach_rad: float, sign: float) -> Block:
    """All joints between corners of their range, each corner turning about half of them."""
    corners = np.array([_pattern(joint_count, turn) for turn in range(1, 7)])
    way = sign * reach_rad * np.vstack([np.zeros(joint_count), corners, np.zeros(joint_count)])
    does = "Sweep all joints at once through six poses and back, without a stop."
    return _unloaded(BlockKind.SWEEP, does, way)


def _reversals(command: Array, pose: str) -> Block:
    """Each joint by a degree to both sides, twice, one after the other."""
    twice = np.array([1.0, -1.0, 1.0, -1.0, 0.0]) * _SMALL_ANGLE_RAD
    way = [command, *(command + angle * row for row in np.eye(len(command)) for angle in twice)]
    does = f"{pose.capitalize()}: turn each joint by ±{np.rad2deg(_SMALL_ANGLE_RAD):.0f}° twice."
    return _unloaded(BlockKind.REVERSALS, does, way)


def _unloaded(
    kind: BlockKind, does: str, way: Sequence[Array] | Array, knots_s: Sequence[float] = ()
) -> Block:
    """Commands (K, 2N) one after the other, at the protocol's speed unless times are given."""
    knots = knots_s or np.append(0.0, np.cumsum([_way_s(a, b) for a, b in pairwise(way)]))
    return Block(kind, does, np.array(knots), np.array(way), 0, np.zeros((len(way), 3)))


def _way_s(start: Array, end: Array) -> float:
    return max(_SHORTEST_MOVE_S, float(np.abs(end - start).max()) / _SPEED_RAD_S)


def _pattern(joint_count: int, turn: int = 0) -> Array:
    """(2N,) of numbers within ±1 that no two joints share over the turns."""
    golden = 0.5 * (5.0**0.5 - 1.0)
    i = np.arange(1, joint_count + 1)
    phase = (i * golden + turn * (0.5 + 0.07 * i)) % 1.0
    return np.where(phase < 0.5, 1.0, -1.0) * (0.6 + 0.8 * np.abs(phase % 0.5 - 0.25) / 0.5)


def _reach_rad(arm: Arm) -> float:
    """Largest angle of the protocol: a third of what the guide plates leave, cables taut."""
    mechanism = mechanism_of(arm)
    reach = min(_LARGEST_ANGLE_RAD, float(mechanism.bend_limit_rad.min()) / 3.0)
    least = _LEAST_TAUT_SHARE * mechanism.pretension_n
    corners = np.array([_pattern(arm.joint_count, turn) for turn in range(7)])
    for _ in range(4):
        commands = reach * np.vstack([corners, -corners])
        try:
            if (solve_equilibrium(mechanism, commands).tensions_n > least).all():
                break
        except EquilibriumError:
            pass
        reach /= 2.0
    return reach
