"""Tendons over guides: what friction takes of their pull, by the chain law of `cable_chain`.

Where tensions at the actuators are known, from commands, cables are elastic: what lies beyond a
guide is stretched by the joints until it slips. From torques alone, where tensions are those that
the joints need, they are rigid, and give by Dahl's law along the way that passes each guide.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_robot.model import Change, Robot
from cablesense_robot.motion import Trajectory

_LEAST_GIVE = 1e-4
"""Of the way that passes a guide: how far cable gives at least."""
_LEAST_M, _RIDGE, _LEAST_SHARE = 1e-9, 1e-9, 1e-6
_CACHED = 48
_SITE = int(mujoco.mjtWrap.mjWRAP_SITE)


class GuidedTendons:
    """The K guided tendons of a robot along a motion, as it was measured or is asked for."""

    def __init__(self, robot: Robot, motion: Trajectory) -> None:
        """Tensions are those that the actuators make of recorded commands, where there are any."""
        model, data, rows = robot.model, mujoco.MjData(robot.model), len(motion.position)
        self._motion, self._shares = motion, dict[tuple[int, float], Array]()
        of_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        pulls = of_tendon & (model.actuator_trnid[:, 0] == robot.tendon_ids[:, None])
        self._pulls = np.where(pulls, -model.actuator_gear[:, 0], 0.0)
        self._moment, force = np.zeros((rows, model.nu, model.nv)), np.empty((rows, model.nu))
        guides = {t: _guides(model, t) for t in robot.tendon_ids.tolist()}
        paths: dict[int, list[tuple[Array, Array]]] = {t: [] for t in guides}
        for row, command in enumerate(np.nan_to_num(motion.command)):
            data.qpos[:], data.qvel[:] = motion.position[row], motion.speed[row]
            data.ctrl[:] = command
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            force[row] = data.actuator_force
            moment = data.actuator_moment, data.moment_rownnz, data.moment_rowadr
            mujoco.mju_sparse2dense(self._moment[row], *moment, data.moment_colind)
            for t, own in guides.items():
                paths[t].append(_followed(model, data, data.ten_wrapadr[t], own))
        self._paths = [[np.array(each) for each in zip(*paths[t], strict=True)] for t in paths]
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
            left = self._moment - sum(self._pulls[k][:, None] * lost[k][:, None] for k in used)
            tension_n = self._least_n(left, torque)
        return np.asarray(sum(tension_n[:, k, None] * lost[k] for k in used))

    def _least_n(self, moment: Array, torque: Array) -> Array:
        """(R, K) tensions of actuators with moments (R, A, J) that give torques (R, J)."""
        square = moment.swapaxes(1, 2) @ moment
        own = np.maximum(np.trace(square, axis1=1, axis2=2), _LEAST_M**2)[:, None, None]
        by_joint = np.linalg.solve(
            square + _RIDGE * own * np.eye(square.shape[-1]), torque[..., None]
        )
        return np.asarray((moment @ by_joint)[..., 0] @ self._pulls.T)

    def _lost_m(self, k: int, change: Change, sign: Array) -> Array:
        """(R, J) what a tendon loses of its moment, pulling (1) or pushing (-1)."""
        from cablesense_sim.cable_chain import kept  # compiled: none without friction waits

        lever_m, turn_rad = self._paths[k]
        limit = change.capstan_friction[k] * turn_rad
        give_m = float(change.capstan_presliding[k])
        if self._tension_n is not None:
            left = self._left(np.abs(self._tension_n[:, k]), sign, lever_m, limit, give_m) - 1.0
            return np.einsum("rp,rpj->rj", left, lever_m[:, 1:])
        if (k, give_m) not in self._shares:
            if len(self._shares) >= _CACHED:
                self._shares.pop(next(iter(self._shares)))
            self._shares[k, give_m] = self._slid(lever_m, give_m)
        share = self._shares[k, give_m] * sign[:, None]
        left = kept(share, limit) - 1.0
        return np.einsum("rp,rpj->rj", left, lever_m[:, 1:])

    def _left(
        self, near_n: Array, sign: Array, lever_m: Array, limit: Array, give_m: float
    ) -> Array:
        """(R, P - 1) what elastic cable beyond each guide has of the tension at the actuator.

        It is so stiff that at its usual tension it goes from rest to slip within `give_m`.
        """
        from cablesense_sim.cable_law import drawn

        position, trial = self._motion.position, self._motion.trial
        beyond = np.cumsum(lever_m[:, :0:-1], axis=1)[:, ::-1]
        between, moved = 0.5 * (beyond[1:] + beyond[:-1]), np.diff(position, axis=0)
        longer = np.vstack([0.0 * limit[:1], np.einsum("rpj,rj->rp", between, moved)])
        way_m = np.abs(longer).sum(0).max()
        give_m = max(give_m, _LEAST_GIVE * way_m + _LEAST_M)
        near_n = np.maximum(near_n, _LEAST_SHARE * near_n.max() + _LEAST_M)
        stiffness_n_m = limit.mean() * near_n.mean() / give_m
        begins = np.diff(trial, prepend=trial[0] - 1) != 0
        pulled_n = stiffness_n_m * sign[:, None] * longer
        held = drawn(near_n, pulled_n, np.exp(limit), begins.astype(float))
        return np.asarray(held / near_n[:, None])

    def _slid(self, lever_m: Array, give_m: float) -> Array:
        """(R, P - 1) share of its limit that each guide carries.

        Cable passes a guide, towards the actuator, as all pieces beyond it become shorter.
        """
        beyond = np.cumsum(lever_m[:, :0:-1], axis=1)[:, ::-1]
        way_m = (np.abs(beyond).max(0) * np.ptp(self._motion.position, axis=0)).sum(1)
        gives = np.maximum(give_m, _LEAST_GIVE * way_m + _LEAST_M).tolist()
        found = np.zeros(beyond.shape[:2])
        for p in np.flatnonzero(way_m > _LEAST_M).tolist():
            same = p > 0 and np.allclose(beyond[:, p], beyond[:, p - 1], rtol=0.0, atol=_LEAST_M)
            own = found[:, p - 1] if same else self._motion.slid_along(-beyond[:, p], gives[p])
            found[:, p] = own
        return found


def _guides(model: mujoco.MjModel, tendon: int) -> list[tuple[int, int]]:
    """Of a tendon's ends and guides the geom, -1 of a site, and the body."""
    own = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    return [
        (-1, int(model.site_bodyid[number]))
        if kind == _SITE
        else (number, model.geom_bodyid[number])
        for kind, number in zip(model.wrap_type[own], model.wrap_objid[own].tolist(), strict=True)
    ]


def _followed(
    model: mujoco.MjModel, data: mujoco.MjData, at: int, guides: list[tuple[int, int]]
) -> tuple[Array, Array]:
    """Levers (P, J), m, of a tendon's straight pieces, and wrap angles (P - 1,) between them.

    From its actuator on, the end nearer to the base; `at` is the first of its points in the data.
    A piece has the number of the guide that it comes from; one that the tendon passes without
    touching has neither.
    """
    place, met = data.wrap_xpos.reshape(-1, 3), data.wrap_obj.ravel()
    lever, turn = np.zeros((len(guides) - 1, model.nv)), np.zeros(len(guides) - 1)
    here, there = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    last, way = 0, np.zeros(3)
    for n, (geom, body) in enumerate(guides):
        if geom >= 0 and met[at] != geom:
            continue
        if n:
            mujoco.mj_jac(model, data, there, None, place[at], body)
            straight = place[at] - place[at - 1]
            before, way = way, straight / max(math.sqrt(straight @ straight), _LEAST_M)
            lever[last] = way @ (there - here)
            turn[last] = math.acos(min(max(before @ way, -1.0), 1.0))
        last, at = n, at + (1 if geom < 0 else 2)
        mujoco.mj_jac(model, data, here, None, place[at - 1], body)
    towards = slice(None, None, -1 if guides[0][1] > guides[-1][1] else 1)
    return lever[towards], turn[1:][towards]
