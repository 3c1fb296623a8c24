"""What friction hides of a load, against the coefficient of friction.

    python benchmarks/hidden_force.py [--write]

The laboratory's arm with a quarter turn at each pulley, straight and bent, under loads of
`LOAD_N`: the smallest changes that show (`cablesense_sim.hidden_force`), medians over the
directions around the third segment. `--write` puts `hidden_force.json` and a picture into
`benchmarks/results/`.
"""

from __future__ import annotations

from typing import Any

import harness
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.hidden_force import DIRECTIONS, SHOWS_AT_STD, hidden_force

mpl.use("Agg")

ARM, SEGMENT, LOAD_N, WRAP_RAD = "cdsm_lab", 3, 20.0, np.pi / 2
FRICTIONS = (0.0, 0.01, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2)
BENDS_DEG = (0.0, 5.0)
LABELS = {
    "touching_n": "a first push",
    "rising_n": "more, at the load",
    "falling_n": "less, at the load",
    "released_n": "a push after release",
}


def main() -> None:
    """Measure, print, write."""
    options = harness.parser(__doc__, "results/hidden_force.*").parse_args()
    result: dict[str, Any] = {
        **harness.origin("numpy"),
        "arm": ARM,
        "segment": SEGMENT,
        "load_n": LOAD_N,
        "pulley_wrap_rad": WRAP_RAD,
        "shows_at_std": SHOWS_AT_STD,
        "directions": DIRECTIONS,
        "coefficients": FRICTIONS,
    }
    figure, axes = plt.subplots(1, len(BENDS_DEG), figsize=(8.0, 3.2), sharey=True)
    for bend_deg, axis in zip(BENDS_DEG, axes, strict=True):
        curves = _curves(bend_deg)
        result[f"median_n_bent_by_{bend_deg:g}_deg"] = curves
        for name, label in LABELS.items():
            shown = [np.nan if n is None else n for n in curves[name]]
            axis.plot(FRICTIONS, shown, marker=".", label=label)
        axis.set(title=f"every joint at {bend_deg:g}°", xlabel="coefficient of friction")
        axis.axhline(LOAD_N, color="grey", linestyle=":", linewidth=1.0)
    axes[0].set(ylabel="smallest change that shows, N", ylim=(0.0, 1.05 * LOAD_N))
    axes[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    if options.write:
        picture = harness.RESULTS / "hidden_force.png"
        figure.savefig(picture, dpi=150)
    harness.publish("hidden_force.json", result, options)


def _curves(bend_deg: float) -> dict[str, list[float | None]]:
    """Medians over the directions by the friction, N; None where the whole load is hidden."""
    curves: dict[str, list[float | None]] = {name: [] for name in LABELS}
    for coefficient in FRICTIONS:
        arm = _with_friction(coefficient)
        found = hidden_force(arm, np.full(arm.joint_count, np.deg2rad(bend_deg)), LOAD_N)
        for name, values in found._asdict().items():
            median = float(np.median(values[SEGMENT - 1]))
            curves[name].append(round(median, 3) if np.isfinite(median) else None)
    return curves


def _with_friction(coefficient: float) -> Arm:
    content = open_arm(ARM).model_dump()
    numbers = {"coefficient": coefficient, "pulley_wrap_rad": WRAP_RAD}
    content["effects"] = [{"effect": "capstan_friction", "at": "arm", "parameters": numbers}]
    return Arm.model_validate(content)


if __name__ == "__main__":
    main()
