"""Your own arm: an arm file, a model trained for it, and a push that the model has never seen.

    python -m examples.own_arm

The model is small, to be quick: `cablesense train --arm my_arm.yaml` trains as many samples as it
needs (docs/arm_file.md).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cablesense_base.installation import config_path
from cablesense_sim import load_arm, mechanism_of, normal_force_n, solve_equilibrium
from cablesense_training import Estimator, draw_training_data, train_model
from cablesense_training.model_training import recipe_for

NETWORK = "closed-form"


def main(folder: Path = Path("out/own_arm")) -> None:
    """Write the arm file, train, and compare a true contact with its estimate."""
    folder.mkdir(parents=True, exist_ok=True)
    file, model = folder / "my_arm.yaml", folder / "my_arm.onnx"
    text = config_path("arm_template.yaml").read_text(encoding="utf-8")
    file.write_text(text.replace("stiffness_n_m: 1.0e5", "stiffness_n_m: 2.0e5"), encoding="utf-8")

    arm = load_arm(file)  # refuses impossible values
    samples = draw_training_data(arm, NETWORK, {"samples": 300}, seed=0)
    settings = recipe_for(NETWORK).settings
    train_model(model, NETWORK, samples, settings, command="own_arm.py", test_samples=300)
    mechanism, straight = mechanism_of(arm), np.zeros(arm.joint_count)
    push_n = normal_force_n(mechanism, straight, segment=3, angle_deg=120.0, magnitude_n=25.0)
    rest = solve_equilibrium(mechanism, [straight, straight], [0.0 * push_n, push_n])
    found = Estimator.load(model, arm).estimate(rest.tensions_n[1] - rest.tensions_n[0], straight)

    print("true:      segment 3, 120.0°, 25.00 N")
    print(f"estimated: segment {found.segment}, {found.angle_deg:.1f}°, {found.magnitude_n:.2f} N")


if __name__ == "__main__":
    main()
