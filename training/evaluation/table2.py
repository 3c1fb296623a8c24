"""Measured data: the paper's Table II, tensions measured on the physical arm.

Loads of 1 and 2 kg hung at mid-segment on segments 1 to 3 of a three-segment, nine-cable arm,
straight and level. The estimator receives nine tension differences alone and
answers segment, direction and newtons.
"""

from __future__ import annotations

import csv
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_base.installation import config_path
from cablesense_training.errors import ModelFileError
from cablesense_training.inference.estimator import Estimate, Estimator

STANDARD_GRAVITY_M_S2 = 9.81
"""The paper's conversion: its 2 kg load counts as 19.62 N."""

DOWN_DEG = 180.0
"""Contact angle of a hung load on the level arm: -z."""

CABLES = 9


class HungLoad(NamedTuple):
    """One row of Table II.

    Attributes:
        source: `physical` or `simulated`, as the paper has it.
        segment: where the load hung.
        weight_n: its weight.
        tension_difference_n: (9,) change of the cable tensions.
    """

    source: str
    segment: int
    weight_n: float
    tension_difference_n: Array


def read_table2() -> list[HungLoad]:
    """The rows of Table II, physical and simulated, from the bundled file."""
    cables = [f"cable_{i + 1}_n" for i in range(CABLES)]
    with config_path("measurements/table2.csv").open(newline="", encoding="utf-8") as file:
        return [
            HungLoad(
                source=row["source"],
                segment=int(row["load_segment"]),
                weight_n=float(row["load_kg"]) * STANDARD_GRAVITY_M_S2,
                tension_difference_n=np.array([float(row[name]) for name in cables]),
            )
            for row in csv.DictReader(file)
        ]


def evaluate_table2(estimator: Estimator) -> list[tuple[HungLoad, Estimate]]:
    """The loads on the physical arm, with what a model of the three-segment arm answers to each.

    Raises:
        ModelFileError: the model is for an arm of other cables.
    """
    metadata = estimator.metadata
    if metadata.arm.cable_count != CABLES:
        raise ModelFileError(
            f"a model of arm {metadata.arm_identity} with {metadata.arm.cable_count} cables; "
            f"Table II was measured on one with {CABLES}, such as cdsm_table2"
        )
    straight = np.zeros(metadata.arm.joint_count)
    return [
        (load, estimator.estimate(load.tension_difference_n, straight))
        for load in read_table2()
        if load.source == "physical"
    ]
