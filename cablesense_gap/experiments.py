"""The experiment that would distinguish explanations, chosen among the blocks of the protocol.

Each explanation is simulated with the numbers that were fitted to it, and the block is proposed
where their predictions part most: after a constant of each channel and what tolerances could add
are taken out, as these are fitted to every recording anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.arm_simulator import ArmSimulator, entries_from, has_one_equilibrium
from cablesense_gap.recordings.protocol import Block, rows_of, standard_protocol
from cablesense_gap.simulator import Term, parameters_of
from cablesense_gap.verdict import listed, short
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import Replay

Rival = Mapping[Term, float]

SLOW_HZ = 2.5
"""Rate at which blocks are simulated where the past counts: two samples a level and more."""
FINALISTS = 3
SEPARATES_FLOORS = 1.0
HIDDEN_FLOORS = 0.1
ABOUT_AS_FAR = 0.9
TOLERANCE_REACH = 2.0
"""Standard deviations to which each tolerance may take a difference away."""


@dataclass(frozen=True)
class Experiment:
    """What to record next, for a person at the arm, and what it will show.

    Attributes:
        block: what to do, as in the protocol; empty where nothing is needed.
        separation_n: root mean square by which predictions part there.
        over_floor: the same in noise floors.
    """

    text: str
    block: str = ""
    separation_n: float = 0.0
    over_floor: float = 0.0


class _Tried(NamedTuple):
    """A block as the rivals predict it.

    Attributes:
        used: (R,) rows with one rest only.
        apart_n: (R', M) first rival less each other, in the used rows.
    """

    block: Block
    simulator: ArmSimulator
    used: NDArray[np.bool_]
    apart_n: list[Array]

    def nearest_n(self, tolerances: Array, free_constants: bool) -> Array:
        """(M,) RMS by which the first rival parts from the nearest other."""
        left = [_left(apart, tolerances, free_constants) for apart in self.apart_n]
        nearest = min(left, key=lambda each: float((each**2).sum()))
        return np.asarray(np.sqrt((nearest**2).mean(0)))


def next_experiment(
    arm: Arm,
    rivals: Sequence[Rival],
    floor_n: float,
    blocks: Sequence[Block] | None = None,
    question: str = "",
) -> Experiment:
    """What to record to distinguish the first rival from the others.

    `question` is what that would tell, where the rivals are one explanation with other numbers.

    Rivals are fitted numbers, `{}` for none. One alone is distinguished from the nominal arm, so
    that it can be confirmed. `blocks` are those of the standard protocol unless given.

    Raises:
        ValueError: no rival is given.
        EquilibriumError: the nominal arm finds no rest in the standard protocol.
    """
    if not rivals:
        raise ValueError("no explanation is given; at least one is needed")
    if len(rivals) == 1 and not rivals[0]:
        return Experiment("No further experiment is needed.")
    offered = standard_protocol(arm) if blocks is None else blocks
    known, counts = known_effects(), (arm.segment_count, arm.cable_count)
    # before a new experiment nobody knows what the past left
    compared = [
        {
            t: v
            for t, v in r.items()
            if t.parameter not in (h.name for h in known[t.effect].history(*counts))
        }
        for r in (rivals if rivals[1:] else [*rivals, {}])
    ]
    past_counts = any(
        e.effect.acts_on == "transmission" for r in compared for e in entries_from(r)
    )
    rate_hz = min(arm.sensors.rate_hz, SLOW_HZ) if past_counts else arm.sensors.rate_hz
    tried = [_try(arm, block, compared, rate_hz) for block in offered]
    best = _furthest([each for each in tried if each is not None], floor_n)
    if best is None:
        return Experiment("No block of the protocol can be simulated with these explanations.")
    block, by_cable_n = best
    apart_n = _rms(by_cable_n)
    text = _text(arm, rivals, block.does, by_cable_n, floor_n, question)
    return Experiment(text, block.does, apart_n, apart_n / floor_n)


def _furthest(trials: Sequence[_Tried], floor_n: float) -> tuple[Block, Array] | None:
    """The block that separates most, and by how much in each cable (M,).

    A difference by a constant alone is taken as it is.
    """
    final: list[tuple[Block, Array]] = []
    most_n = 0.0
    for free_constants in (True, False):
        first_n = [_rms(t.nearest_n(np.empty((0, 0)), free_constants)) for t in trials]
        order = np.argsort(-np.array(first_n), kind="stable")
        final = [
            (t.block, t.nearest_n(_tolerances(t, free_constants), free_constants))
            for t in (trials[k] for k in sorted(order[:FINALISTS]))
        ]
        most_n = max((_rms(by_cable_n) for _, by_cable_n in final), default=0.0)
        if most_n >= SEPARATES_FLOORS * floor_n:
            break
    # of blocks that separate about as much, the first is the simplest
    return next((each for each in final if _rms(each[1]) >= ABOUT_AS_FAR * most_n), None)


def _rms(by_cable_n: Array) -> float:
    return float(np.sqrt((by_cable_n**2).mean()))


def _try(arm: Arm, block: Block, rivals: Sequence[Rival], rate_hz: float) -> _Tried | None:
    """None where an explanation cannot be simulated, or the arm has more than one rest."""
    rows = rows_of((block,), rate_hz)
    recorded = replace(rows, tensions_n=np.zeros((len(rows), arm.cable_count)))
    replay = Replay(arm, recorded.time_s, recorded.command_rad, recorded.forces_n)
    try:
        predicted = [replay.readings_n([[*entries_of(arm), *entries_from(r)]])[0] for r in rivals]
    except EquilibriumError:
        return None
    used = np.all([has_one_equilibrium(p, arm) for p in predicted], axis=0)
    if not all(np.isfinite(p).all() for p in predicted) or not used.any():
        return None
    apart_n = [(predicted[0] - other)[used] for other in predicted[1:]]
    return _Tried(block, ArmSimulator(arm, recorded), used, apart_n)


def _tolerances(trial: _Tried, free_constants: bool) -> Array:
    """(K, R' M) what one standard deviation of each changes."""
    simulator = trial.simulator
    nominal = simulator.predict([{}])[0]
    columns = []
    for term, parameter in parameters_of(simulator.tolerances).items():
        change = simulator.predict([{term: parameter.typical}])[0] - nominal
        columns.append(_without_mean(change[trial.used], free_constants).ravel())
    found = np.array(columns)
    return found[np.isfinite(found).all(1)]


def _left(difference_n: Array, tolerances: Array, free_constants: bool) -> Array:
    """What constants, and tolerances as far as manufacturing leaves them, do not take away."""
    from scipy.optimize import lsq_linear

    apart = _without_mean(difference_n, free_constants)
    if not len(tolerances):
        return apart
    # on a triangle of the columns instead of all rows
    rotated, triangle = np.linalg.qr(tolerances.T)
    least = lsq_linear(triangle, rotated.T @ apart.ravel(), (-TOLERANCE_REACH, TOLERANCE_REACH))
    return np.asarray(apart - (least.x @ tolerances).reshape(apart.shape))


def _without_mean(values_n: Array, free_constants: bool) -> Array:
    return values_n - values_n.mean(0) if free_constants else values_n


def _text(
    arm: Arm,
    rivals: Sequence[Rival],
    does: str,
    by_cable_n: Array,
    floor_n: float,
    question: str,
) -> str:
    floors = _rms(by_cable_n) / floor_n
    first, others = _name(rivals[0]), listed([_name(rival) for rival in rivals[1:] or [{}]], "or")
    if floors < HIDDEN_FLOORS:
        if question:
            return f"No block of the protocol shows {question}."
        return (
            f"No block of the protocol distinguishes {first} from {others}: with the numbers that "
            "were fitted, they predict the same readings."
        )
    most = [k for k in np.argsort(-by_cable_n)[:2] if by_cable_n[k] > 0.5 * by_cable_n.max()]
    numbers = [arm.cable_names[k].removeprefix("cable_") for k in sorted(most)]
    by = (
        f"by {short(_rms(by_cable_n))} N, {short(floors)} times the noise floor, "
        f"most at cable{'s' if numbers[1:] else ''} {' and '.join(numbers)}."
    )
    if question:
        text = f"To find out {question}: {does} There predictions part {by}"
    elif not rivals[0]:
        text = (
            "Nothing more needs to be recorded. What may hide below the noise would show most "
            f"here: {does} With the size that fits best, {others} would change the readings {by}"
        )
    elif len(rivals) == 1:
        text = f"To confirm it: {does} There {first} must change the readings {by}"
    else:
        text = f"To distinguish {first} from {others}: {does} There their predictions part {by}"
    if floors < SEPARATES_FLOORS:
        times = int(np.ceil((SEPARATES_FLOORS / floors) ** 2))
        text += f" Nothing in the protocol shows more: do it {times} times."
    return text


def _name(rival: Rival) -> str:
    effects = sorted({term.effect for term in rival})
    return " + ".join(name.replace("_", " ") for name in effects) or "the nominal arm"
