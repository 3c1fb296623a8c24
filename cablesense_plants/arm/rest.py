"""Rests (static equilibria) of a body without friction, by Newton steps on the joint torques.

All rows of a recording are solved at once where that is possible. An arm with slack cables can
have two rests under one load, and the path decides which one it takes: so a load is followed row
by row from its start, all loads that begin unloaded side by side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import Body, Ints
from cablesense_plants.arm.geometry import SpanGeometry, cable_lengths_m, spans, torques, turns
from cablesense_plants.cases import PlantError

_ENOUGH_NM = 1e-9
_MOST_STEPS, _LOAD_STEPS = 150, 13
_LEAST_DAMPING = 0.02
_SOFTEST_NM_RAD, _LEAST_NM_RAD = 10.0, 1e-3


class BodyRest(NamedTuple):
    """Angles (B, 2J) and tensions (B, M) at rest."""

    angles_rad: Array
    tensions_n: Array


def commanded_angles_rad(body: Body, command_rad: Array) -> Array:
    """(B, 2J) of commands (B, 2N); a joint that is not driven is straight."""
    angles = np.zeros((len(command_rad), body.joint_count, 2))
    angles[:, body.driven] = command_rad.reshape(len(command_rad), -1, 2)
    return angles.reshape(len(command_rad), -1)


def follow_path(body: Body, command_rad: Array, paid_out_m: Array, loads_n: Array) -> BodyRest:
    """Rests of rows (R, 2N), (R, M), (R, N, 3) in their order.

    Raises:
        PlantError: rows without rest.
    """
    loaded = (loads_n != 0.0).any(axis=(1, 2))
    loaded[0] = False
    angles = commanded_angles_rad(body, command_rad)
    tensions = np.empty_like(paid_out_m)
    free = np.flatnonzero(~loaded)
    angles[free], tensions[free] = find_rest(body, angles[free], paid_out_m[free], loads_n[free])
    changed = (np.diff(loads_n, axis=0) != 0.0).any(axis=(1, 2))
    changed = np.append(True, changed | (np.diff(paid_out_m, axis=0) != 0.0).any(axis=1))
    rows = np.flatnonzero(loaded & ~np.roll(loaded, 1))
    while len(rows):
        new, same = rows[changed[rows]], rows[~changed[rows]]
        angles[same], tensions[same] = angles[same - 1], tensions[same - 1]
        if len(new):
            found = find_rest(body, angles[new - 1], paid_out_m[new], loads_n[new])
            angles[new], tensions[new] = found
        rows = rows + 1
        rows = rows[rows < len(loaded)]
        rows = rows[loaded[rows]]
    return BodyRest(angles, tensions)


def find_rest(body: Body, start_rad: Array, paid_out_m: Array, loads_n: Array) -> BodyRest:
    """Rest of rows near their starts (B, 2J).

    The actuators give cable lengths `paid_out_m` (B, M), less those of the straight arm; the
    forces `loads_n` (B, N, 3) act at the contact points, in base axes.

    Raises:
        PlantError: rows without rest.
    """
    angles, tensions, lost = _search(body, start_rad, paid_out_m, loads_n)
    if len(lost):  # loads put on little by little, each from the rest under the last
        paid, loads, start = paid_out_m[lost], loads_n[lost], start_rad[lost]
        for share in np.linspace(0.0, 1.0, _LOAD_STEPS):
            start, tension, still = _search(body, start, paid, share * loads)
            if len(still):
                raise PlantError(
                    f"no rest found in {len(still)} rows, the first is {lost[still[0]] + 1}; "
                    "smaller loads or angles leave the arm stable"
                )
        angles[lost], tensions[lost] = start, tension
    require_room(body, angles)
    return BodyRest(angles, tensions)


def require_room(body: Body, angles_rad: Array) -> None:
    """Refuse angles (B, 2J) at which the guide plates of a joint would cut into each other.

    Raises:
        PlantError: naming the first row and joint.
    """
    turn = angles_rad.reshape(len(angles_rad), -1, 2)
    bend = np.arccos(np.clip(np.cos(turn).prod(axis=-1), -1.0, 1.0))
    radius = np.linalg.norm(body.after_m[..., 1:], axis=-1).max(axis=1)
    limit = 2.0 * np.arctan2(-body.before_m[:, 0, 0], radius)
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
        found = _residual(body, angles[rows] + move, wanted[rows], loads_n[rows])
        accepted = (found[0] * move).sum(-1) >= -0.5 * (torque[rows] * move).sum(-1)
        kept = rows[accepted]
        angles[kept] += move[accepted]
        for whole, part in zip((torque, slope, tensions), found, strict=True):
            whole[kept] = part[accepted]
        more = np.maximum(_LEAST_DAMPING, 4.0 * damping[rows])
        less = np.where(damping[rows] > _LEAST_DAMPING, 0.25 * damping[rows], 0.0)
        damping[rows] = np.where(accepted, less, more)
    return angles, tensions, np.flatnonzero(np.abs(torque).max(axis=1) > _ENOUGH_NM)


def newton_step_rad(torque_nm: Array, slope_nm_rad: Array, damping: Array) -> Array:
    """Newton's step (B, 2J) where the arm is stable, else one that leads away from the saddle.

    `damping` (B,), a share of the arm's own stiffness, makes it shorter.
    """
    symmetric = 0.5 * (slope_nm_rad + np.swapaxes(slope_nm_rad, -1, -2))
    softest = np.linalg.eigvalsh(symmetric)[:, -1]
    diagonal = np.arange(slope_nm_rad.shape[-1])
    own = np.abs(slope_nm_rad[:, diagonal, diagonal])
    firmer = slope_nm_rad.copy()
    firmer[:, diagonal, diagonal] -= damping[:, None] * np.maximum(own, _SOFTEST_NM_RAD)
    unstable = softest > -_LEAST_NM_RAD
    firmer[:, diagonal, diagonal] -= (unstable * (2.0 * np.abs(softest) + 0.5))[:, None]
    return np.asarray(np.linalg.solve(firmer, -torque_nm[..., None])[..., 0], dtype=float)


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
