"""A set of recordings whose effects are withheld, one after the other or in several processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from cablesense_gap.plant.case import Answer, CaseRecording, draw_case, record_case
from cablesense_gap.plant.deck import draw_kinds
from cablesense_gap.plant.files import write_answers, write_recording
from cablesense_gap.plant.nominal import Nominal
from cablesense_gap.plant.plant_error import PlantError

_REDRAWS = 5


def make_case(index: int, kind: str, nominal: Nominal, seed: int) -> CaseRecording:
    """Case `index` (from 1) of the set of a seed; an arm that finds no rest is drawn anew."""
    for attempt in range(_REDRAWS):
        rng = np.random.default_rng([seed, index, attempt])
        try:
            return record_case(draw_case(rng, index, nominal, kind))
        except PlantError:
            if attempt == _REDRAWS - 1:
                raise
    raise AssertionError


def withhold(
    folder: Path,
    answers_file: Path,
    nominal: Nominal,
    count: int,
    seed: int,
    only: Sequence[str] = (),
    workers: int = 1,
) -> Iterator[Answer]:
    """Write `case_001.csv` … into a folder and, at the end, the answers; yields them as they come.

    The same seed makes the same files, whatever the number of processes.

    Raises:
        PlantError: an unknown kind in `only`, or a place that cannot be written to.
    """
    kinds = draw_kinds(np.random.default_rng([seed]), count, only)
    numbers = range(1, count + 1)
    make = partial(make_case, nominal=nominal, seed=seed)
    answers = []
    for recorded in _made(make, numbers, kinds, workers):
        write_recording(folder / f"{recorded.answer.recording}.csv", recorded)
        answers.append(recorded.answer)
        yield recorded.answer
    write_answers(answers_file, answers)


def _made(
    make: partial[CaseRecording], numbers: range, kinds: list[str], workers: int
) -> Iterator[CaseRecording]:
    if workers == 1:
        yield from map(make, numbers, kinds)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(make, numbers, kinds)
