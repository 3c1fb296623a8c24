"""The torque of a real cable-driven jaw, told from the drive's signals alone.

    python benchmarks/real_jaw.py --train DIR --test DIR [--adapt 4] [--json] [--write]

A folder's form is described in `real_jaw_recordings.py`. With one and the same folder for both,
the tool with most levels of the brake is trained on every other level and tested on those between;
of every other tool a few recordings are for adapting and the rest for testing. With two folders
all of the first is trained on, which has that tool for its reference, and tools of the second that
the first has too are adapted to by its recordings.
Estimators see the drive's angle and torque and its motor's current up to the sample that they
answer for: neither the jaw's angle nor the level of the brake.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import harness
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import real_jaw_baselines as baselines
from real_jaw_baselines import BoostedTrees, Regression, TorqueEstimator
from real_jaw_diagnosis import best_of, described, loops_nm
from real_jaw_mechanism import problem_of
from real_jaw_network import NetworkEstimator
from real_jaw_physics import PhysicsEstimator
from real_jaw_recordings import SAMPLE_S, JawRecording, Part, read_recordings, reference, split

from cablesense_base import Array, CableSenseError

mpl.use("Agg")

PICTURE = harness.RESULTS / "real_jaw.png"
PHYSICS, NETWORK = "amended physics, filtered", "network with memory"


def trained(
    recordings: Sequence[JawRecording], physics: PhysicsEstimator, steps: int = 1000
) -> dict[str, TorqueEstimator]:
    """Every estimator by its name in the tables, the baselines first."""
    own = reference(recordings)
    return {
        "gain and offset": Regression(baselines.gain_and_offset, own),
        "Coulomb friction by direction": Regression(baselines.coulomb, own),
        "load-proportional friction by direction": Regression(baselines.load_proportional, own),
        "regression on play operators": Regression(baselines.play, own),
        "boosted trees, half a second": BoostedTrees(own),
        PHYSICS: physics,
        NETWORK: NetworkEstimator(recordings, physics, steps),
    }


def main() -> None:
    """Trains, adapts and tests every estimator."""
    parser = harness.parser(__doc__, "real_jaw.json")
    parser.add_argument("--train", required=True, help="folder of recordings to train on")
    parser.add_argument("--test", required=True, help="folder to test on, may be the same")
    parser.add_argument("--adapt", type=int, default=4, help="recordings to adapt to, by tool")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args()
    try:
        recordings = read_recordings(options.train)
        same = Path(options.train).resolve() == Path(options.test).resolve()
        other = None if same else read_recordings(options.test)
        train, parts = split(recordings, other, options.adapt)
    except CableSenseError as error:
        raise SystemExit(str(error)) from None
    physics = PhysicsEstimator(train)
    estimators = trained(train, physics)
    result = {
        **harness.origin("numpy", "scikit-learn", "torch"),
        "trained on": [r.name for r in train],
        "diagnosis": diagnosis(physics, parts),
        "estimators": {name: measured(one, parts) for name, one in estimators.items()},
    }
    print(json.dumps(result, indent=1) if options.json else "\n".join(table(result)))
    if options.write:
        harness.write_result("real_jaw.json", result)
        draw(physics, estimators, parts)


def measured(estimator: TorqueEstimator, parts: Sequence[Part]) -> dict[str, Any]:
    """Errors in all, by tool with and without adapting, and by recording."""
    tools, recordings, every = {}, {}, []
    for part in parts:
        unadapted = errors_nm(estimator, part.test)
        found = unadapted
        if part.adapt:
            found = errors_nm(estimator.adapted(part.adapt), part.test)
        tools[part.tool] = sizes(np.concatenate(found)) | (
            {
                "adapted to": [r.name for r in part.adapt],
                "unadapted": sizes(np.concatenate(unadapted)),
            }
            if part.adapt
            else {}
        )
        for recording, error in zip(part.test, found, strict=True):
            recordings[recording.name] = sizes(error)
        every += found
    return {"all": sizes(np.concatenate(every)), "tools": tools, "recordings": recordings}


def diagnosis(physics: PhysicsEstimator, parts: Sequence[Part]) -> dict[str, Any]:
    """The verdict on the tool that was trained on, judged on its recordings that were not."""
    unseen = [r for part in parts if part.tool == physics.tool for r in part.test]
    unseen_problem = problem_of(unseen, physics.signs) if unseen else physics.problem
    return described(physics.ranked, physics.problem, unseen_problem)


def draw(
    physics: PhysicsEstimator, estimators: Mapping[str, TorqueEstimator], parts: Sequence[Part]
) -> None:
    """Loops of the drive, and the jaw's torque in a recording that was not trained on."""
    shown = parts[0].test[len(parts[0].test) // 2 :][:1]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    angle, *torques = loops_nm(problem_of(shown, physics.signs), best_of(physics.ranked))
    for label, torque in zip(("measured", "without friction", "amended"), torques, strict=True):
        left.plot(angle[0], 1e3 * torque[0], label=label)
    left.set(xlabel="drive, rad", ylabel="drive's torque, mN·m")
    time_s = np.arange(len(shown[0].jaw_torque_nm)) * SAMPLE_S
    right.plot(time_s, 1e3 * shown[0].jaw_torque_nm, label="measured")
    for name in (PHYSICS, NETWORK):
        right.plot(time_s, 1e3 * estimators[name].torques_nm(shown)[0], label=name)
    right.set(xlabel="time, s", ylabel="jaw's torque, mN·m")
    for axis in (left, right):
        axis.legend(fontsize="small")
    figure.savefig(PICTURE, dpi=110)


def errors_nm(estimator: TorqueEstimator, recordings: Sequence[JawRecording]) -> list[Array]:
    """(T,) errors of the jaw's torque in each recording."""
    told = estimator.torques_nm(recordings)
    return [torque - r.jaw_torque_nm for torque, r in zip(told, recordings, strict=True)]


def sizes(error_nm: Array) -> dict[str, float]:
    """Root mean square and mean magnitude, in mN·m."""
    return {
        "rmse_mnm": round(float(np.sqrt((error_nm**2).mean())) * 1e3, 2),
        "mae_mnm": round(float(np.abs(error_nm).mean()) * 1e3, 2),
    }


def table(result: dict[str, Any]) -> list[str]:
    """Markdown: the verdict; RMSE and MAE of each estimator by tool, in all, and by recording."""
    verdict, estimators = result["diagnosis"], result["estimators"]
    lines = [
        f"{' + '.join(verdict['effects'])} ({verdict['probability']:.2f}); gap of the drive's "
        f"torque on recordings that were not fitted: {verdict['gap before']} to "
        f"{verdict['gap after']} mN·m, {verdict['removed']:.0%} removed",
        "",
    ]
    for kind in ("tools", "recordings"):
        heading = f"{kind[:-1]}, RMSE / MAE in mN·m | " + " | ".join(estimators)
        rows = [
            " | ".join([name, *(_cell(found[kind][name]) for found in estimators.values())])
            for name in next(iter(estimators.values()))[kind]
        ]
        if kind == "tools":
            rows.append(" | ".join(["all", *(_cell(e["all"]) for e in estimators.values())]))
        lines += [*harness.markdown_table(heading, rows), ""]
    return lines


def _cell(found: dict[str, Any]) -> str:
    text = f"{found['rmse_mnm']:.2f} / {found['mae_mnm']:.2f}"
    unadapted = found.get("unadapted")
    return text if unadapted is None else f"{text} (unadapted {unadapted['rmse_mnm']:.1f})"


if __name__ == "__main__":
    main()
