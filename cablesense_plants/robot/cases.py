"""Sets of cases: robots with hidden changes, their recordings, and the answers.

They are made for any robot of hinges in a row.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_plants.cases import (
    NONE,
    UNKNOWN,
    PlantError,
    different,
    in_turn,
    plant_file,
    write_answers,
)
from cablesense_plants.robot.causes import (
    LISTED,
    UNLISTED,
    Drawing,
    RobotChange,
    RobotDraw,
    with_tolerances,
)
from cablesense_plants.robot.motion import (
    ReferenceMotion,
    prescribed_n_m,
    reference,
    simulate,
    stacked_references,
    written,
)
from cablesense_plants.robot.robots import RealRobot, RobotKind, stacked

_OF_LINKS = ("link_centre", "link_mass", "payload")
_NONE_SHARE = 0.2
_UNKNOWN_SHARE = 0.2
_SEVERAL_SHARE = 0.2
_FLOORS = (6.0, 40.0)
"""Gap of a cause in the torques, by the noise of one sample."""
_TOLERANCES = 3.0
"""A cause is at least this many times the effect of tolerances."""
_VISIBLE = 0.8
"""If the gap is below this share of the wanted one, the cause is drawn again."""
_FREE_RAD = (-np.pi, np.pi)
_REACH_SHARE = 0.35
_MOST_REACH_RAD = 1.2
_SPEEDS_HZ = (0.5, 1.0)
_NOISE_SHARE = 0.005
_LEAST_SHARE = 1e-3
"""Noise of one sample as a share of a joint's torque, RMS, and that as one of the largest."""
_TRIES = 5
_REDRAWS = 60
_OF_ONE_NAME = 6


Lacking = Callable[[RealRobot, RobotKind, np.random.Generator, ReferenceMotion], RealRobot]


@dataclass(frozen=True)
class RobotAnswer:
    """The hidden changes of a recording, as of arms; gaps are in pooled noise of a torque sample.

    Attributes:
        robot: the name of its model.
        gap_over_floor: of the robot as asked to move, with all that is hidden, to the one with
            tolerances alone.
        scatter_over_floor: of the latter to the nominal robot.
    """

    recording: str
    robot: str
    effects: str
    where: str
    form: str
    sizes: str
    gap_over_floor: float
    scatter_over_floor: float
    each_gap_n: str


@dataclass(frozen=True)
class RobotCase:
    """A robot with hidden changes, and its recordings.

    Attributes:
        recorded: robot, motion asked for and seed of each recording, by folder: the first,
            `second`, and of an imperfect nominal robot `reference`, before anything was hidden.
    """

    answer: RobotAnswer
    kind: RobotKind
    recorded: tuple[tuple[RealRobot, ReferenceMotion, int], ...]


def record_cases(
    folder: Path,
    answers_file: Path,
    path: Path,
    model: mujoco.MjModel,
    count: int,
    seed: int,
    only: Sequence[str] = (),
    *,
    second: bool = False,
) -> Iterator[RobotAnswer]:
    """Write `case_001.csv.gz` … into a folder, and at the end the answers.

    With `second`, the folder `second/` in it gets another recording of each robot. `model` is that
    of the file `path` as MuJoCo read it. `only` has names of effects joined by
    `+`, `none` or `unknown`; the cases have these in turn. Torques are recorded, and no commands.

    Raises:
        PlantError: the robot is no row of hinges, a name in `only` is unknown, or a place cannot
            be written to.
    """
    kind = usual_kind(path, model)
    known = (LISTED, UNLISTED)
    rng = np.random.default_rng([seed])
    sets = sets_of_names(rng, count, known)
    if only:
        unlisted = in_turn(rng, list(known[1]))
        names = [joined.split("+") for joined in only]
        if strange := sorted({n for causes in names for n in causes} - {NONE, UNKNOWN, *known[0]}):
            raise PlantError(
                f"no effect {strange[0]!r} of a robot; known are {', '.join(sorted(known[0]))}, "
                f"{NONE} and {UNKNOWN}"
            )
        sets = [
            [next(unlisted) if n == UNKNOWN else n for n in names[k % len(names)] if n != NONE]
            for k in range(count)
        ]
    answers = []
    for index, causes in enumerate(sets, start=1):
        case = draw_case(kind, causes, seed, index, known)
        record([replace(case, recorded=case.recorded[: 2 if second else 1])], folder)
        answers.append(case.answer)
        yield case.answer
    write_answers(answers_file, answers)


def usual_kind(path: Path, model: mujoco.MjModel) -> RobotKind:
    """A robot as laboratories run one: sines over a part of its range, and good sensors."""
    count = model.njnt
    limited = model.jnt_limited.astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range, _FREE_RAD).T
    kind = RobotKind(
        path=path,
        home_rad=0.5 * (low + high),
        reach_rad=np.minimum(_REACH_SHARE * (high - low), _MOST_REACH_RAD),
        speed_hz=np.linspace(*_SPEEDS_HZ, count),
        encoder_rad=2.0 * np.pi / 2**16,
        noise_n_m=np.ones(count),
        rate_hz=250,
        trial_s=4.0,
        gain_1_s2=600.0,
        drives=(),
        model=model,
    )
    asked = reference(kind, np.random.default_rng(0))
    torque = rms(prescribed_n_m(kind, kind.nominal()[0], asked))
    return replace(kind, noise_n_m=np.maximum(torque, _LEAST_SHARE * torque.max()) * _NOISE_SHARE)


def sets_of_names(
    rng: np.random.Generator, count: int, known: Sequence[Mapping[str, Drawing]]
) -> list[list[str]]:
    """Names of each case's causes, in random order: none, unlisted ones, several, and one."""
    listed, unlisted = (in_turn(rng, list(pool)) for pool in known)
    blanks = round(_NONE_SHARE * count)
    unknown = round(_UNKNOWN_SHARE * count)
    several = round(_SEVERAL_SHARE * count)
    sets: list[list[str]] = [[]] * blanks + [[next(unlisted)] for _ in range(unknown)]
    sets += [different(listed, 2 + int(rng.random() < 0.4)) for _ in range(several)]
    sets += [[next(listed)] for _ in range(count - len(sets))]
    return [sets[k] for k in rng.permutation(count)]


def draw_case(
    kind: RobotKind,
    names: list[str],
    seed: int,
    index: int,
    known: Sequence[Mapping[str, Drawing]],
    lacking: Lacking | None = None,
) -> RobotCase:
    """One case; a cause that this robot cannot show is drawn anew, of another name if need be.

    `lacking` makes of the robot one whose nominal robot lacks something.
    """
    rng = np.random.default_rng([seed, index])
    nominal, joints, links = kind.nominal()
    asked: tuple[ReferenceMotion, ...] = (reference(kind, rng), reference(kind, rng))
    plain = with_tolerances(nominal, kind, rng)
    without = prescribed_n_m(kind, plain, asked[0])

    def gap_of(robot: RealRobot) -> float:
        """To the robot with tolerances alone, as asked to move, in noise of one sample."""
        torque = prescribed_n_m(kind, robot, asked[0])
        off = torque - without
        if kind.servos:
            off = torque / (1.0 + robot.servo_scale) - without
            turned = (asked[0].angle - kind.home_rad) @ (robot.moved - plain.moved).T
            still = robot.zero - plain.zero + 0.5 * robot.play_rad
            off = np.hypot(rms(turned + still), rms(off) / kind.gains()[0])
        noise = kind.encoder_rad if kind.servos else kind.noise_n_m
        return float(np.sqrt(((off / noise) ** 2).mean()))

    scatter = gap_of(nominal)
    if lacking:
        reference_rng = np.random.default_rng([seed, index, 1])
        plain = lacking(plain, kind, reference_rng, asked[0])
        asked = (*asked, reference(kind, reference_rng))
        without = prescribed_n_m(kind, plain, asked[0])
    draw = RobotDraw(rng, kind, nominal, joints, links)
    causes: list[tuple[RobotChange, float, float]] = []
    for name in names:
        taken = [c for c, *_ in causes]
        pool = next(pool for pool in known if name in pool)
        least = max(_FLOORS[0], _TOLERANCES * scatter)
        causes.append(
            _sized(draw, name, pool, taken, least, lambda c, size: gap_of(c.apply(plain, size)))
        )
    causes.sort(key=lambda each: each[0].effect)
    robot = plain
    for cause, size, _ in causes:
        robot = cause.apply(robot, size)
    places = [place for cause, *_ in causes for place in cause.where if cause.effect != UNKNOWN]
    sizes = [
        {"effect": c.effect, "size": float(f"{size:.4g}"), "unit": c.unit, "places": c.where}
        | {key: round(value, 4) for key, value in c.details.items()}
        for c, size, _ in causes
    ]
    answer = RobotAnswer(
        recording=f"case_{index:03d}",
        robot=kind.name,
        effects="+".join(c.effect for c, *_ in causes) or NONE,
        where=" ".join(sorted(places)),
        form=" + ".join(c.form for c, *_ in causes),
        sizes=json.dumps(sizes),
        gap_over_floor=round(gap_of(robot), 2),
        scatter_over_floor=round(scatter, 2),
        each_gap_n=" ".join(f"{gap:.2f}" for *_, gap in causes),
    )
    seeds = [int(rng.integers(2**31)) for _ in asked]
    recorded = zip((robot, robot, plain), asked, seeds, strict=False)
    return RobotCase(answer, kind, tuple(recorded))


def rms(torque: Array) -> Array:
    """(N,) over the rows of (T, N)."""
    return np.asarray(np.sqrt((torque**2).mean(0)))


def _sized(
    draw: RobotDraw,
    name: str,
    pool: Mapping[str, Drawing],
    taken: list[RobotChange],
    least: float,
    gap_of: Callable[[RobotChange, float], float],
) -> tuple[RobotChange, float, float]:
    """A cause, a size that makes about the gap wanted, at least `least`, and that gap."""
    known = {cause.effect for cause in taken}
    others = [n for n in pool if n not in known and _can_show(draw, n)]
    for attempt in range(_REDRAWS):
        stuck = attempt % _OF_ONE_NAME == _OF_ONE_NAME - 1
        if stuck or name not in others:
            name = str(draw.rng.choice(others))
        cause = pool[name](draw)
        if cause.effect in _OF_LINKS and any(
            other.effect in _OF_LINKS and other.where == cause.where for other in taken
        ):
            continue  # three names for one thing
        wanted = float(np.exp(draw.rng.uniform(*np.log((least, max(_FLOORS[1], 2.0 * least))))))
        size, gap = _size_for(cause, wanted, gap_of)
        if gap >= _VISIBLE * least and size >= cause.least:
            return cause, size, gap
    raise PlantError(f"{draw.kind.name}: no {name} shows")


def _can_show(draw: RobotDraw, name: str) -> bool:
    """In a plane a tilt is the first joint's zero, and a zero turns the last link's centre.

    A camera sees a zero for itself.
    """
    if draw.kind.servos:
        return True
    indistinct = ("base_tilt", "joint_zero") if not draw.robot.stiffness.any() else ("base_tilt",)
    return not (draw.planar and name in indistinct)


def _size_for(
    cause: RobotChange, wanted: float, gap_of: Callable[[RobotChange, float], float]
) -> tuple[float, float]:
    """Scales the size by the ratio of wanted to actual gap, within the cause's bounds."""
    size = 0.1 * cause.most
    best = 0.0
    best_gap = 0.0
    for _ in range(_TRIES):
        gap = max(gap_of(cause, size), 1e-9)
        if not best or abs(np.log(gap / wanted)) < abs(np.log(best_gap / wanted)):
            best = size
            best_gap = gap
        if abs(np.log(gap / wanted)) < 0.1:
            break
        size = float(np.clip(size * wanted / gap, size / 20.0, cause.most))
    return best, best_gap


def record(cases: list[RobotCase], folder: Path) -> None:
    """Recordings of cases of one kind, `case_001.csv.gz` …, also in `second/` and `reference/`."""
    kind = cases[0].kind
    machines, asked, seeds = zip(*(run for case in cases for run in case.recorded), strict=True)
    robots = stacked(machines)
    motion = simulate(kind, robots, stacked_references(asked))
    names = [
        folder / part / f"{case.answer.recording}.csv.gz"
        for case in cases
        for part, _ in zip(("", "second", "reference"), case.recorded, strict=False)
    ]
    for path, table in zip(names, written(kind, robots, motion, seeds), strict=True):
        with plant_file(path) as beside:
            table.to_csv(beside, index=False, float_format="%.6g", compression="gzip")
