"""Planted truth: every effect at 0.3 to 10 times its typical size, in every kind of place.

    python benchmarks/gap_planted.py [--history] [--effects payload,sensor_gain] [--write]

The arm of the standard protocol has manufacturing tolerances, one effect, and its sensors' noise,
all simulated by the library itself: this measures the search, not the library.
Sizes beyond their range are held to it; an effect of several sizes has them all, of random sign.
Which of the places of a kind it sits in is drawn. A case whose effect changes the readings by less
than one floor is counted separately. With `--history` friction and creep are planted too. With
`--folder` it continues where it was stopped.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import harness
import numpy as np
from blind_sets import narrow_arm

from cablesense_base.workers import WorkerPool
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import diagnose
from cablesense_gap.protocol import rows_of, standard_protocol
from cablesense_gap.simulator import Candidate, Term
from cablesense_gap.verdict import Verdict
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.effects.effect import WHOLE_ARM
from cablesense_sim.replay import read_tensions_n

ARM = "cdsm_lab"
MULTIPLES = (0.3, 1.0, 3.0, 10.0)
RATE_HZ = 5.0
WITHIN = 0.05


def main() -> None:
    """Plants, diagnoses and counts; keeps the cases with `--write`."""
    parser = harness.parser(__doc__, "results/gap_planted.json")
    parser.add_argument("--effects", help="only these, joined by commas")
    parser.add_argument("--history", action="store_true", help="friction and creep too")
    parser.add_argument("--seed", type=int, default=1, help="of places, signs and tolerances")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--folder", type=Path, help="of finished cases, continued there")
    options = parser.parse_args()
    arm = narrow_arm(ARM)
    asked = rows_of(standard_protocol(arm), RATE_HZ)
    planted = [
        (candidate, place, multiple)
        for candidate in ArmSimulator(arm, asked).candidates
        if options.history or not candidate.history_dependent
        if not options.effects or candidate.effect in options.effects.split(",")
        for place in _one_of_each_kind(candidate, options.seed)
        for multiple in MULTIPLES
    ]
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gap_planted_"))
    folder.mkdir(parents=True, exist_ok=True)
    with WorkerPool(options.workers, asked, options.seed, folder) as pool:
        cases = [case for case in pool.map(_case, planted) if case]
    clear = [case for case in cases if case["gap_over_floor"] >= 1.0]
    result = {
        "planned": len(planted),
        "cases": len(cases),
        "below_the_floor": len(cases) - len(clear),
        "found": sum(case["found"] for case in clear),
        "found_in_place": sum(case["in_place"] for case in clear),
        "sizes": sum(case["sizes"] for case in clear),
        "sizes_right": sum(case["sizes_right"] for case in clear),
        "missed": [case for case in clear if not case["in_place"]],
        "each": cases,
    }
    harness.publish("gap_planted.json", result, options)


def _one_of_each_kind(candidate: Candidate, seed: int) -> Iterator[str]:
    kinds: dict[str, list[str]] = {}
    for place in candidate.places:
        kinds.setdefault(place.split("_")[0], []).append(place)
    rng = np.random.default_rng([seed, *candidate.effect.encode()])
    yield from (str(rng.choice(places)) for places in kinds.values())


def _case(
    asked: Recording, seed: int, folder: Path, planted: tuple[Candidate, str, float]
) -> dict[str, Any]:
    candidate, place, multiple = planted
    kept = folder / f"{candidate.effect}.{place}.{multiple:g}.json"
    work = partial(_planted, *planted, asked, [seed, *kept.name.encode()])
    judgement: dict[str, Any] = harness.kept(kept, work)
    return judgement


def _planted(
    candidate: Candidate, place: str, multiple: float, asked: Recording, seeds: list[int]
) -> dict[str, Any]:
    """A case; an arm that collapses gives none."""
    arm = narrow_arm(ARM)
    rng = np.random.default_rng(seeds)
    simulator = ArmSimulator(arm, asked)
    off = {
        term: float(rng.normal(0.0, parameter.typical))
        for tolerance in simulator.tolerances
        for toleranced in tolerance.places
        for term, parameter in zip(tolerance.terms(toleranced), tolerance.parameters, strict=True)
    }
    truth = _truth(candidate, place, multiple, rng)
    ideal, without = (simulator.predict([{**off, **v}])[0] for v in (truth, {}))
    if not np.isfinite(ideal).all():
        return {}
    read = read_tensions_n(ideal, arm.sensors, rng)
    try:
        verdict = diagnose(replace(asked, tensions_n=read), arm).verdict
    except RecordingError:  # so large that the recording seems to be of another arm
        verdict = None
    return {
        "effect": candidate.effect,
        "place": place,
        "multiple": multiple,
        "gap_over_floor": round(
            float(np.sqrt(((ideal - without) ** 2).mean())) / simulator.floor, 2
        ),
        "verdict": "+".join(verdict.effects) if verdict else "refused",
        "probability": round(verdict.probability, 3) if verdict else 0.0,
        **_judged(verdict, candidate, place, truth),
    }


def _truth(
    candidate: Candidate, place: str, multiple: float, rng: np.random.Generator
) -> dict[Term, float]:
    values = {}
    for term, p in zip(candidate.terms(place), candidate.parameters, strict=True):
        sign = -1.0 if p.low < 0.0 and rng.uniform() < 0.5 else 1.0
        size = float(np.clip(sign * multiple * p.typical, p.low, p.high))
        values[term] = size if p.role == "size" else p.default
    return values


def _judged(
    verdict: Verdict | None, candidate: Candidate, place: str, truth: Mapping[Term, float]
) -> dict[str, Any]:
    """Whether the verdict has the effect, in its place alone, and how many sizes are right."""
    sizes = {p.name for p in candidate.parameters if p.role == "size"}
    wanted = {term: value for term, value in truth.items() if term.parameter in sizes}
    named = False
    in_place = False
    right = 0
    if verdict and verdict.effects == (candidate.effect,):
        expected = set() if place == WHOLE_ARM else {place.split("_into_")[0]}
        named = True
        in_place = set(verdict.where.places) == expected
        several = any(key.count(".") > 1 for key in verdict.parameters)
        for term, value in wanted.items():
            key = str(term) if several else f"{term.effect}.{term.parameter}"
            if (estimate := verdict.parameters.get(key)) is not None:
                low, high = estimate.ci95
                near = abs(estimate.value - value) <= WITHIN * abs(value)
                right += near or low <= value <= high
    return {"found": named, "in_place": in_place, "sizes": len(wanted), "sizes_right": right}


if __name__ == "__main__":
    main()
