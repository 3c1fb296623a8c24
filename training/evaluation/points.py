"""The law's answers where contacts are known to be at the points of the arm file.

There a contact on each segment is a linear fit of its two components across the segment to what a
reading says of the joint torques. That is what networks of the paper are asked, so both can be
compared on the same samples. With the information H of a fit, its evidence against no contact is
by Laplace

    log E = f' H f / 2 + log(2 sqrt(det H⁻¹) / F²),

for forces that are uniform over a disc up to F (MacKay, Information Theory, Inference, and
Learning Algorithms, 2003, chapter 28).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_contact.law import Law, LawOutput
from cablesense_training.evaluation.metrics import ContactAnswer

CONTACT_NUMBERS = 2
"""Numbers that a contact at a point fits."""
_ROWS_AT_ONCE = 256
"""In one call of the law: they fit the memory of a laptop."""


class PointContacts(NamedTuple):
    """One contact at the point of each of N segments, for B samples.

    Attributes:
        force_n: (B, N, 2) along y and z of the segment at the command.
        covariance_n2: (B, N, 2, 2).
        log_evidence: (B, N) against no contact.
        chi2: (B, N) what each leaves unexplained: the normalised innovation squared.
    """

    force_n: Array
    covariance_n2: Array
    log_evidence: Array
    chi2: Array


def at_points(seen: LawOutput, points_m: Array, largest_n: float) -> PointContacts:
    """Contacts at points (N,) from the joint centres, normal to their segments."""
    lever = seen.at_joint_m[:, :, 1:] + points_m[:, None, None] * seen.by_place[:, :, 1:]
    by_force = lever @ np.swapaxes(seen.by_torque, 1, 2)[:, None]
    weighted = by_force @ seen.information_n2[:, None]
    information = weighted @ np.swapaxes(by_force, 2, 3)
    # a force that no taut cable shows is as uncertain as it was
    information = information + largest_n**-2 * np.eye(2)
    covariance = np.asarray(np.linalg.inv(information))
    pull = weighted @ seen.innovation_n[:, None, :, None]
    force = (covariance @ pull)[..., 0]
    explained = (force * pull[..., 0]).sum(axis=2)
    log_width = 0.5 * np.log(np.linalg.det(covariance))
    occam = log_width + np.log(2.0) - 2.0 * np.log(largest_n)
    innovation = seen.innovation_n[:, None, :]
    untouched = (innovation @ seen.information_n2 @ np.swapaxes(innovation, 1, 2))[:, 0]
    chi2 = untouched - explained
    return PointContacts(force, covariance, 0.5 * explained + occam, chi2)


def point_answer(
    law: Law,
    known: Calibration,
    readings_n: Array,
    commands_rad: Array,
    points_m: Array,
    largest_n: float,
    most_chi2: float = math.inf,
) -> ContactAnswer:
    """The likeliest contact behind readings (B, M) at commands (B, 2N), or none.

    None also where it leaves a larger χ² than `most_chi2`, as where two cables of a joint are
    slack on an arm that is exactly known.
    Contacts are at points (N,) from the joint centres, and as strong as `largest_n` at most. What
    is `known` of the arm is the same for all.
    """
    unrest = np.zeros((commands_rad.shape[1], commands_rad.shape[1]))
    parts = []
    for first in range(0, len(readings_n), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        seen = law(readings_n[rows], commands_rad[rows], known.mean, known.covariance, unrest)
        parts.append(at_points(seen, points_m, largest_n))
    contacts = PointContacts._make(np.concatenate(column) for column in zip(*parts, strict=True))
    samples = np.arange(len(contacts.force_n))
    best = contacts.log_evidence.argmax(axis=1)
    is_likely = contacts.log_evidence[samples, best] > 0.0
    is_explained = contacts.chi2[samples, best] <= most_chi2
    force = contacts.force_n[samples, best]
    covariance = contacts.covariance_n2[samples, best]
    size_n = np.maximum(np.hypot(force[:, 0], force[:, 1]), 1e-9)
    along = force / size_n[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return ContactAnswer(
        segment=np.where(is_likely & is_explained, best + 1, 0),
        angle_deg=np.rad2deg(np.arctan2(force[:, 0], force[:, 1])) % 360.0,
        magnitude_n=size_n,
        magnitude_std_n=_std(along, covariance),
        angle_std_deg=np.rad2deg(_std(across, covariance) / size_n),
    )


def _std(direction: Array, covariance: Array) -> Array:
    """(B,) standard deviations along directions (B, 2) of covariances (B, 2, 2)."""
    return np.sqrt(np.einsum("bi,bij,bj->b", direction, covariance, direction))
