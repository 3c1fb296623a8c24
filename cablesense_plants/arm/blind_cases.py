"""Cases: arms with hidden changes, the motion and loads applied to them, and their recordings.

A set of cases becomes files: recordings as CSV, and the answers as a table.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from math import ceil
from pathlib import Path

import numpy as np
import pandas as pd

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_plants.arm.arm import (
    RealArm,
    Schedule,
    draw_history,
    draw_schedule,
    ideal_arm,
    with_tolerances,
)
from cablesense_plants.arm.body import Nominal
from cablesense_plants.arm.built import Workmanship, built_as
from cablesense_plants.arm.listed import LISTED, ArmChange, ArmDraw
from cablesense_plants.arm.unlisted import UNLISTED
from cablesense_plants.cases import (
    NONE,
    UNKNOWN,
    PlantError,
    different,
    in_turn,
    plant_file,
    write_answers,
)

_FLOORS = {"faint": (1.0, 5.0), "plain": (5.0, 60.0), "gross": (60.0, 100.0)}
_SHARES = (0.1, 0.78, 0.12)
"""Size of a change as the gap it makes, by the error of one reading."""
_VISIBLE = (8.0, 60.0)
"""The same of changes that are not in the list, or one of two."""
_VISIBLE_FLOORS = 5.0
_WANTED_SHARE = 0.1
"""The least gap of such a change, and of one alone as a share of the gap that it was to make."""
_CHANGE_REDRAWS = 8

_BUILT = (3.0, 10.0)
"""The same of changes of an arm as a workshop builds it, by the gap that its errors make."""

_LACKING = ("actuator_ratio", "cogging", "hardening_cables", "screw_error", "tether")
_LACKED = (4.0, 16.0)
"""Changes that an imperfect nominal arm lacks, two of them, and the gap of each by the floor."""

_TRIES = 6
_NEAR = 1.25
_TRIED_HZ = 5.0
_STRIDE = 6
_RETREAT = 0.4
_NONE_SHARE = 0.2
_UNKNOWN_SHARE = 0.2
_DOUBLE_SHARE = 0.12
_REDRAWS = 5


def record_cases(
    folder: Path,
    answers_file: Path,
    nominal: Nominal,
    count: int,
    seed: int,
    only: Sequence[str] = (),
    workers: int = 1,
    *,
    second: bool = False,
    imperfect: bool = False,
    workmanship: Workmanship | None = None,
    plain: bool = False,
) -> Iterator[ArmAnswer]:
    """Write `case_001.csv` … into a folder and, at the end, the answers; yields them as they come.

    With `second`, the folder `second/` in it gets another recording of each arm, with other
    commands, loads and past. With `imperfect` the nominal arm lacks two changes that no verdict
    has a name for; `reference/` gets a recording of each arm before anything else was hidden. With
    a `workmanship` arms are built as `cablesense_plants.arm.built` does. With `plain`, what is
    hidden stands out of an arm's tolerances: its gap is drawn from the grossest range of
    `_FLOORS`, and at least three times that of an arm as a workshop builds it. The same seed makes
    the same files, whatever the number of processes.

    Raises:
        PlantError: an unknown kind in `only`, sensors that are perfect, or a place that cannot be
            written to.
    """
    if nominal.floor_n == 0.0:
        raise PlantError(
            "noise_std_n and step_n of the arm's sensors are both 0; sizes are drawn by what the "
            "sensors add to a reading, so one of them must be above 0"
        )
    kinds = draw_kinds(np.random.default_rng([seed]), count, only)
    answers = []
    with WorkerPool(workers, nominal, seed, refusal=PlantError) as pool:
        make = partial(
            make_case, second=second, imperfect=imperfect, workmanship=workmanship, plain=plain
        )
        for recorded in pool.map(make, range(1, count + 1), kinds):
            name = f"{recorded.answer.recording}.csv"
            for part, rows in recorded.recordings.items():
                _write_recording(folder / part / name, nominal.rate_hz, *rows)
            answers.append(recorded.answer)
            yield recorded.answer
    write_answers(answers_file, answers, decimals=4)


def draw_several(rng: np.random.Generator, count: int, least: int, most: int) -> list[str]:
    """Kinds of `count` cases, each of `least` to `most` different effects of the list."""
    drawn = [rng.choice(list(LISTED), rng.integers(least, most + 1), False) for _ in range(count)]
    return ["+".join(sorted(map(str, names))) for names in drawn]


def draw_kinds(rng: np.random.Generator, count: int, only: Sequence[str] = ()) -> list[str]:
    """Kinds of `count` cases for `make_case`, in random order.

    At least a fifth hide nothing and a fifth something that no verdict has a name for; an eighth
    hides two effects, the rest one. Effects come in turn, so that none comes twice before all
    have come once. With `only`, those kinds in turn.
    """
    if only:
        return [only[i % len(only)] for i in range(count)]
    listed = in_turn(rng, list(LISTED))
    unlisted = in_turn(rng, list(UNLISTED))
    blanks = ceil(_NONE_SHARE * count)
    unknown = ceil(_UNKNOWN_SHARE * count)
    doubles = round(_DOUBLE_SHARE * count)
    singles = max(0, count - blanks - unknown - doubles)
    kinds = [NONE] * blanks
    kinds += [next(unlisted) for _ in range(unknown)]
    kinds += [next(listed) for _ in range(singles)]
    kinds += ["+".join(sorted(different(listed, 2))) for _ in range(doubles)]
    return [kinds[i] for i in rng.permutation(len(kinds))][:count]


def make_case(
    nominal: Nominal,
    seed: int,
    index: int,
    kind: str,
    *,
    second: bool = False,
    imperfect: bool = False,
    workmanship: Workmanship | None = None,
    plain: bool = False,
) -> CaseRecording:
    """Case `index` (from 1, as in its name `case_001`) of the set of a seed.

    `kind` is `none`, `unknown`, the name of an effect inside or outside the list, or several
    joined by `+`. An arm that finds no rest is drawn anew.

    Raises:
        PlantError: a kind that is none of those, or no arm that finds rest in every row.
    """
    for attempt in range(_REDRAWS):
        rng = np.random.default_rng([seed, index, attempt])
        with suppress(PlantError) if attempt + 1 < _REDRAWS else nullcontext():
            return _recorded(rng, index, nominal, kind, second, imperfect, workmanship, plain)
    raise AssertionError


def _write_recording(path: Path, rate_hz: float, done: Schedule, tensions_n: Array) -> None:
    """One row a sample, columns named with their units; a cell without a number is empty."""
    angles = done.command_rad.shape[1]
    cables = tensions_n.shape[1]
    header = ["time_s", "trial", *(f"q{i + 1}_cmd_rad" for i in range(angles)), "load_segment"]
    header += ["load_x_n", "load_y_n", "load_z_n", "load_at_m"]
    header += [f"tension_{i + 1}_n" for i in range(cables)]
    time_decimals = 2 if 100.0 % rate_hz == 0.0 else 6  # microseconds, where 10 ms are too coarse
    decimals = [time_decimals, 0, *[6] * angles, 0, *[3] * 4, *[4] * cables]
    columns = zip(header, decimals, np.column_stack([*done, tensions_n]).T, strict=True)
    texts = {name: np.char.mod(f"%.{n}f", np.round(x, n) + 0.0) for name, n, x in columns}
    with plant_file(path) as beside:  # + 0.0 leaves no -0.00
        pd.DataFrame(texts).replace("nan", "").to_csv(beside, index=False)


@dataclass(frozen=True)
class ArmAnswer:
    """The hidden changes of a recording.

    Attributes:
        recording: its name.
        effects: names joined by `+` in alphabetical order, `none` or `unknown`.
        where: places joined by spaces; empty for the whole arm.
        form: the physical forms, joined by ` + `.
        sizes: of each, with units, as JSON.
        gap_n: root mean square of what the hidden changes make of the noise-free readings.
        gap_over_floor: the same by the error of one reading.
        scatter_gap_n: of the arm with manufacturing tolerances alone against the arm as drawn.
        each_gap_n: of each change alone, joined by spaces; where an arm is history-dependent,
            from every sixth row.
    """

    recording: str
    effects: str
    where: str
    form: str
    sizes: str
    gap_n: float
    gap_over_floor: float
    scatter_gap_n: float
    each_gap_n: str


@dataclass(frozen=True)
class CaseRecording:
    """A case's answer, and its recordings by folder: the first in none, `second`, `reference`.

    The second is one of the same arm; the reference one of the arm before anything was hidden, if
    the nominal arm is imperfect.
    """

    answer: ArmAnswer
    recordings: dict[str, tuple[Schedule, Array]]


def _recorded(
    rng: np.random.Generator,
    index: int,
    nominal: Nominal,
    kind: str,
    second: bool,
    imperfect: bool,
    workmanship: Workmanship | None,
    only_plain: bool,
) -> CaseRecording:
    """Draw an arm, its hidden changes and its protocol, and record it, all from one `rng`."""
    draws = {**LISTED, **UNLISTED}
    names = [] if kind == NONE else kind.split("+")
    if names == [UNKNOWN]:
        names = [str(rng.choice(list(UNLISTED)))]
    strange = [name for name in names if name not in draws]
    if strange:
        raise PlantError(
            f"no effect {strange[0]!r}; the plant has none, unknown, {', '.join(draws)}, and "
            "several of them joined by +"
        )
    drawn = ideal_arm(nominal)
    done = _schedules(drawn, rng)
    if workmanship is None:
        plain_arm = with_tolerances(drawn, rng)
    else:
        plain_arm = built_as(nominal, workmanship, rng)
        built_n = gap_n(plain_arm.signals_n(*done), drawn.signals_n(*done))
    least_plain_n = _BUILT[0] * _workshop_n(nominal, drawn, *done) if only_plain else 0.0
    for name in rng.choice(_LACKING, 2, replace=False) if imperfect else ():
        change = UNLISTED[str(name)](ArmDraw(rng, nominal))
        lacked_n = nominal.floor_n * float(np.exp(rng.uniform(*np.log(_LACKED))))
        size, _ = _sized(change, plain_arm, lacked_n, *done)
        plain_arm = change.apply(plain_arm, size)
    changes: list[tuple[ArmChange, float, float]] = []
    for name in sorted(names):
        for _ in range(_CHANGE_REDRAWS):
            change = draws[name](ArmDraw(rng, nominal))
            visible = only_plain or len(names) > 1 or change.effect == UNKNOWN
            if only_plain:
                bounds = _FLOORS["gross"]
            elif visible:
                bounds = _VISIBLE
            else:
                bounds = _FLOORS[str(rng.choice(list(_FLOORS), p=_SHARES))]
            wanted_n = nominal.floor_n * float(np.exp(rng.uniform(*np.log(bounds))))
            wanted_n = max(wanted_n, least_plain_n)
            if workmanship is not None:
                wanted_n = built_n * float(np.exp(rng.uniform(*np.log(_BUILT))))
            size, alone_n = _sized(change, plain_arm, wanted_n, *done)
            least_n = _VISIBLE_FLOORS * nominal.floor_n if visible else _WANTED_SHARE * wanted_n
            if alone_n >= least_n:
                break
        changes.append((change, size, alone_n))
    noise_rng = np.random.default_rng(int(rng.integers(2**63)))
    arm = plain_arm
    for change, size, _ in changes:
        arm = change.apply(arm, size)
    signals = arm.signals_n(*done)
    plain_n = plain_arm.signals_n(*done)
    gap = gap_n(signals, plain_n)
    alone_gaps_n = [alone_n for *_, alone_n in changes] if len(changes) > 1 else [gap]
    sizes = [
        {"effect": change.effect, "size": float(f"{size:.6g}"), "unit": change.unit}
        | {key: float(f"{value:.6g}") for key, value in change.details.items()}
        for change, size, _ in changes
    ]
    changed_places = {tuple(place.split("_")) for change, *_ in changes for place in change.where}
    places = sorted((kind, int(number)) for kind, number in changed_places)
    answer = ArmAnswer(
        recording=f"case_{index:03d}",
        effects="+".join(sorted(change.effect for change, *_ in changes)) or NONE,
        where=" ".join(f"{kind}_{number}" for kind, number in places),
        form=" + ".join(change.form for change, *_ in changes),
        sizes=json.dumps(sizes),
        gap_n=gap,
        gap_over_floor=gap / nominal.floor_n,
        scatter_gap_n=gap_n(plain_n, drawn.signals_n(*done)),
        each_gap_n=" ".join(f"{value:.4f}" for value in alone_gaps_n),
    )
    recordings = {"": (done[0], nominal.read_n(signals, noise_rng))}
    for part, wanted, machine in (("second", second, arm), ("reference", imperfect, plain_arm)):
        if wanted:
            again = _schedules(drawn, noise_rng)
            recordings[part] = again[0], nominal.read_n(machine.signals_n(*again), noise_rng)
    return CaseRecording(answer, recordings)


def _workshop_n(nominal: Nominal, drawn: RealArm, schedule: Schedule, history: Schedule) -> float:
    """The gap between an arm as a workshop builds it, always the same, and the arm as drawn."""
    built = built_as(nominal, Workmanship(), np.random.default_rng(nominal.cable_count))
    return gap_n(built.signals_n(schedule, history), drawn.signals_n(schedule, history))


def _schedules(arm: RealArm, rng: np.random.Generator) -> tuple[Schedule, Schedule]:
    """A recording's schedule and its history, of which the arm bears all poses and loads."""
    made = draw_schedule(arm.nominal, rng), draw_history(arm.nominal, rng)
    return arm.within_strength(made[0]), arm.within_strength(made[1])


def _sized(
    change: ArmChange, arm: RealArm, wanted_n: float, schedule: Schedule, history: Schedule
) -> tuple[float, float]:
    """Size within bounds whose gap against the arm without the change is nearest, and that gap.

    By secants in the logarithms, to within some percent; a history-dependent arm is tried on every
    sixth row. A size that leaves no rest lowers the upper bound.
    """
    low = np.log(change.least)
    high = np.log(change.most)
    rows_hz = len(schedule.time_s) / (schedule.time_s[-1] - schedule.time_s[0])
    slow = change.apply(arm, change.least).history_dependent
    stride = max(1, round(rows_hz / _TRIED_HZ)) * (_STRIDE if slow else 1)
    rows = schedule.rows(slice(None, None, stride))
    without = arm.signals_n(rows, history)

    def gap_of(size: float) -> float:
        return gap_n(change.apply(arm, size).signals_n(rows, history), without)

    log_size = 0.5 * (low + high)
    best = low
    nearest = np.inf
    steepness = 1.0
    last = None
    for _ in range(_TRIES):
        try:
            gap = gap_of(float(np.exp(log_size)))
        except PlantError:
            high = log_size + np.log(_RETREAT)
            log_size = min(0.5 * (low + log_size), high)
            continue
        off = np.log(max(gap, 1e-6) / wanted_n)
        if abs(off) < nearest:
            best = float(np.clip(log_size - off, low, high))
            nearest = abs(off)
        if nearest < np.log(_NEAR):
            break
        if last is not None and abs(log_size - last[0]) > 1e-6:
            steepness = float(np.clip((off - last[1]) / (log_size - last[0]), 0.3, 3.0))
        last = log_size, off
        log_size = float(np.clip(log_size - off / steepness, low, high))
        if abs(log_size - last[0]) < 1e-6:
            break
    size = float(np.exp(best))
    return size, gap_of(size)


def gap_n(first_n: Array, second_n: Array) -> float:
    """Root mean square difference of two recordings over rows and cables."""
    return float(np.sqrt(np.mean((first_n - second_n) ** 2)))
