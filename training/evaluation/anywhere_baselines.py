"""Baselines for contacts anywhere: a profile at the commanded pose, and a model of four points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.build import mechanism_of
from cablesense_sim.contact_location import AXIAL_STD_N
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.dataset import Dataset
from cablesense_training.evaluation.anywhere import LocatedContacts
from cablesense_training.inference.estimator import Estimator

_PLACES = 116
"""Places on each segment: 1 mm on the bundled arms."""
_FALSE_CONTACTS = 1e-5
"""Share of untouched samples that may be answered with a contact."""


def commanded_profile(dataset: Dataset) -> LocatedContacts:
    """The force that fits best at every place, as if the arm stood where it is commanded.

    The contact is the place of least misfit on all segments, unless noise explains the
    tensions. There are no intervals, no slack cables and no
    deflection.
    """
    mechanism, command = mechanism_of(dataset.arm), dataset.command_rad
    axes = kinematics.segment_rotations(mechanism, command)
    jacobian = kinematics.cable_jacobian_m(mechanism, command)
    torque = np.einsum("bmj,bm->bj", jacobian, dataset.tension_difference_n)
    variance_n2 = difference_variance_n2(dataset.arm.sensors, dataset.protocol.tare_samples)
    precision = np.linalg.inv(variance_n2 * np.swapaxes(jacobian, 1, 2) @ jacobian)
    untouched = np.einsum("bi,bij,bj->b", torque, precision, torque)
    at_joint, by_place = kinematics.contact_torques(mechanism, command, axes)
    most = np.full(len(dataset), -np.inf)
    segment, place_m = np.zeros(len(dataset), dtype=np.int64), np.zeros(len(dataset))
    force_n = np.zeros((len(dataset), 3))
    for n, (low, high) in enumerate(dataset.protocol.reach_m(dataset.arm)):
        for at_m in np.linspace(low, high, _PLACES):
            lever = at_joint[:, n] + at_m * by_place[:, n]
            weighted = lever @ precision
            information = weighted @ np.swapaxes(lever, 1, 2)
            information[:, 0, 0] += AXIAL_STD_N**-2
            pull = weighted @ torque[..., None]
            force = np.linalg.solve(information, pull)[..., 0]
            gain = np.einsum("bi,bi->b", force, pull[..., 0])
            better = gain > most
            most[better], segment[better], place_m[better] = gain[better], n + 1, at_m
            force_n[better] = force[better]
    segment[untouched < chi2.isf(_FALSE_CONTACTS, torque.shape[1])] = 0
    return _at(segment, place_m, force_n)


def four_points(estimator: Estimator, dataset: Dataset) -> LocatedContacts:
    """A model of contacts at the points of the arm file, which knows no axial force."""
    found = estimator.estimate_batch(dataset.tension_difference_n, dataset.command_rad)
    theta, size = np.deg2rad(found.angle_deg), found.magnitude_n
    force_n = np.stack([0.0 * size, size * np.sin(theta), size * np.cos(theta)], axis=1)
    points_m = np.concatenate([[0.0], mechanism_of(dataset.arm).contact_m])
    return _at(found.segment, points_m[found.segment], force_n)


def _at(segment: NDArray[np.int64], place_m: Array, force_n: Array) -> LocatedContacts:
    moment = place_m * np.linalg.norm(force_n[:, 1:], axis=1)
    return LocatedContacts(segment, place_m, force_n, moment)
