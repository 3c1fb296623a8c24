"""The numbers of the probability formula, fitted to simulated cases of seeds used only here.

    python benchmarks/gap_calibration.py FOLDER [FOLDER ...] [--write]

Each folder holds recordings of `python -m cablesense_plants` with their `answers/answers.csv`. The
residuals that the search leaves in each case are kept next to the recording
(`case_….search.json`); then the numbers are fitted that give the true answers the highest mean
log probability. The bundled numbers come from 60 cases of seed 606 and six of seed 9002.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import harness
import numpy as np
from blind_sets import in_pool, narrow_arm
from scipy.optimize import minimize

from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis import probability
from cablesense_gap.diagnosis.probability import Fits, ProbabilityCalibration, log_weights
from cablesense_gap.diagnosis.search import search
from cablesense_gap.scoring import read_answers
from cablesense_gap.system import problem_of
from cablesense_recording.reading import read_recording

ARM = "cdsm_lab"
TARGET = Path(probability.__file__).with_name("calibration.json")
START = ProbabilityCalibration(4.0, 6.0, 2.5, 5.0, 0.05, 4.0, 2.5, 0.6, 0.5, 0.2)
WIDTHS = (2.0, 3.0, 1.5, 2.0, 0.05, 4.0, 1.5, 0.4, 0.5, 0.5)
"""How far each may be from its start before any case counts; the last three as logarithms."""


def main() -> None:
    """Searches where that has not been done, fits, prints; keeps the numbers with `--write`."""
    parser = harness.parser(__doc__, TARGET.name)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    options = parser.parse_args()
    cases = []
    for folder in options.folders:
        truth = {a.recording: a.effects for a in read_answers(folder / "answers" / "answers.csv")}
        paths = sorted(folder.glob("case_???.csv"))
        searched = in_pool(_searched, paths, options.workers)
        cases += [(case, tuple(truth[p.stem])) for case, p in zip(searched, paths, strict=True)]
    best = minimize(
        _cost,
        np.zeros(len(WIDTHS)),
        args=(cases,),
        method="Nelder-Mead",
        options={"maxiter": 4000, "xatol": 1e-3, "fatol": 1e-5},
    )
    calibration = _calibration(best.x)
    stated = [_probabilities(case, calibration) for case, _ in cases]
    named = [max(each.items(), key=lambda item: item[1]) for each in stated]
    right = np.mean([n[0] == truth for n, (_, truth) in zip(named, cases, strict=True)])
    print(
        f"{len(cases)} cases, {right:.0%} right, mean probability of the named effects "
        f"{np.mean([p for _, p in named]):.2f}"
    )
    print(json.dumps(asdict(calibration), indent=1))
    if options.write:
        harness.write_result(str(TARGET), asdict(calibration))


def _searched(path: Path) -> Any:
    return harness.kept(path.with_suffix(".search.json"), partial(_search, path))


def _search(path: Path) -> dict[str, object]:
    arm = narrow_arm(ARM)
    problem = problem_of(ArmSystem(arm, read_recording(path, arm)))
    hypotheses = search(problem)
    return {
        "floor": problem.floor,
        "effects": [h.effects for h in hypotheses],
        "left": [h.held_out_rmse for h in hypotheses],
        "sizes": [h.sizes for h in hypotheses],
        "strains": [h.nuisance_chi2 for h in hypotheses],
        "tolerances": int(problem.acting_directions.sum()),
    }


def _calibration(offsets: np.ndarray) -> ProbabilityCalibration:
    values = np.array(list(asdict(START).values()))
    moved = offsets * np.array(WIDTHS)
    additive = values[:7] + moved[:7]
    return ProbabilityCalibration(*additive.tolist(), *(values[7:] * np.exp(moved[7:])).tolist())


def _probabilities(
    case: dict[str, Any], calibration: ProbabilityCalibration
) -> dict[tuple[str, ...], float]:
    effects = [tuple(e) or ("none",) for e in case["effects"]]
    counts = np.array([0 if e == ("none",) else len(e) for e in effects])
    fits = Fits(
        held_out_rmse=np.array(case["left"]),
        effects=counts,
        sizes=np.array(case["sizes"]),
        nuisance_chi2=np.array(case["strains"]),
        nuisance_count=case["tolerances"],
    )
    weights = log_weights(fits, case["floor"], calibration)
    shares = np.exp(weights - weights.max())
    return dict(zip([*effects, ("unknown",)], shares / shares.sum(), strict=True))


def _cost(offsets: np.ndarray, cases: list[tuple[dict[str, Any], tuple[str, ...]]]) -> float:
    calibration = _calibration(offsets)
    if min(calibration.power, calibration.size, calibration.tolerance_chi2) < 0.0:
        return 1e6
    true_probabilities = [
        _probabilities(case, calibration).get(truth, 0.0) for case, truth in cases
    ]
    return float(
        -np.log(np.maximum(true_probabilities, 0.005)).mean()
        + 0.5 * (offsets**2).sum() / len(cases)
    )


if __name__ == "__main__":
    main()
