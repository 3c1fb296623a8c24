"""Tendons over guides: what friction takes of their pull, by the chain law of `cable_chain`.

Cables are taken as rigid: a recording has the joints' positions, and either tensions at the
actuators or torques, but no lengths from which a stretch would follow. What a cable gives before
it slips is that of Dahl's law, guide by guide, along the way that it passes there.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_robot.model import Change, Robot
from cablesense_robot.motion import Trajectory, dahl

_LEAST_GIVE = 1e-4
"""Of the way that passes a guide: how far cable gives at least."""
_LEAST_M, _RIDGE = 1e-9, 1e-9
_SITE = int(mujoco.mjtWrap.mjWRAP_SITE)


class _Path(NamedTuple):
    """One tendon at R rows, in P straight pieces from its actuator on, with guides between them.

    Attributes:
        lever_m: (R, P, J) of each piece, its length by the joints.
        turn_rad: (R, P - 1) wrap angle at each guide.
        passed_m: (R, P - 1) cable that has passed it towards the actuator.
    """

    lever_m: Array
    turn_rad: Array
    passed_m: Array


class GuidedTendons:
    """The tendons of a robot along a motion, as it was measured or is asked for."""

    def __init__(self, robot: Robot, motion: Trajectory) -> None:
        """Tensions are those that the actuators make of recorded commands, where there are any."""
        model = robot.model
        self._trial, self._shares = motion.trial, dict[tuple[int, float], Array]()
        tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        pulls = tendon & (model.actuator_trnid[:, :1] == robot.tendon_ids[:, None, None])[..., 0]
        self._pulls = np.where(pulls, -model.actuator_gear[:, 0], 0.0)
        self._moment, force, self._paths = _followed(robot, motion)
        known = np.isfinite(motion.command).all() and not model.na
        self._tension_n = force @ self._pulls.T if known else None

    def lost(self, change: Change, torque: Array, *, at_drive: bool = False) -> Array:
        """(R, J) by how much the torques of the drives are more than what reaches the joints.

        Where no commands were recorded, tensions are the least that give `torque` (R, J), at the
        joints or `at_drive`; a tendon that pushes then stands for its counterpart, which pulls.
        """
        used = np.flatnonzero(change.capstan_friction).tolist()
        tension_n = self._tension_n
        if tension_n is None:
            tension_n = self._least_n(self._moment, torque)
        lost = {k: self._lost_m(k, change, np.sign(tension_n[:, k])) for k in used}
        if self._tension_n is None and not at_drive:
            moment = self._moment.copy()
            for k in used:
                moment -= self._pulls[k][:, None] * lost[k][:, None, :]
            tension_n = self._least_n(moment, torque)
        return np.asarray(sum(tension_n[:, k, None] * lost[k] for k in used))

    def _least_n(self, moment: Array, torque: Array) -> Array:
        """(R, K) tensions of actuators with moments (R, A, J) that give torques (R, J)."""
        square = moment.swapaxes(1, 2) @ moment
        own = np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(square.shape[-1])
        by_joint = np.linalg.solve(square + _RIDGE * own + 1e-30, torque[..., None])
        return np.asarray((moment @ by_joint)[..., 0] @ self._pulls.T)

    def _lost_m(self, k: int, change: Change, way: Array) -> Array:
        """(R, J) what a tendon loses of its moment, pulling (1) or pushing (-1)."""
        from cablesense_sim.cable_chain import kept  # compiled: none without friction waits

        path, give_m = self._paths[k], float(change.capstan_presliding[k])
        if (k, give_m) not in self._shares:
            self._shares = {key: each for key, each in self._shares.items() if key[0] != k}
            ends = np.flatnonzero(np.diff(self._trial)) + 1
            self._shares[k, give_m] = np.column_stack(
                [
                    np.concatenate([dahl(p, max(give_m, least)) for p in np.split(passed, ends)])
                    for passed in path.passed_m.T
                    for least in (_LEAST_GIVE * np.ptp(passed) + _LEAST_M,)
                ]
            )
        share = self._shares[k, give_m] * way[:, None]
        left = kept(share, change.capstan_friction[k] * path.turn_rad) - 1.0
        return np.einsum("rp,rpj->rj", left, path.lever_m[:, 1:])


def _followed(robot: Robot, motion: Trajectory) -> tuple[Array, Array, list[_Path]]:
    """Moments (R, A, J) and forces (R, A) of all actuators, and the paths of guided tendons."""
    model, data, rows = robot.model, mujoco.MjData(robot.model), len(motion.position)
    parts = [_parts(model, t) for t in robot.tendon_ids]
    points = [np.full((rows, len(own), 2, 3), np.nan) for own in parts]
    moment, force = np.zeros((rows, model.nu, model.nv)), np.empty((rows, model.nu))
    axis, anchor = np.empty((rows, model.nv, 3)), np.empty((rows, model.nv, 3))
    command = np.nan_to_num(motion.command)
    for row in range(rows):
        data.qpos[:], data.qvel[:] = motion.position[row], motion.speed[row]
        data.ctrl[:] = command[row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        axis[row], anchor[row], force[row] = data.xaxis, data.xanchor, data.actuator_force
        mujoco.mju_sparse2dense(
            moment[row], data.actuator_moment, data.moment_rownnz, data.moment_rowadr,
            data.moment_colind,
        )  # fmt: skip
        place, of = data.wrap_xpos.reshape(-1, 3), data.wrap_obj.ravel()
        for tendon, own, found in zip(robot.tendon_ids, parts, points, strict=True):
            at = data.ten_wrapadr[tendon]
            for n, (geom, _) in enumerate(own):
                if geom < 0 or of[at] == geom:  # else the tendon passes it without touching
                    found[row, n] = place[at], place[at + (geom >= 0)]
                    at += 1 + (geom >= 0)
    paths = []
    for own, found in zip(parts, points, strict=True):
        bodies = np.array([body for _, body in own])
        if bodies[0] > bodies[-1]:
            bodies, found = bodies[::-1], found[:, ::-1, ::-1]
        paths.append(_path(robot, motion, bodies, found, axis, anchor))
    return moment, force, paths


def _parts(model: mujoco.MjModel, tendon: int) -> list[tuple[int, int]]:
    """Geom, -1 of a site, and body of each of a tendon's guides and ends."""
    own = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    sites = model.wrap_type[own] == _SITE
    return [
        (-1, int(model.site_bodyid[number])) if site else (int(number), model.geom_bodyid[number])
        for site, number in zip(sites, model.wrap_objid[own], strict=True)
    ]


def _path(
    robot: Robot,
    motion: Trajectory,
    bodies: NDArray[np.int64],
    points_m: Array,
    axis: Array,
    anchor_m: Array,
) -> _Path:
    """From where a tendon comes to and leaves its guides, (R, P + 1, 2, 3), NaN of those not met.

    What a guide does not move, neither do the pieces beside it: a piece grows as points of the two
    bodies move along it, and cable passes a guide as all pieces beyond it grow.
    """
    model = robot.model
    body = np.tile(bodies, (len(points_m), 1))
    for n in reversed(range(1, len(bodies) - 1)):
        missed = np.isnan(points_m[:, n, 0, 0])
        points_m[missed, n] = points_m[missed, n + 1, :1]
        body[missed, n] = body[missed, n + 1]
    carried = np.array(
        [[_carries(model, j, b) for j in range(model.nv)] for b in range(model.nbody)]
    )
    arm = points_m[:, :, :, None] - anchor_m[:, None, None]
    turned = np.cross(axis[:, None, None], arm)
    hinge = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)[:, None]
    moved = np.where(hinge, turned, axis[:, None, None]) * carried[body][:, :, None, :, None]
    straight = points_m[:, 1:, 0] - points_m[:, :-1, 1]
    length = np.linalg.norm(straight, axis=-1, keepdims=True)
    way = straight / np.maximum(length, _LEAST_M)
    for p in range(1, way.shape[1]):
        way[:, p] = np.where(length[:, p] > _LEAST_M, way[:, p], way[:, p - 1])
    lever = np.einsum("rpx,rpjx->rpj", way, moved[:, 1:, 0] - moved[:, :-1, 1])
    beyond = np.cumsum(lever[:, :0:-1], axis=1)[:, ::-1]
    grown = np.einsum(
        "rpj,rj->rp", 0.5 * (beyond[1:] + beyond[:-1]), np.diff(motion.position, axis=0)
    )
    passed = -np.cumsum(np.vstack([np.zeros_like(grown[:1]), grown]), axis=0)
    turn = np.arccos(np.clip((way[:, 1:] * way[:, :-1]).sum(-1), -1.0, 1.0))
    return _Path(lever, turn, passed)


def _carries(model: mujoco.MjModel, joint: int, body: int) -> bool:
    """Whether a joint moves a body."""
    while body and body != model.jnt_bodyid[joint]:
        body = int(model.body_parentid[body])
    return bool(body)
