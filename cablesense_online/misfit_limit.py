"""The largest misfit that a model file states: from simulated healthy arms at rest.

`cablesense train` writes it into its model file, and `make limits` into those of this repository.

By noise alone (M - 2) misfit² has a chi-square distribution of M - 2 degrees of freedom. Slack
cables, the sensors' step, the arm's linearisation and the estimator's own errors widen it. The
limit is that of the chi-square for `FALSE_ALARM_RATE`, times the ratio of the simulated misfits'
quantile at `JUDGED_AT` to that of the chi-square, from 1 to `MOST_OF_NOISE`. Misfits beyond that
quantile are not noise: the estimate is wrong by itself, or the arm has two positions of rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_online.answer import decide
from cablesense_online.models import MOST_OF_NOISE, LoadedModel
from cablesense_online.plausibility import FALSE_ALARM_RATE, noise_limit
from cablesense_online.stated_contacts import RestingArm
from cablesense_sim.contact_location import touched_at
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.replay import read_tensions_n
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import MisfitLimit
from cablesense_training.inference.model_file import replace_misfit_limit

JUDGED_AT: Final = 0.9
POSES, LOADS, READINGS = 10, 20, 50


def simulated_misfits(loaded: LoadedModel, seed: int, poses: int) -> Iterator[float]:
    """Misfits of a healthy arm at random commands and contacts within the model's training."""
    arm, estimator = loaded.arm, loaded.estimator
    assert isinstance(estimator, Estimator)
    metadata, rng = estimator.metadata, np.random.default_rng(seed)
    count, resting = arm.segment_count, RestingArm(arm, metadata.tare_samples)
    mechanism, range_rad = resting.mechanism, np.deg2rad(metadata.pose_range_deg)
    contact_m, (reach, _) = mechanism.contact_m, touched_at(arm)

    def readings(tensions_n: Array, count: int) -> Array:
        read_n = read_tensions_n(np.tile(tensions_n, (count, 1)), arm.sensors, rng)
        return np.maximum(read_n, 0.0)

    for _ in range(poses):
        command = rng.uniform(-range_rad, range_rad, arm.joint_count)
        resting.command(command)
        tare_n = readings(resting.unloaded_n, metadata.tare_samples).mean(axis=0)
        for _ in range(LOADS):
            segment, angle_deg = rng.integers(0, count + 1), rng.uniform(0.0, 360.0)
            size_n = rng.uniform(0.0, metadata.force_range_n)
            forces = normal_force_n(mechanism, command, segment, angle_deg, size_n)
            if isinstance(estimator, AnywhereEstimator):
                contact_m = rng.uniform(reach[:, 0], reach[:, 1])
            touched = replace(mechanism, contact_m=contact_m)
            try:
                rest = solve_equilibrium(touched, command, forces, held_m=resting.held_m)
            except EquilibriumError:
                continue  # the arm collapses
            differences_n = readings(rest.tensions_n, READINGS) - tare_n
            if isinstance(estimator, AnywhereEstimator):
                placed, misfits = estimator.locate_batch(differences_n, command)
                yield from misfits[placed.segment > 0].tolist()
                continue
            found = estimator.estimate_batch(differences_n, command)
            answers = zip(
                differences_n,
                found.probabilities.tolist(),
                found.angle_deg.tolist(),
                found.magnitude_n.tolist(),
                strict=True,
            )
            for difference_n, probabilities, angle, size in answers:
                contact = decide(probabilities, angle, size, 0.5, contact_m.tolist())
                if contact.segment:
                    yield resting.explained(difference_n, [contact])[1]
                else:
                    yield resting.misfit(difference_n)


def put_simulated_limit(path: Path) -> MisfitLimit | None:
    """Write the limit into a model file of single contacts and give it.

    There is none if readings are not checked: for a history-dependent model, or an arm file with
    effects of actuators, friction or sensors.

    Raises:
        ModelFileError: no such model file, or it cannot be written.
    """
    loaded, limit = LoadedModel.open(path), None
    if isinstance(loaded.estimator, Estimator) and not RestingArm(loaded.arm, 1).incomplete:
        misfits = np.fromiter(simulated_misfits(loaded, 0, POSES), float)
        limit = _limit(misfits, loaded.free)
    replace_misfit_limit(path, limit)
    return limit


def _limit(misfits: Array, free: int) -> MisfitLimit:
    wider = float(np.quantile(misfits, JUDGED_AT)) / noise_limit(free, 1.0 - JUDGED_AT)
    largest = noise_limit(free) * min(max(1.0, wider), MOST_OF_NOISE)
    return MisfitLimit(
        largest_misfit=round(largest, 2),
        false_alarm_rate=FALSE_ALARM_RATE,
        samples=len(misfits),
        above=int((misfits > round(largest, 2)).sum()),
    )
