"""The experiment that distinguishes hypotheses best, chosen among the blocks of the protocol.

Each hypothesis is simulated with its fitted numbers. The block is proposed where the predictions
differ most, without a constant of each channel, which is fitted to every recording anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.arm_simulator import counted_rows, entries_from
from cablesense_gap.protocol import Block, rows_of, standard_protocol
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import listed, short
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import Replay

Rival = Mapping[Term, float]

_SLOW_HZ = 2.5
"""The rate of history-dependent simulations: two samples and more for each level of a load."""
_CLEAR_FLOORS = 1.0
"""Noise floors of a difference that one recording shows."""
_HIDDEN_FLOORS = 0.1
"""Noise floors of a difference that no repetition shows: it would take a hundred."""
_AS_FAR = 0.9
"""The first block with this share of the largest difference is proposed: it is the simplest."""


@dataclass(frozen=True)
class Experiment:
    """A proposal for the next recording, for a person at the arm.

    Attributes:
        block: what to do, as in the protocol; empty if nothing is needed.
        separation_n: root mean square difference of the predictions there.
    """

    text: str
    block: str = ""
    separation_n: float = 0.0


def next_experiment(
    arm: Arm,
    rivals: Sequence[Rival],
    floor_n: float,
    blocks: Sequence[Block] | None = None,
    question: str = "",
) -> Experiment:
    """The block to record that distinguishes the first rival from the others.

    Args:
        arm: the nominal one.
        rivals: fitted numbers of each, `{}` for none. A single one is distinguished from the
            nominal arm.
        floor_n: the noise floor of a reading.
        blocks: to choose from, those of the standard protocol unless given.
        question: what the recording would answer, if the rivals are one hypothesis with
            different numbers.

    Raises:
        ValueError: no rival is given.
        EquilibriumError: the nominal arm has no equilibrium in the standard protocol.
    """
    if not rivals:
        raise ValueError("no explanation is given; at least one is needed")
    if len(rivals) == 1 and not rivals[0]:
        return Experiment("No further experiment is needed.")
    compared = [_without_history(arm, r) for r in (rivals if rivals[1:] else [*rivals, {}])]
    rate_hz = arm.sensors.rate_hz
    if any(e.effect.acts_on == "transmission" for r in compared for e in entries_from(r)):
        rate_hz = min(rate_hz, _SLOW_HZ)
    offered = standard_protocol(arm) if blocks is None else blocks
    tried = [
        predicted
        for block in offered
        if (predicted := _predicted(arm, block, compared, rate_hz)) is not None
    ]
    best = _furthest(tried, floor_n)
    if best is None:
        return Experiment("No block of the protocol can be simulated with these explanations.")
    block, by_cable_n = best
    text = _text(arm, rivals, block.does, by_cable_n, floor_n, question)
    return Experiment(text, block.does, _rms(by_cable_n))


def _without_history(arm: Arm, rival: Rival) -> dict[Term, float]:
    """A rival without the states of a past that a new experiment does not share."""
    known = known_effects()
    return {
        term: value
        for term, value in rival.items()
        if term.parameter
        not in (p.name for p in known[term.effect].history(arm.segment_count, arm.cable_count))
    }


@dataclass(frozen=True)
class _PredictedBlock:
    """A block as the hypotheses predict it.

    Attributes:
        rows: the R rows of the block.
        predicted_n: (R, M) readings by the first hypothesis.
        differences_n: (R, M) from these to the readings by each of the others.
    """

    arm: Arm
    block: Block
    rows: Recording
    predicted_n: Array
    differences_n: list[Array]

    def most_n(self, *, free_constants: bool) -> float:
        """What the difference to the nearest hypothesis cannot exceed, whatever rows count.

        No rows have an RMS about their mean of more than half the range.
        """
        if free_constants:
            largest_n = [0.5 * np.ptp(d, axis=0) for d in self.differences_n]
        else:
            largest_n = [np.abs(d).max(axis=0) for d in self.differences_n]
        return min(map(_rms, largest_n))

    def by_cable_n(self, *, free_constants: bool) -> Array | None:
        """RMS in each cable (M,) of the difference to the nearest hypothesis.

        Of the rows that count in sizes of gaps; None without such a row.
        """
        if not self._counted.any():
            return None
        counted_n = [difference_n[self._counted] for difference_n in self.differences_n]
        left_n = [d - d.mean(0) if free_constants else d for d in counted_n]
        nearest_n = min(left_n, key=lambda each: float((each**2).sum()))
        return np.asarray(np.sqrt((nearest_n**2).mean(0)))

    @cached_property
    def _counted(self) -> NDArray[np.bool_]:
        return counted_rows(self.arm, self.rows, self.predicted_n)


def _predicted(
    arm: Arm, block: Block, rivals: Sequence[Rival], rate_hz: float
) -> _PredictedBlock | None:
    """A block as the rivals predict it; None if one of them cannot be simulated."""
    rows = rows_of((block,), rate_hz)
    replay = Replay(arm, rows.course)
    try:
        first_n, *others_n = (
            replay.readings_n([[*entries_of(arm), *entries_from(rival)]])[0] for rival in rivals
        )
    except EquilibriumError:
        return None
    return _PredictedBlock(arm, block, rows, first_n, [first_n - other_n for other_n in others_n])


def _furthest(tried: Sequence[_PredictedBlock], floor_n: float) -> tuple[Block, Array] | None:
    """The block with the largest difference to the nearest rival, and its RMS in each cable (M,).

    Constants count only if no block shows a clear difference without them. Which rows count takes
    long to find out: it is left open in blocks whose difference cannot be large enough.
    """
    sizes: dict[int, Array] = {}
    most_n = 0.0
    for free_constants in (True, False):
        sizes = {}
        most_n = 0.0
        bounds_n = np.array([each.most_n(free_constants=free_constants) for each in tried])
        for k in np.argsort(-bounds_n, kind="stable").tolist():
            if bounds_n[k] < _AS_FAR * most_n:
                break
            by_cable_n = tried[k].by_cable_n(free_constants=free_constants)
            if by_cable_n is not None:
                sizes[k] = by_cable_n
                most_n = max(most_n, _rms(by_cable_n))
        if most_n >= _CLEAR_FLOORS * floor_n:
            break
    furthest = sorted(k for k, by_cable_n in sizes.items() if _rms(by_cable_n) >= _AS_FAR * most_n)
    return (tried[furthest[0]].block, sizes[furthest[0]]) if furthest else None


def _rms(by_cable_n: Array) -> float:
    return float(np.sqrt((by_cable_n**2).mean()))


def _text(
    arm: Arm, rivals: Sequence[Rival], does: str, by_cable_n: Array, floor_n: float, question: str
) -> str:
    floors = _rms(by_cable_n) / floor_n
    first = _name(rivals[0])
    others = listed([_name(rival) for rival in rivals[1:] or [{}]], "or")
    if floors < _HIDDEN_FLOORS:
        if question:
            return f"No block of the protocol shows {question}."
        return (
            f"No block of the protocol distinguishes {first} from {others}: with their fitted "
            "numbers they predict the same readings."
        )
    most = [k for k in np.argsort(-by_cable_n)[:2] if by_cable_n[k] > 0.5 * by_cable_n.max()]
    numbers = [arm.cable_names[k].removeprefix("cable_") for k in sorted(most)]
    by = (
        f"by {short(_rms(by_cable_n))} N, {short(floors)} times the noise floor, "
        f"most at cable{'s' if numbers[1:] else ''} {' and '.join(numbers)}."
    )
    if question:
        text = f"To find out {question}: {does} There the predictions differ {by}"
    elif not rivals[0]:
        text = (
            f"If {others} is there nevertheless, it shows most here: {does} With the size that "
            f"fits best it would change the readings {by}"
        )
    elif len(rivals) == 1:
        text = f"To confirm it: {does} There {first} must change the readings {by}"
    else:
        text = f"To distinguish {first} from {others}: {does} There the predictions differ {by}"
    if floors < _CLEAR_FLOORS:
        times = int(np.ceil((_CLEAR_FLOORS / floors) ** 2))
        text += f" No block of the protocol shows more: repeat it {times} times."
    return text


def _name(rival: Rival) -> str:
    effects = sorted({term.effect for term in rival})
    return " + ".join(name.replace("_", " ") for name in effects) or "the nominal arm"
