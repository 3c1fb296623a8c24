"""Statics of a body without friction: its geometry, the torques on its joints, and its rests.

A rest is a static equilibrium, found by Newton steps on the joint torques; all rows of a recording
are solved at once where that is possible. An arm with slack cables can have two rests under one
load, and the path decides which one it takes. So a load is followed row by row from its start, and
all loads that begin unloaded are followed side by side.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_plants.arm.body import Body, CableContact, Ints, TipSpring
from cablesense_plants.cases import PlantError

_LEFT = [0, 0, 1]
_RIGHT = [0, 1, 1]
_PITCH_ORDER = np.array([0, 1, 0, 2, 1, 0])
_YAW_ORDER = np.array([0, 0, 1, 0, 1, 2])
_ENOUGH_NM = 1e-9
_LEAST_SPAN_M = 1e-9
"""Holes of a joint can meet where a step of the search folds it."""
_LONGEST_STEP_RAD = 0.5
_MOST_STEPS = 500
_LOAD_STEPS = 13
"""Stiff arms whose weight leaves cables slack take hundreds of steps."""
_LEAST_DAMPING = 0.02
_ROOM = 0.75
"""Share of the bend at which plates touch that a load which the arm bears may use."""
_SOFTEST_NM_RAD = 10.0
_LEAST_NM_RAD = 1e-3


class SpanGeometry(NamedTuple):
    """The pieces of cable across the joints, B rows.

    Attributes:
        length_m: (B, J, M) from plate to plate, with what contacts of cables add; 0 where a cable
            ends before.
        slope_m_rad: (B, J, 2, M) by pitch and yaw of that joint.
        curve_m_rad2: (B, J, 3, M) second derivatives: pitch twice, both, yaw twice.
        bend_rad: (B, J, 2, M) by which the cable turns at the guides before and after the joint; 0
            where it is anchored or has ended.
    """

    length_m: Array
    slope_m_rad: Array
    curve_m_rad2: Array
    bend_rad: Array


class JointFrames(NamedTuple):
    """The joints in the base frame, B rows.

    Attributes:
        rotation: (B, J, 3, 3) of the frame that each joint turns.
        centre_m: (B, J, 3) of each joint.
        axis: (B, 2J, 3) pitch and yaw axes, unit.
    """

    rotation: Array
    centre_m: Array
    axis: Array

    def points_m(self, joint: Ints, at_m: Array) -> Array:
        """(B, P, 3) base-frame places of points (P, 3) of the frames that joints (P,) turn."""
        return self.centre_m[:, joint] + (self.rotation[:, joint] @ at_m[..., None])[..., 0]


class BodyRest(NamedTuple):
    """Angles (B, 2J) and tensions (B, M) at rest."""

    angles_rad: Array
    tensions_n: Array


def turns(body: Body, angles_rad: Array) -> Array:
    """(6, B, J, 3, 3) rotations over joints at angles (B, 2J), derivatives p, y, pp, py, yy."""
    by_pitch = _about(angles_rad[:, ::2], 2, 0)
    by_yaw = _about(angles_rad[:, 1::2], 0, 1)
    level = np.swapaxes(body.skew, -1, -2)
    return body.skew @ by_pitch[_PITCH_ORDER] @ by_yaw[_YAW_ORDER] @ level


def _about(angle: Array, first: int, second: int) -> Array:
    """(3, ..., 3, 3) turns from axis `first` to axis `second`, first and second derivatives."""
    result = np.zeros((3, *angle.shape, 3, 3))
    sine = np.sin(angle)
    cosine = np.cos(angle)
    for order, (along, across) in enumerate(((cosine, sine), (-sine, cosine), (-cosine, -sine))):
        result[order, ..., first, first] = result[order, ..., second, second] = along
        result[order, ..., second, first] = across
        result[order, ..., first, second] = -across
    still = 3 - first - second
    result[0, ..., still, still] = 1.0
    return result


def spans(body: Body, angles_rad: Array, turning: Array, with_bends: bool = False) -> SpanGeometry:
    """Cable spans at joint angles (B, 2J), of which `turning` are the `turns`."""
    turned = turning @ np.swapaxes(body.after_m, -1, -2)
    v = turned[0] - np.swapaxes(body.before_m, -1, -2)
    first = turned[1:3]
    second = turned[3:6]
    length = np.maximum(np.sqrt((v * v).sum(-2)), _LEAST_SPAN_M)
    slope = (first * v).sum(-2) / length
    pairs = (first[_LEFT] * first[_RIGHT] + second * v).sum(-2)
    curve = (pairs - slope[_LEFT] * slope[_RIGHT]) / length
    bends = _bends(body, turning[0], v / length[..., None, :]) if with_bends else np.zeros(0)
    slope, curve = (np.moveaxis(values * body.passes, 0, -2) for values in (slope, curve))
    length = length * body.passes
    for contact in body.cable_contacts:
        _push_aside(contact, angles_rad, length, slope, curve)
    return SpanGeometry(length, slope, curve, bends)


def _push_aside(
    contact: CableContact, angles_rad: Array, length: Array, slope: Array, curve: Array
) -> None:
    """Add to lengths, slopes and curves what a contact of cables does beyond its angle."""
    j = contact.joint
    cables = list(contact.cables)
    (p, y) = contact.toward
    beyond = p * angles_rad[:, 2 * j] + y * angles_rad[:, 2 * j + 1] - contact.from_rad
    beyond = np.maximum(beyond, 0.0)[:, None]
    touching = (beyond > 0.0) * 2.0 * contact.depth_m_rad2
    length[:, j, cables] += contact.depth_m_rad2 * beyond**2
    for i, share in enumerate((p, y)):
        slope[:, j, i, cables] += touching * beyond * share
    for i, share in enumerate((p * p, p * y, y * y)):
        curve[:, j, i, cables] += touching * share


def _bends(body: Body, turning: Array, direction: Array) -> Array:
    """(B, J, 2, M) by the straight pieces inside the segments before and after each joint."""
    pieces = body.inside_m / np.linalg.norm(body.inside_m, axis=-1, keepdims=True)
    outside = np.broadcast_to([1.0, 0.0, 0.0], (1, *pieces.shape[1:]))
    back = np.swapaxes(np.concatenate([outside, pieces]), -1, -2)
    ahead = np.swapaxes(np.concatenate([pieces, outside]), -1, -2)
    turned_direction = np.swapaxes(turning, -1, -2) @ direction
    away = np.stack([direction - back, turned_direction - ahead], axis=-3)
    chords = np.sqrt((away * away).sum(axis=-2))
    anchored = np.append(body.passes[1:], np.zeros_like(body.passes[:1]), axis=0)
    guided = np.stack([body.passes, anchored], axis=1)
    return 2.0 * np.arcsin(np.minimum(0.5 * chords, 1.0)) * guided


def cable_lengths_m(body: Body, angles_rad: Array) -> Array:
    """(B, M) lengths across all joints at angles (B, 2J); what lies in segments is constant."""
    return spans(body, angles_rad, turns(body, angles_rad)).length_m.sum(-2)


def frames(body: Body, angles_rad: Array, turning: Array) -> JointFrames:
    """Frames of the joints in base axes at angles (B, 2J), of which `turning` are the `turns`."""
    rows = angles_rad.shape[0]
    joints = body.joint_count
    sine = np.sin(angles_rad[:, ::2])
    cosine = np.cos(angles_rad[:, ::2])
    rotation = np.empty((rows, joints, 3, 3))
    centre = np.empty((rows, joints, 3))
    axis = np.empty((rows, 2 * joints, 3))
    before: Array = np.tile(np.eye(3), (rows, 1, 1))
    joint_m: Array = np.zeros((rows, 3))
    for j in range(joints):
        centre[:, j] = joint_m = joint_m + body.spacing_m[j] * before[:, :, 0]
        skewed = before @ body.skew[j]
        axis[:, 2 * j] = skewed[:, :, 1]
        forward = sine[:, j, None] * skewed[:, :, 0]
        axis[:, 2 * j + 1] = forward + cosine[:, j, None] * skewed[:, :, 2]
        rotation[:, j] = before = before @ turning[0, :, j]
    return JointFrames(rotation, centre, axis)


def torques(body: Body, angles_rad: Array, turning: Array, loads_n: Array) -> tuple[Array, Array]:
    """Generalised forces of all but cables and friction: N·m (B, 2J), and slopes (B, 2J, 2J).

    Those of weights, loads (B, P, 3) at the first P points of `Body.contact_at_m`, row by row,
    springs and surroundings, at joint angles (B, 2J), of which `turning` are the `turns`.
    """
    placed = frames(body, angles_rad, turning)
    points = loads_n.shape[1]
    joint = np.concatenate([body.mass_joint, body.contact_joint.ravel()[:points]])
    place_m = np.concatenate([body.mass_at_m, body.contact_at_m.reshape(-1, 3)[:points]])
    weight = np.tile(body.mass_kg[:, None] * body.gravity_m_s2, (len(angles_rad), 1, 1))
    force = np.concatenate([weight, loads_n], axis=1)
    torque, slope = _constant_forces(placed, joint, placed.points_m(joint, place_m), force)
    for spring in body.tip_springs:
        pulled = _tip_spring(body, placed, spring)
        torque = torque + pulled[0]
        slope = slope + pulled[1]
    linear = body.spring_nm_rad.ravel()
    cubic = body.hardening_nm_rad3.ravel()
    height = body.cogging_nm.ravel()
    per = body.cogging_per_turn
    back = -(linear + cubic * angles_rad**2) * angles_rad - height * np.sin(per * angles_rad)
    stiffness = -linear - 3.0 * cubic * angles_rad**2 - per * height * np.cos(per * angles_rad)
    diagonal = np.arange(angles_rad.shape[1])
    slope[:, diagonal, diagonal] += stiffness
    return torque + back, slope


def _constant_forces(
    placed: JointFrames, joint: Ints, point_m: Array, force_n: Array
) -> tuple[Array, Array]:
    """By forces (B, P, 3) that keep their direction: J(q)^T F and its derivative.

    With W the sum of (p - o) F^T beyond a joint, the derivative by two angles, the axis `a` not
    beyond `b`, is a^T W b - trace(W) a^T b.
    """
    joints = placed.centre_m.shape[1]
    beyond = (joint[:, None] >= np.arange(joints)).astype(float)
    arm = point_m[:, :, None, :] - placed.centre_m[:, None]
    pushed = force_n[:, :, None, :] * beyond[..., None]
    moment = np.swapaxes(np.moveaxis(arm, 2, 1), -1, -2) @ np.moveaxis(pushed, 2, 1)
    first = [1, 2, 0]
    second = [2, 0, 1]
    turning = moment[..., first, second] - moment[..., second, first]
    axis = placed.axis
    torque = (axis * np.repeat(turning, 2, axis=1)).sum(-1)
    moments = np.repeat(moment, 2, axis=1)
    trace = (moments[..., 0, 0] + moments[..., 1, 1] + moments[..., 2, 2])[..., None]
    far = (moments @ axis[..., None])[..., 0] - trace * axis
    nearer = axis @ np.swapaxes(far, -1, -2)
    upper = np.tri(nearer.shape[-1]).T
    return torque, nearer * upper + np.swapaxes(nearer * (upper - np.eye(len(upper))), -1, -2)


def _tip_spring(body: Body, placed: JointFrames, spring: TipSpring) -> tuple[Array, Array]:
    last = np.array([body.joint_count - 1])
    tip = placed.points_m(last, body.tip_at_m[None])
    away = tip[:, 0] - np.array(spring.anchor_m)
    stiffness = np.broadcast_to(spring.stiffness_n_m * np.eye(3), (len(away), 3, 3))
    if spring.normal is not None:
        normal = np.array(spring.normal)
        touching = (away @ normal > 0.0).astype(float)
        stiffness = touching[:, None, None] * spring.stiffness_n_m * np.outer(normal, normal)
    force = -(stiffness @ away[..., None])[..., 0]
    torque, slope = _constant_forces(placed, last, tip, force[:, None])
    lever = np.cross(placed.axis, tip - np.repeat(placed.centre_m, 2, axis=1))
    return torque, slope - lever @ stiffness @ np.swapaxes(lever, -1, -2)


def tension_law(body: Body, stretch_m: Array) -> tuple[Array, Array]:
    """Tension and its slope, N and N/m, of a stretch counted from the pretension."""
    n = body.exponent
    base = 1.0 + body.stiffness_n_m * stretch_m / (n * body.pretension_n)
    taut = base > 0.0
    base = np.where(taut, base, 1.0)
    slope = body.stiffness_n_m * base ** (n - 1.0)
    return body.pretension_n * base**n * taut, slope * taut


def with_cable_torques(
    across: SpanGeometry, tension_n: Array, torque_nm: Array, slope_nm_rad: Array
) -> tuple[Array, Array]:
    """Torques (B, 2J) and slopes (B, 2J, 2J) with those of constant span tensions (B, J, M)."""
    cables = -(across.slope_m_rad @ tension_n[..., None])[..., 0]
    blocks = -(across.curve_m_rad2 @ tension_n[..., None])[..., 0]
    p = np.arange(0, torque_nm.shape[-1], 2)
    for row, column, block in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        slope_nm_rad[:, p + row, p + column] += blocks[..., block]
    return cables.reshape(torque_nm.shape) + torque_nm, slope_nm_rad


def commanded_angles_rad(body: Body, command_rad: Array) -> Array:
    """(B, 2J) of commands (B, 2N); a joint that is not driven is straight."""
    angles = np.zeros((len(command_rad), body.joint_count, 2))
    angles[:, body.driven] = command_rad.reshape(len(command_rad), -1, 2)
    return angles.reshape(len(command_rad), -1)


def follow_path(body: Body, command_rad: Array, paid_out_m: Array, loads_n: Array) -> Array:
    """Tensions (R, M) at the rests of rows (R, 2N), (R, M), (R, P, 3) in their order.

    Raises:
        PlantError: rows without rest.
    """
    loaded = (loads_n != 0.0).any(axis=(1, 2))
    loaded[0] = False
    angles = commanded_angles_rad(body, command_rad)
    tensions = np.empty_like(paid_out_m)
    free = np.flatnonzero(~loaded)
    angles[free], tensions[free] = find_rest(body, angles[free], paid_out_m[free], loads_n[free])
    rows = np.flatnonzero(loaded & ~np.roll(loaded, 1))
    while len(rows):
        rest = find_rest(body, angles[rows - 1], paid_out_m[rows], loads_n[rows])
        angles[rows], tensions[rows] = rest
        rows = rows[rows + 1 < len(loaded)] + 1
        rows = rows[loaded[rows]]
    return tensions


def find_rest(body: Body, start_rad: Array, paid_out_m: Array, loads_n: Array) -> BodyRest:
    """Rest of rows near their starts (B, 2J).

    The actuators give cable lengths `paid_out_m` (B, M), less those of the straight arm; the
    forces `loads_n` (B, P, 3) act at the points that `torques` names, in base axes.

    Raises:
        PlantError: rows without rest.
    """
    angles, tensions, lost = _search(body, start_rad, paid_out_m, loads_n)
    lost = np.union1d(lost, np.flatnonzero(~_has_room(body, angles)))
    if len(lost):  # weights and loads little by little, each from the rest under the last
        paid = paid_out_m[lost]
        loads = loads_n[lost]
        start = start_rad[lost]
        for share in np.linspace(0.0, 1.0, _LOAD_STEPS):
            lighter = replace(body, gravity_m_s2=share * body.gravity_m_s2)
            start, tension, still = _search(lighter, start, paid, share * loads)
            if len(still):
                raise PlantError(
                    f"no rest found in {len(still)} rows, the first is {lost[still[0]] + 1}; "
                    "smaller loads or angles leave the arm stable"
                )
        angles[lost] = start
        tensions[lost] = tension
    require_room(body, angles)
    return BodyRest(angles, tensions)


def borne_shares(body: Body, start_rad: Array, paid_out_m: Array, loads_n: Array) -> Array:
    """(B,) largest share of loads, in twelfths, that leaves a rest and room between the plates.

    Arguments as in `find_rest`; weights and then loads are put on little by little. -1 where even
    the unloaded arm has no rest with that room.
    """
    shares = np.linspace(0.0, 1.0, _LOAD_STEPS)
    angles = np.array(start_rad)
    borne = np.full(len(start_rad), -1.0)
    rows = np.arange(len(borne))
    for weight, load in [
        *((share, 0.0) for share in shares[:-1]),
        *((1.0, share) for share in shares),
    ]:
        lighter = replace(body, gravity_m_s2=weight * body.gravity_m_s2)
        paid = paid_out_m[rows]
        loads = load * loads_n[rows]
        angles[rows], _, lost = _search(lighter, angles[rows], paid, loads)
        held = _has_room(body, angles[rows], _ROOM)
        held[lost] = False
        rows = rows[held]
        if not len(rows):
            break
        borne[rows] = load if weight == 1.0 else -1.0
    return borne


def _has_room(body: Body, angles_rad: Array, share: float = 1.0) -> NDArray[np.bool_]:
    """(B,) whether no joint bends by more than a share of the angle at which its plates touch."""
    bend, limit = _bends_rad(body, angles_rad)
    return np.asarray((bend <= share * limit).all(axis=1))


def _bends_rad(body: Body, angles_rad: Array) -> tuple[Array, Array]:
    """Bends (B, J) of joints at angles (B, 2J), and (J,) those at which their plates touch."""
    turn = angles_rad.reshape(len(angles_rad), body.joint_count, 2)
    radius = np.linalg.norm(body.after_m[..., 1:], axis=-1).max(axis=1)
    limit = 2.0 * np.arctan2(-body.before_m[:, 0, 0], radius)
    return np.arccos(np.clip(np.cos(turn).prod(axis=-1), -1.0, 1.0)), limit


def require_room(body: Body, angles_rad: Array) -> None:
    """Refuse angles (B, 2J) at which the guide plates of a joint would cut into each other.

    Raises:
        PlantError: naming the first row and joint.
    """
    bend, limit = _bends_rad(body, angles_rad)
    beyond = np.argwhere(bend > limit)
    if len(beyond):
        row, joint = beyond[0]
        raise PlantError(
            f"row {row + 1}: joint {joint + 1} bends by {np.rad2deg(bend[row, joint]):.0f} "
            f"degrees and its plates touch at {np.rad2deg(limit[joint]):.0f}; "
            "use smaller loads or angles"
        )


def _search(
    body: Body, start_rad: Array, paid_out_m: Array, loads_n: Array
) -> tuple[Array, Array, Ints]:
    """Angles, tensions, and the rows that found no rest."""
    angles = np.array(start_rad, dtype=float)
    wanted = paid_out_m + cable_lengths_m(body, np.zeros((1, angles.shape[1])))
    torque, slope, tensions = _residual(body, angles, wanted, loads_n)
    damping = np.zeros(len(angles))
    for _ in range(_MOST_STEPS):
        rows = np.flatnonzero(np.abs(torque).max(axis=1) > _ENOUGH_NM)
        if not len(rows):
            break
        move = newton_step_rad(torque[rows], slope[rows], damping[rows])
        tried = _residual(body, angles[rows] + move, wanted[rows], loads_n[rows])
        accepted = (tried[0] * move).sum(-1) >= -0.5 * (torque[rows] * move).sum(-1)
        kept = rows[accepted]
        angles[kept] += move[accepted]
        for whole, part in zip((torque, slope, tensions), tried, strict=True):
            whole[kept] = part[accepted]
        damping[rows] = damped(damping[rows], accepted)
    return angles, tensions, np.flatnonzero(np.abs(torque).max(axis=1) > _ENOUGH_NM)


def newton_step_rad(torque_nm: Array, slope_nm_rad: Array, damping: Array) -> Array:
    """Newton's step (B, 2J) where the arm is stable, else one that leads away from the saddle.

    `damping` (B,), a share of the arm's own stiffness, makes it shorter.
    """
    symmetric = 0.5 * (slope_nm_rad + np.swapaxes(slope_nm_rad, -1, -2))
    softest = np.linalg.eigvalsh(symmetric)[:, -1]
    diagonal = np.arange(slope_nm_rad.shape[-1])
    stiffness = np.abs(slope_nm_rad[:, diagonal, diagonal])
    firmer = slope_nm_rad.copy()
    firmer[:, diagonal, diagonal] -= damping[:, None] * np.maximum(stiffness, _SOFTEST_NM_RAD)
    unstable = softest > -_LEAST_NM_RAD
    firmer[:, diagonal, diagonal] -= (unstable * (2.0 * np.abs(softest) + 0.5))[:, None]
    step = np.asarray(np.linalg.solve(firmer, -torque_nm[..., None])[..., 0], dtype=float)
    longest = np.abs(step).max(axis=1, keepdims=True, initial=_LONGEST_STEP_RAD)
    return step * (_LONGEST_STEP_RAD / longest)


def damped(damping: Array, accepted: NDArray[np.bool_]) -> Array:
    """Damping (B,) of the next steps: less after a step that was accepted, else more."""
    more = np.maximum(_LEAST_DAMPING, 4.0 * damping)
    less = np.where(damping > _LEAST_DAMPING, 0.25 * damping, 0.0)
    return np.where(accepted, less, more)


def _residual(
    body: Body, angles: Array, wanted_m: Array, loads_n: Array
) -> tuple[Array, Array, Array]:
    turning = turns(body, angles)
    across = spans(body, angles, turning)
    tension, stiffness = tension_law(body, across.length_m.sum(-2) - wanted_m)
    torque, matrix = torques(body, angles, turning, loads_n)
    slopes = across.slope_m_rad.reshape(*angles.shape, -1)
    matrix = matrix - (slopes * stiffness[:, None, :]) @ np.swapaxes(slopes, 1, 2)
    shared = np.broadcast_to(tension[:, None, :], across.length_m.shape)
    return *with_cable_torques(across, shared, torque, matrix), tension
