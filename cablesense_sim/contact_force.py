"""The force of a contact at a place, from the torques that a sample shows, compiled.

Seven torques describe a contact on one segment: those of unit forces along x, y and z at its joint
centre, their derivatives by the place s, and that of a unit moment about its axis. Their products
with one another (gram) and with the torque of the environment (pull) are weighted with its
precision. The information of the force is a polynomial in s, and so is its pull. The gain is by
how much a contact lowers chi².
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.contact_location import TorqueBalance

_LEAST_AXIAL_N = 0.01
"""The bound of an axial force by friction where the lateral force is zero."""
SOFT = 0.5
"""Deviation of the bound of friction, as a share of it. A coefficient is known about so well, and
then the interval covers a contact that slides, which is at the bound."""
BOUND_STD = 0.76
"""Standard deviation of an axial force within that soft bound, as a share of the bound."""


class Prior(NamedTuple):
    """The knowledge of a contact before the tensions.

    Attributes:
        reach_m: (N, 2) places on each segment.
        largest_n: lateral force up to which contacts are expected.
        axial_std_n: standard deviation of the axial force, where contacts act on the axis.
        radius_m, friction: of the touched surface; a negative radius for contacts on the axis.
    """

    reach_m: Array
    largest_n: float
    axial_std_n: float
    radius_m: float
    friction: float


class Force(NamedTuple):
    """The best force at a place: gain, determinant of the information, means, covariance."""

    gain: float
    determinant: float
    x: float
    y: float
    z: float
    xx: float
    xy: float
    xz: float
    yy: float
    yz: float
    zz: float


@compiled
def true_torques(balance: TorqueBalance, b: int, n: int, turn: Array, torques: Array) -> None:
    """The seven torques (7, 2N) of a contact on segment n of a sample, along its true axes.

    The touched surface is around the true axis. That is normal to the motion by the segment's own
    two joints; `turn` (3, 3) becomes the true axes, in rows, along those at the commanded angles.
    """
    by_place = balance.by_place[b, n]
    pitch, yaw = by_place[:, 2 * n], by_place[:, 2 * n + 1]
    x = pitch[1] * yaw[2] - pitch[2] * yaw[1]
    y = pitch[2] * yaw[0] - pitch[0] * yaw[2]
    z = pitch[0] * yaw[1] - pitch[1] * yaw[0]
    size = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    turn[0, 0], turn[0, 1], turn[0, 2] = x, y, z
    turn[1, 0], turn[1, 1], turn[1, 2] = -y, 1.0 - y * y / (1.0 + x), -y * z / (1.0 + x)
    turn[2, 0], turn[2, 1], turn[2, 2] = -z, -y * z / (1.0 + x), 1.0 - z * z / (1.0 + x)
    torques[:6], torques[6] = 0.0, balance.by_twist[b, n]
    for i in range(3):
        for j in range(3):
            for k in range(torques.shape[1]):
                torques[i, k] += turn[i, j] * balance.by_force_m[b, n, j, k]
                torques[i + 3, k] += turn[i, j] * by_place[j, k]


@compiled
def weighted_products(
    torques: Array, balance: TorqueBalance, b: int, gram: Array, pull: Array
) -> float:
    """Write the products (K, K) of torques (K, 2N) with one another, and (K,) with a sample's.

    They are weighted with the precision of the sample's torques. Gives chi² without a contact.
    """
    precision, torque, chi2 = balance.precision[b], balance.torque_n_m[b], 0.0
    joints, weighted = len(torque), np.empty(len(torque))
    for row in range(len(torques) + 1):
        one = torques[row] if row < len(torques) else torque
        for k in range(joints):
            weighted[k] = 0.0
            for j in range(joints):
                weighted[k] += one[j] * precision[j, k]
        if row == len(torques):
            chi2 = (weighted * torque).sum()
            break
        pull[row] = (weighted * torque).sum()
        for other in range(row + 1):
            product = 0.0
            for k in range(joints):
                product += weighted[k] * torques[other, k]
            gram[row, other] = gram[other, row] = product
    return chi2


@compiled
def polynomials(gram: Array, pull: Array, shape: Array) -> None:
    """Coefficients (9, 3) in s of the information's xx, xy, xz, yy, yz, zz, and of the pull."""
    row = 0
    for i in range(3):
        for j in range(i, 3):
            shape[row, 0] = gram[i, j]
            shape[row, 1] = gram[i, j + 3] + gram[i + 3, j]
            shape[row, 2] = gram[i + 3, j + 3]
            row += 1
    for i in range(3):
        shape[6 + i, 0], shape[6 + i, 1] = pull[i], pull[i + 3]


@compiled
def best_force(shape: Array, axial: float, s: float) -> Force:
    """The best force at place s, with a normal prior of its axial component."""
    xx = shape[0, 0] + s * (shape[0, 1] + s * shape[0, 2]) + axial
    xy = shape[1, 0] + s * (shape[1, 1] + s * shape[1, 2])
    xz = shape[2, 0] + s * (shape[2, 1] + s * shape[2, 2])
    yy = shape[3, 0] + s * (shape[3, 1] + s * shape[3, 2])
    yz = shape[4, 0] + s * (shape[4, 1] + s * shape[4, 2])
    zz = shape[5, 0] + s * (shape[5, 1] + s * shape[5, 2])
    x, y, z = (
        shape[6, 0] + s * shape[6, 1],
        shape[7, 0] + s * shape[7, 1],
        shape[8, 0] + s * shape[8, 1],
    )
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * cxx + xy * cxy + xz * cxz
    scale = 1.0 / determinant
    cxx, cxy, cxz = scale * cxx, scale * cxy, scale * cxz
    cyy, cyz = scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz)
    czz = scale * (xx * yy - xy * xy)
    fx = cxx * x + cxy * y + cxz * z
    fy = cxy * x + cyy * y + cyz * z
    fz = cxz * x + cyz * y + czz * z
    gain = fx * x + fy * y + fz * z
    return Force(gain, determinant, fx, fy, fz, cxx, cxy, cxz, cyy, cyz, czz)


@compiled
def axial_bound(prior: Prior, lateral: float) -> float:
    """The largest axial force by friction, next to a lateral force."""
    return prior.friction * min(lateral, prior.largest_n) + _LEAST_AXIAL_N


@compiled
def add_friction(gram: Array, pull: Array, x: int, side_y: float, side_z: float) -> None:
    """Let the axial force act at the surface, which is (side_y, side_z) along the lateral force.

    An axial force f_x at the radius r turns the segment as the lateral force does at r f_x / f.
    The seven torques of the contact begin at row `x`.
    """
    _shift(gram, pull, x, x + 4, side_y, side_z)


@compiled
def _shift(gram: Array, pull: Array, row: int, lateral: int, y: float, z: float) -> None:
    """Add shares of the two lateral torques from row `lateral` on to the torque of a row."""
    gram[row] += y * gram[lateral] + z * gram[lateral + 1]
    gram[:, row] += y * gram[:, lateral] + z * gram[:, lateral + 1]
    pull[row] += y * pull[lateral] + z * pull[lateral + 1]


@compiled
def fixed_twist(gram: Array, pull: Array, twist_n_m: float) -> float:
    """Take a known moment about the axis off the torque; gives by how much that lowers chi²."""
    gain = twist_n_m * (2.0 * pull[6] - twist_n_m * gram[6, 6])
    pull -= twist_n_m * gram[:, 6]
    return gain


@compiled
def free_twist(
    gram: Array, pull: Array, x: int, turns_y: float, turns_z: float, std_n_m: float
) -> tuple[float, float]:
    """Take the moment of friction across a segment out of what the tensions show.

    Such friction twists the segment, with a normal prior. It is part of the lateral force, so the
    surface is touched beside the direction of that force, and there the axial force acts. A unit
    moment thereby turns the segment as (turns_y, turns_z) of the lateral force, further along.
    Gives by how much the moment lowers chi², and its log share of the evidence.
    """
    t, variance = x + 6, std_n_m * std_n_m
    _shift(gram, pull, t, x + 4, turns_y, turns_z)
    share, along = variance / (1.0 + variance * gram[t, t]), gram[t].copy()
    along[t] = 0.0
    pull -= share * pull[t] * along
    for i in range(len(gram)):
        gram[i] -= share * along[i] * along
    gain = share * pull[t] ** 2
    return gain, 0.5 * (gain - math.log(1.0 + variance * gram[t, t]))


@compiled
def turned(f: Force, turn: Array) -> Force:
    """A force along true axes (3, 3), in rows, along those at the commanded angles."""
    x, y, z = turn.T
    return Force(
        f.gain,
        f.determinant,
        f.x * x[0] + f.y * x[1] + f.z * x[2],
        f.x * y[0] + f.y * y[1] + f.z * y[2],
        f.x * z[0] + f.y * z[1] + f.z * z[2],
        _shared(f, x, x),
        _shared(f, x, y),
        _shared(f, x, z),
        _shared(f, y, y),
        _shared(f, y, z),
        _shared(f, z, z),
    )


@compiled
def _shared(f: Force, one: Array, other: Array) -> float:
    """Covariance of components along two axes (3,)."""
    x, y, z = other
    return (
        one[0] * (f.xx * x + f.xy * y + f.xz * z)
        + one[1] * (f.xy * x + f.yy * y + f.yz * z)
        + one[2] * (f.xz * x + f.yz * y + f.zz * z)
    )


@compiled
def of_sum(a: float, xx: float, b: float, yy: float, xy: float) -> float:
    """Variance of a x + b y."""
    return a * a * xx + b * b * yy + 2.0 * a * b * xy


@compiled
def bounded(f: Force, bound: float) -> tuple[Force, float]:
    """A force with its axial component bounded by friction, softly, and the log of the share.

    The bound's prior is uniform within ± bound, plus a normal error. The share is that of the
    unbounded force within it; the gain becomes that of the bounded mean.
    """
    width = math.sqrt(f.xx + (SOFT * bound) ** 2)
    sign = -1.0 if f.x < 0.0 else 1.0
    near, far = (sign * f.x - bound) / width, (sign * f.x + bound) / width
    if near < 6.0:
        share = 0.5 * (math.erfc(near * math.sqrt(0.5)) - math.erfc(far * math.sqrt(0.5)))
        at_near = math.exp(-0.5 * near * near) / (share * math.sqrt(2.0 * math.pi))
        at_far = math.exp(-0.5 * far * far) / (share * math.sqrt(2.0 * math.pi))
        log_share, slope = math.log(share), (at_far - at_near) / width
        curvature = (near * at_near - far * at_far) / width**2 - slope**2
    else:  # the tail of a normal distribution, where the share itself underflows
        log_share = -0.5 * near * near - math.log(near * math.sqrt(2.0 * math.pi))
        slope, curvature = -(near + 1.0 / near) / width, -(1.0 - near**-2) / width**2
    slope *= sign
    lost = f.xx * slope * slope
    bounded = Force(
        f.gain - lost,
        f.determinant,
        f.x + f.xx * slope,
        f.y + f.xy * slope,
        f.z + f.xz * slope,
        f.xx + f.xx * f.xx * curvature,
        f.xy + f.xx * f.xy * curvature,
        f.xz + f.xx * f.xz * curvature,
        f.yy + f.xy * f.xy * curvature,
        f.yz + f.xy * f.xz * curvature,
        f.zz + f.xz * f.xz * curvature,
    )
    return bounded, log_share + 0.5 * lost
