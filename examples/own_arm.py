"""Your own arm: an arm file, its estimator in one model file, and a push on a built arm.

    python -m examples.own_arm

The built arm has errors of its own, within the tolerances of the arm file. After one tare,
straight, the push is estimated in another pose, with intervals that allow for these errors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cablesense_base.installation import config_path
from cablesense_online import KnownMachine
from cablesense_sim import load_arm, normal_force_n, solve_equilibrium
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.law_export import export_law


def main(folder: Path = Path("out/own_arm")) -> None:
    """Write the arm file and its model, tare a built arm, and estimate a push."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "my_arm.yaml"
    text = config_path("arm_template.yaml").read_text(encoding="utf-8")
    file.write_text(text.replace("stiffness_n_m: 1.0e5", "stiffness_n_m: 2.0e5"), encoding="utf-8")
    arm = load_arm(file)  # refuses impossible values

    model = folder / "my_arm.onnx"
    export_law(arm, model, "examples/own_arm.py")

    # an arm as a workshop builds it
    parameters = arm_parameters(arm)
    errors = parameters.drawn(np.random.default_rng(7))
    built = parameters.built(errors)
    nominal = mechanism_of(arm)

    def read(command_rad: np.ndarray, force_n: np.ndarray | None = None) -> np.ndarray:
        held_m = held_lengths_m(nominal, command_rad + parameters.joint_zeros_rad(errors))
        rest = solve_equilibrium(built, command_rad, force_n, held_m=held_m)
        return parameters.read(errors, rest.tensions_n)

    straight = np.zeros(arm.joint_count)
    untouched_n = np.tile(read(straight), (50, 1))
    known = KnownMachine.load(file, model).tared(untouched_n, straight)

    bent = np.deg2rad([5.0, -4.0, 6.0, 3.0, -5.0, 4.0, 2.0, -6.0])
    push_n = normal_force_n(nominal, bent, segment=3, angle_deg=120.0, magnitude_n=25.0)
    touch = known.touch(read(bent, push_n), bent)

    low_n, high_n = touch.magnitude_ci95_n
    print("true:      segment_3, 120.0°, 25.00 N")
    print(f"estimated: {touch.link}, {touch.angle_deg:.1f}°, {touch.magnitude_n:.2f} N")
    print(f"with 95 %: {low_n:.2f} to {high_n:.2f} N")


if __name__ == "__main__":
    main()
