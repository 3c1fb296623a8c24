"""The three nominal robots of the planted benchmark, and how each is run and measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cablesense_plants.robot.guides import read_guides
from cablesense_plants.robot.hidden import RobotKind

MODELS = Path(__file__).parents[2] / "config" / "robots"

KINDS = {
    kind.name: kind
    for kind in (
        RobotKind(
            path=MODELS / "arm_6.xml",
            home_rad=np.array([0.0, -0.7, 1.1, 0.0, 0.5, 0.0]),
            reach_rad=np.array([1.2, 0.6, 0.8, 1.2, 0.9, 1.5]),
            speed_hz=np.array([0.5, 0.5, 0.6, 0.8, 0.8, 1.0]),
            encoder_rad=2.0 * np.pi / 2**16,
            noise_n_m=np.array([0.2, 0.25, 0.15, 0.04, 0.04, 0.02]),
            rate_hz=250,
            trial_s=4.0,
            gain_1_s2=600.0,
            drives=tuple(f"motor_{n + 1}" for n in range(6)),
        ),
        RobotKind(
            path=MODELS / "two_links.xml",
            home_rad=np.array([0.3, -0.2]),
            reach_rad=np.array([1.8, 2.2]),
            speed_hz=np.array([1.0, 1.3]),
            encoder_rad=2.0 * np.pi / 2**15,
            noise_n_m=np.array([0.02, 0.012]),
            rate_hz=200,
            trial_s=5.0,
            gain_1_s2=500.0,
            drives=("motor_1", "motor_2"),
        ),
        RobotKind(
            path=MODELS / "finger.xml",
            home_rad=np.array([0.5, 0.5]),
            reach_rad=np.array([0.7, 0.8]),
            speed_hz=np.array([1.5, 1.8]),
            encoder_rad=2.0 * np.pi / 2**14,
            noise_n_m=np.array([0.0012, 0.0008]),
            rate_hz=500,
            trial_s=4.0,
            gain_1_s2=900.0,
            drives=("flexor_1", "extensor_1", "flexor_2", "extensor_2"),
            tendon_m=np.array([[0.011, 0.0], [-0.010, 0.0], [0.009, 0.008], [-0.008, -0.007]]),
        ),
    )
}

_GUIDED = MODELS / "guided_finger.xml"
GUIDED = replace(KINDS["finger"], path=_GUIDED, tendon_m=None, guides=read_guides(_GUIDED))
"""The finger with tendons over guides, for causes that the others cannot show."""
