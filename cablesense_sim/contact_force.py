"""The force and the place of a contact that the torques of a sample show, compiled.

Seven torques describe a contact on one segment: those of unit forces along x, y and z at its joint
centre, their derivatives by the place s, and that of a unit moment about its axis. All that a fit
needs are their `products` with one another, weighted with the precision of the environment's
torque. The last row is of that torque: a contact's products are (8, 8), and the last one is
chi² without it. The gain is by how much a force lowers chi².
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.contact_location import AXIAL_STD_N, LARGEST_N, Prior, TorqueBalance

_LEAST_AXIAL_N = 0.01  # the bound of an axial force by friction where the lateral force is zero
SOFT = 0.5
"""Deviation of the bound of friction, as a share of it. A coefficient is known about so well, and
then the interval covers a contact that slides, which is at the bound."""
BOUND_STD = 0.76
"""Standard deviation of an axial force within that soft bound, as a share of the bound."""
_COARSE, _STEPS = 9, 5
"""Places of the first grid, and most Gauss-Newton steps from there. The grid is coarse: the gain
is smooth over a segment, however small the noise is."""
_CONVERGED = 0.02  # a step that is this fraction of the place's deviation is the last
RUBBED = 2
"""Times that friction is linearised at the force found before."""
TWISTS = 5
"""Ranges of the friction across an arm. Its moment is a factor of that of the axial force, so the
posterior is linear in one range only."""
_TWIST_STD = 0.3
"""Deviation of that friction in a range, as a share of its bound: the ranges together have the
deviation of a soft uniform distribution."""
_LARGEST_SINE = 0.9  # of the angle between the normal and the lateral force


Vector = Array | tuple[float, float, float]


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


class Fit(NamedTuple):
    """The best place on a segment."""

    place_m: float
    deviation_m: float
    log_evidence: float  # by Laplace's approximation, up to the prior's volume
    across: float  # middle of a range of the friction across the arm, as a share of its bound
    force: Force


class Rub(NamedTuple):
    """Friction at a touched surface, linear near a force."""

    side_y_m: float  # from the axis to the surface, along the lateral force
    side_z_m: float
    bound_n: float  # of the axial force
    log_share: float  # of the friction across the arm in the log evidence


@compiled
def true_torques(balance: TorqueBalance, b: int, n: int, turn: Array, torques: Array) -> None:
    """Write the seven torques (7, 2N) of a contact on segment n of a sample, along its true axes.

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
def weigh_products(torques: Array, precision: Array, products: Array) -> None:
    """Write the products (K, K) of torques (K, 2N), weighted with a precision (2N, 2N)."""
    joints, weighted = len(precision), np.empty(len(precision))
    for row in range(len(torques)):
        for k in range(joints):
            weighted[k] = 0.0
            for j in range(joints):
                weighted[k] += torques[row, j] * precision[j, k]
        for other in range(row + 1):
            product = 0.0
            for k in range(joints):
                product += weighted[k] * torques[other, k]
            products[row, other] = products[other, row] = product


@compiled
def best_force(products: Array, axial: float, s: float) -> Force:
    """The best force at place s, with a normal prior of its axial component."""
    xx, xy, xz = _at(products, 0, 0, s) + axial, _at(products, 0, 1, s), _at(products, 0, 2, s)
    yy, yz, zz = _at(products, 1, 1, s), _at(products, 1, 2, s), _at(products, 2, 2, s)
    x = products[0, -1] + s * products[3, -1]
    y = products[1, -1] + s * products[4, -1]
    z = products[2, -1] + s * products[5, -1]
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
def _at(products: Array, i: int, j: int, s: float) -> float:
    """Information that components i and j of a force at place s share."""
    by_place = products[i, j + 3] + products[i + 3, j]
    return products[i, j] + s * (by_place + s * products[i + 3, j + 3])


@compiled
def shared(f: Force, one: Vector, other: Vector) -> float:
    """Covariance of a force's components along two vectors."""
    (a, b, c), (x, y, z) = one, other
    return (
        a * (f.xx * x + f.xy * y + f.xz * z)
        + b * (f.xy * x + f.yy * y + f.yz * z)
        + c * (f.xz * x + f.yz * y + f.zz * z)
    )


@compiled
def axial_bound(prior: Prior, lateral: float) -> float:
    """The largest axial force by friction, next to a lateral force."""
    return prior.friction * min(lateral, LARGEST_N) + _LEAST_AXIAL_N


@compiled
def let_rub(free: Array, across: float, force: Force, prior: Prior, products: Array) -> Rub:
    """Write the products with friction near a force, from those without, in a range of it.

    `across` is the middle of the range of the friction across the arm, as a share of the bound.
    """
    radius, friction = prior.radius_m, prior.friction
    # the normal force is beside the lateral one, by the friction across
    sine = min(max(across * friction, -_LARGEST_SINE), _LARGEST_SINE)
    cosine = math.sqrt(1.0 - sine * sine)
    lateral = max(math.hypot(force.y, force.z), 1e-12)
    bound = axial_bound(prior, lateral)
    y, z = force.y / lateral, force.z / lateral
    side_y, side_z = radius * (cosine * y + sine * z), radius * (cosine * z - sine * y)
    ratio = min(max(force.x / lateral, -friction), friction)
    turns_y, turns_z = ratio * (y * sine / cosine - z), ratio * (z * sine / cosine + y)
    known_n_m = -sine * radius * lateral  # about the axis, in the middle of the range
    products[:] = free
    products[-1] -= known_n_m * products[6]
    products[:, -1] -= known_n_m * products[:, 6]
    log_share = free_twist(products, 0, turns_y, turns_z, _TWIST_STD * radius * bound)
    add_friction(products, 0, side_y, side_z)
    log_share += 0.5 * (free[-1, -1] - products[-1, -1]) - math.log(TWISTS)
    return Rub(side_y, side_z, bound, log_share)


@compiled
def add_friction(products: Array, x: int, side_y: float, side_z: float) -> None:
    """Let the axial force act at the surface, which is (side_y, side_z) along the lateral force.

    An axial force f_x at the radius r turns the segment as the lateral force does at r f_x / f.
    The seven torques of the contact begin at row `x`.
    """
    _shift(products, x, x + 4, side_y, side_z)


@compiled
def _shift(products: Array, row: int, lateral: int, y: float, z: float) -> None:
    """Add shares of the two lateral torques from row `lateral` on to the torque of a row."""
    products[row] += y * products[lateral] + z * products[lateral + 1]
    products[:, row] += y * products[:, lateral] + z * products[:, lateral + 1]


@compiled
def free_twist(products: Array, x: int, turns_y: float, turns_z: float, std_n_m: float) -> float:
    """Take the moment of friction across a segment out of what the tensions show.

    Such friction twists the segment, with a normal prior. It is part of the lateral force, so the
    surface is touched beside the direction of that force, and there the axial force acts. A unit
    moment thereby turns the segment as (turns_y, turns_z) of the lateral force, further along.
    Gives the log of what its prior makes of the evidence; its gain is taken off chi².
    """
    t, variance = x + 6, std_n_m * std_n_m
    _shift(products, t, x + 4, turns_y, turns_z)
    growth, along = 1.0 + variance * products[t, t], products[t].copy()
    along[t] = 0.0
    for i in range(len(products)):
        products[i] -= variance / growth * along[i] * along
    return -0.5 * math.log(growth)


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


@compiled
def best_places(products: Array, n: int, prior: Prior, rubbed: Array, fits: list[Fit]) -> float:
    """The best place on segment n, for each range of friction; gives the log evidence.

    `rubbed` (8, 8) is overwritten.
    """
    low, high = prior.reach_m[n, 0], prior.reach_m[n, 1]
    surface = prior.radius_m >= 0.0
    axial, beyond = AXIAL_STD_N**-2, 0.0
    if surface:
        axial = axial_bound(prior, LARGEST_N) ** -2
        beyond = prior.radius_m * prior.friction * (1.0 + SOFT)  # friction shifts it thus far
    s, most = low, -np.inf
    for k in range(_COARSE):
        tried = low - beyond + (high - low + 2.0 * beyond) * k / (_COARSE - 1)
        gain = best_force(products, axial, tried).gain
        if gain > most:
            s, most = tried, gain
    s, deviation = _refined(products, axial, s, low - beyond, high + beyond, high - low)
    force = best_force(products, axial, s)
    if not surface:
        evidence = _evidence(force, axial, deviation)
        fits[n] = Fit(s, deviation, evidence, 0.0, force)
        return evidence
    total, top = 0.0, -np.inf
    for k in range(TWISTS):
        across = 2.0 * k / (TWISTS - 1) - 1.0
        one = fits[n * TWISTS + k] = _rubbed(products, across, force, s, n, prior, rubbed)
        if one.log_evidence > top:
            total, top = total * math.exp(top - one.log_evidence), one.log_evidence
        total += math.exp(one.log_evidence - top)
    return top + math.log(total)


@compiled
def _rubbed(
    products: Array, across: float, force: Force, s: float, n: int, prior: Prior, rubbed: Array
) -> Fit:
    """The best place near another with its force, in a range of the friction across the arm."""
    low, high = prior.reach_m[n, 0], prior.reach_m[n, 1]
    deviation, axial, log_share = 0.0, 0.0, 0.0
    for _ in range(RUBBED):
        rub = let_rub(products, across, force, prior, rubbed)
        axial, s = (BOUND_STD * rub.bound_n) ** -2, min(max(s, low), high)
        s, deviation = _refined(rubbed, axial, s, low, high, high - low)
        force, log_share = best_force(rubbed, axial, s), rub.log_share
    return Fit(s, deviation, _evidence(force, axial, deviation) + log_share, across, force)


@compiled
def _evidence(force: Force, axial: float, deviation: float) -> float:
    """The log evidence by a best force and the deviation of its place, by Laplace's approximation.

    It is not bounded by the largest force, which another place on the segment may not exceed.
    """
    lateral, spread = lateral_of(force.y, force.z, force.yy, force.yz, force.zz)
    density = log_density(force, math.sqrt(axial), lateral, spread, np.inf)
    return density + math.log(deviation * math.sqrt(2.0 * math.pi))


@compiled
def lateral_of(y: float, z: float, yy: float, yz: float, zz: float) -> tuple[float, float]:
    """The lateral force, and its standard deviation along itself."""
    lateral = math.hypot(y, z)
    y, z = (y / lateral, z / lateral) if lateral > 0.0 else (1.0, 0.0)
    return lateral, math.sqrt(y * y * yy + 2.0 * y * z * yz + z * z * zz)


@compiled
def log_density(
    force: Force, axial: float, lateral: float, spread: float, largest_n: float
) -> float:
    """The log density of a place, up to the prior of places and magnitudes.

    `axial` is √2π times the prior density of the axial force. That of magnitude and direction is
    uniform; near zero the noise is the scale of a force.
    """
    beyond = max(lateral - largest_n, 0.0) / spread
    volume = force.determinant * (lateral * lateral + spread * spread)
    return 0.5 * (force.gain + math.log(axial * axial / volume) - beyond * beyond)


@compiled
def _refined(
    products: Array, axial: float, s: float, low: float, high: float, range_m: float
) -> tuple[float, float]:
    """The best place near another one by Gauss-Newton steps, and its standard deviation, m.

    The best force for a place leaves a residual that only the place can lower. Before the tensions
    are known a place is known to the segment's range.
    """
    deviation, across = range_m, np.empty(3)
    for _ in range(_STEPS):
        f = best_force(products, axial, s)
        force, left, own = (f.x, f.y, f.z), 0.0, range_m**-2
        for i in range(3):
            across[i] = 0.0  # information that the place shares with a component of the force
            for j in range(3):
                across[i] += force[j] * (products[3 + j, i] + s * products[3 + j, 3 + i])
                own += force[i] * force[j] * products[3 + i, 3 + j]
            left += force[i] * (products[3 + i, -1] - across[i])
        own -= shared(f, across, across)
        deviation = 1.0 / math.sqrt(own)
        before = s
        s = min(max(s + left / own, low), high)
        if abs(s - before) < _CONVERGED * deviation:
            break
    return s, deviation
