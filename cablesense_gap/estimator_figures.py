"""Errors of a force estimator on the loads of a recording, which are known from outside."""

from __future__ import annotations

import numpy as np

from cablesense_gap.tared_loads import Array, TaredLoads
from cablesense_sim.loads import normal_components_n, normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_training.inference.estimator import Estimates


def answered_n(mechanism: Mechanism, loads: TaredLoads, estimates: Estimates) -> Array:
    """(B, N, 3) estimated forces in base axes; nothing where the answer is no contact."""
    return normal_force_n(
        mechanism,
        loads.command_rad,
        estimates.segment,
        estimates.angle_deg,
        np.maximum(estimates.magnitude_n, 0.0),
    )


def estimator_figures(
    mechanism: Mechanism, loads: TaredLoads, answer_n: Array
) -> dict[str, float]:
    """Errors of answers (B, N, 3) at the peaks of loads.

    `contact_accuracy` is the share of rows with the right segment, `force_mae_n` the mean error of
    the magnitude over all rows, no contact being 0 N, `direction_mean_deg` the mean angle between
    force and estimate over rows where a contact was found, and `loads` the number of loads. Of a
    load only what is normal to its segment counts, as nothing else can be felt.
    """
    at = loads.at_peak
    truth = _normal_n(mechanism, loads)[at]
    answer = answer_n[at]
    size = np.linalg.norm(answer, axis=-1)
    segment = np.where(size.any(axis=1), size.argmax(axis=1) + 1, 0)
    force, true_force = answer.sum(1), np.linalg.norm(truth, axis=-1)
    found = (segment > 0) & (true_force > 0.0)
    cosine = (force * truth).sum(-1)[found] / (size.sum(1) * true_force)[found]
    figures = {
        "contact_accuracy": float(np.mean(segment == loads.segment[at])),
        "force_mae_n": float(np.abs(size.sum(1) - true_force).mean()),
        "loads": float(len(np.unique(loads.trial[at]))),
    }
    if found.any():
        angle = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        figures["direction_mean_deg"] = float(angle.mean())
    return figures


def _normal_n(mechanism: Mechanism, loads: TaredLoads) -> Array:
    """(B, 3) what of each load is normal to its segment at the commanded angles."""
    y, z = normal_components_n(mechanism, loads.command_rad, loads.segment, loads.force_n)
    angle = np.rad2deg(np.arctan2(y, z))
    return normal_force_n(mechanism, loads.command_rad, loads.segment, angle, np.hypot(y, z)).sum(
        1
    )
