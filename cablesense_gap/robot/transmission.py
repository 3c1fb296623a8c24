"""What joints and drives lose between them: motion within play, and friction of guided tendons."""

from __future__ import annotations

import copy
import math
from functools import cached_property, partial

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_gap.robot.model import Change, Robot, inverse_dynamics
from cablesense_gap.robot.motion import Motion, Recent, Trajectory, derivatives, smoothed

_LEAST_KG_M2 = 1e-9
"""Inertia of a joint behind its drive, at least: it is divided by."""
_LEAST_PRESLIDING = 1e-4
"""Cable gives at least this share of the length that passes a guide."""
_LEAST_M = 1e-9
"""Length, lever or path that counts as zero, m."""
_RIDGE = 1e-9
"""Share of the trace added to a diagonal: tendons that pull alike leave no exact zero."""
_LEAST_SHARE = 1e-6
"""Share of the largest tension that a tendon has at least: it is divided by."""
_SITE = int(mujoco.mjtWrap.mjWRAP_SITE)


class PlayMotion:
    """Motion of joints relative to their drives, within their play: the effect `backlash`.

    It follows from motion measured at the drives, and the model. A joint lies at that end of its
    play at which the drive gives the torque that the link needs. The link moves freely to the
    other end when that torque changes its sign. `rows` are the motion's R of all ΣT rows.
    """

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """Take a robot and its motion as it was measured."""
        self._robot = robot
        self._motion = motion
        self.rows = motion.rows
        self._known = Recent()

    @cached_property
    def _free_acceleration(self) -> tuple[Array, ...]:
        """By trial, accelerations (T, J) of freely moving joints relative to their drives."""
        model = copy.copy(self._robot.model)
        inertia = np.maximum(self._motion.inertia - model.dof_armature, _LEAST_KG_M2)
        model.dof_armature[:] = 0.0
        model.dof_damping[:] = 0.0
        rate_hz = self._motion.rate_hz
        return tuple(
            -inverse_dynamics(model, path, *derivatives(path, rate_hz)) / inertia
            for path in self._motion.paths
        )

    def moved(self, play: Array) -> Array:
        """Positions, speeds and accelerations (3, ΣT, J) of joints from drives, smoothed alike."""
        motion_within_play = np.zeros((3, sum(map(len, self._motion.paths)), len(play)))
        for j in np.flatnonzero(play).tolist():
            key = j, float(play[j])
            motion_within_play[:, :, j] = self._known.of(key, partial(self._of_joint, *key))
        return motion_within_play

    def _of_joint(self, joint: int, play: float) -> Array:
        motion = self._motion
        by_trial = []
        for free in self._free_acceleration:
            place = _place_within_play(free[:, joint], 0.5 * play, 1.0 / motion.rate_hz)
            smooth = smoothed(place[:, None], motion.rate_hz, motion.smoothed_hz)
            moved = smooth, *derivatives(smooth, motion.rate_hz)
            by_trial.append(np.hstack(moved).T)
        return np.concatenate(by_trial, 1)


def _place_within_play(acceleration: Array, reach: float, interval_s: float) -> Array:
    """(T,) positions within ±`reach` of a joint that moves freely with an acceleration (T,)."""
    place = float(np.sign(acceleration[0])) * reach
    speed = 0.0
    places = []
    for free_acceleration in acceleration.tolist():
        speed += free_acceleration * interval_s
        place += speed * interval_s
        if abs(place) >= reach:
            place = reach if place > 0.0 else -reach
            speed = 0.0
        places.append(place)
    return np.array(places)


class GuidedTendons:
    """The K guided tendons of a robot along a motion, as it was measured or is asked for.

    Friction over guides is by the chain law of `cable_chain`. If commands give the tensions at
    the actuators, cables are elastic: joints stretch the piece beyond a guide until it slips. If
    tensions follow from torques alone, cables are rigid and give by Dahl's law along the length
    that passes each guide.
    """

    def __init__(self, robot: Robot, motion: Trajectory) -> None:
        """Tensions are those that the actuators make of recorded commands, where there are any."""
        self._motion = motion
        self._robot = robot
        self._shares = Recent()
        model = robot.model
        of_tendon = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
        pulls = of_tendon & (model.actuator_trnid[:, 0] == robot.tendon_ids[:, None])
        self._pulls = np.zeros((len(robot.tendons), model.nout))
        for tendon, actuator in np.argwhere(pulls):  # an actuator has one force on a tendon
            output = model.actuator_outadr[actuator]
            self._pulls[tendon, output] = -model.actuator_gear[output, 0]

    @cached_property
    def _along(self) -> tuple[Array, Array | None, list[list[Array]]]:
        """Moments (R, O, J) of forces, tensions (R, K) if known, levers and wrap angles."""
        model = self._robot.model
        motion = self._motion
        data = mujoco.MjData(model)
        rows = len(motion.position)
        moments = np.zeros((rows, model.nout, model.nv))
        force = np.empty((rows, model.nout))
        guides = {t: _guides(model, t) for t in self._robot.tendon_ids.tolist()}
        paths: dict[int, list[tuple[Array, Array]]] = {t: [] for t in guides}
        for row, command in enumerate(np.nan_to_num(motion.command)):
            data.qpos[:] = motion.position[row]
            data.qvel[:] = motion.speed[row]
            data.ctrl[:] = command
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_fwdActuation(model, data)
            force[row] = data.actuator_force
            moment = data.actuator_moment, data.moment_rownnz, data.moment_rowadr
            mujoco.mju_sparse2dense(moments[row], *moment, data.moment_colind)
            for t, tendon_guides in guides.items():
                paths[t].append(_followed(model, data, data.ten_wrapadr[t], tendon_guides))
        known = np.isfinite(motion.command).all() and not model.na
        return (
            moments,
            force @ self._pulls.T if known else None,
            [[np.array(each) for each in zip(*paths[t], strict=True)] for t in paths],
        )

    def lost(self, change: Change, torque: Array, *, at_drive: bool = False) -> Array:
        """(R, J) by how much the torques of the drives are more than what reaches the joints.

        Without recorded commands, tensions are the smallest that give `torque` (R, J), at the
        joints or `at_drive`. A tendon that pushes then represents its antagonist, which pulls.
        """
        used = np.flatnonzero(change.capstan_friction).tolist()
        moments, known_n, _ = self._along
        tension_n = self._least_n(moments, torque) if known_n is None else known_n
        lost = {k: self._lost_m(k, change, np.sign(tension_n[:, k])) for k in used}
        if known_n is None and not at_drive:
            moments_left = moments - sum(self._pulls[k][:, None] * lost[k][:, None] for k in used)
            tension_n = self._least_n(moments_left, torque)
        return np.asarray(sum(tension_n[:, k, None] * lost[k] for k in used))

    def _least_n(self, moment: Array, torque: Array) -> Array:
        """(R, K) tensions of actuators with moments (R, A, J) that give torques (R, J)."""
        square = moment.swapaxes(1, 2) @ moment
        scale = np.maximum(np.trace(square, axis1=1, axis2=2), _LEAST_M**2)[:, None, None]
        by_joint = np.linalg.solve(
            square + _RIDGE * scale * np.eye(square.shape[-1]), torque[..., None]
        )
        return np.asarray((moment @ by_joint)[..., 0] @ self._pulls.T)

    def _lost_m(self, k: int, change: Change, sign: Array) -> Array:
        """(R, J) what a tendon loses of its moment, pulling (1) or pushing (-1).

        Cable passes a guide, towards the actuator, as all pieces beyond it become shorter.
        """
        _, known_n, paths = self._along
        lever_m, turn_rad = paths[k]
        limit = change.capstan_friction[k] * turn_rad
        beyond = np.cumsum(lever_m[:, :0:-1], axis=1)[:, ::-1]
        way_m = (np.abs(beyond).max(0) * np.ptp(self._motion.position, axis=0)).sum(1)
        presliding_m = np.maximum(
            change.capstan_presliding[k], _LEAST_PRESLIDING * way_m + _LEAST_M
        )
        if known_n is None:
            kept_shares = self._left_rigid(k, sign, beyond, limit, presliding_m)
        else:
            kept_shares = self._left_elastic(
                known_n[:, k], sign, beyond, limit, presliding_m.max()
            )
        return np.einsum("rp,rpj->rj", kept_shares - 1.0, lever_m[:, 1:])

    def _left_elastic(
        self, known_n: Array, sign: Array, beyond: Array, limit: Array, presliding_m: float
    ) -> Array:
        """(R, P - 1) what elastic cable beyond each guide has of the tension at the actuator.

        It is so stiff that at its usual tension it goes from rest to slip within `presliding_m`.
        """
        from cablesense_sim.guides import pulled_over_guides_n  # slow to compile

        position = self._motion.position
        trial = self._motion.trial
        near_n = np.abs(known_n)
        near_n = np.maximum(near_n, _LEAST_SHARE * near_n.max() + _LEAST_M)
        between = 0.5 * (beyond[1:] + beyond[:-1])
        moved = np.diff(position, axis=0)
        longer = np.vstack([0.0 * limit[:1], np.einsum("rpj,rj->rp", between, moved)])
        pulled_n = limit.mean() * near_n.mean() / presliding_m * sign[:, None] * longer
        begins = (np.diff(trial, prepend=trial[0] - 1) != 0).astype(float)
        beyond_n = pulled_over_guides_n(near_n, pulled_n, np.exp(limit), begins)
        return np.asarray(beyond_n / near_n[:, None])

    def _left_rigid(
        self, k: int, sign: Array, beyond: Array, limit: Array, presliding_m: Array
    ) -> Array:
        """The same of rigid cable that slips the other way by Dahl's law."""
        from cablesense_sim.cable_chain import kept

        def shares() -> Array:
            slip_shares = np.zeros(limit.shape)
            for p in np.flatnonzero(np.abs(beyond).max((0, 2)) > _LEAST_M).tolist():
                same = p and np.allclose(beyond[:, p], beyond[:, p - 1], rtol=0.0, atol=_LEAST_M)
                slid = self._motion.slid_along
                slip_shares[:, p] = (
                    slip_shares[:, p - 1] if same else slid(-beyond[:, p], presliding_m[p])
                )
            return slip_shares

        share = self._shares.of((k, float(presliding_m.max())), shares)
        return kept(share * sign[:, None], limit)


def _guides(model: mujoco.MjModel, tendon: int) -> list[tuple[int, int]]:
    """The geom (-1 for a site) and the body of each end and guide of a tendon."""
    wraps = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    return [
        (-1, int(model.site_bodyid[number]))
        if kind == _SITE
        else (number, model.geom_bodyid[number])
        for kind, number in zip(
            model.wrap_type[wraps], model.wrap_objid[wraps].tolist(), strict=True
        )
    ]


def _followed(
    model: mujoco.MjModel, data: mujoco.MjData, point: int, guides: list[tuple[int, int]]
) -> tuple[Array, Array]:
    """Levers (P, J), m, of a tendon's straight pieces, and wrap angles (P - 1,) between them.

    They begin at its actuator, the end nearer to the base; `point` is the tendon's first one in
    the data. A piece has the number of the guide where it begins. A guide that the tendon does not
    touch has zeros.

    For example, from site 0 over geom 1 to site 2 the data have the points a at site 0, b and c
    where the tendon comes to the geom and leaves it, and d at site 2. With Jacobians J of points
    that are fixed to their bodies, e of a to b, and f of c to d, all of unit length,

        levers = [e (J_b - J_a), f (J_d - J_c)],   turns = [acos(e f)].

    If it does not touch the geom, the data have a and d alone: with g of a to d, the levers are
    [g (J_d - J_a), 0], and the turns [0].
    """
    place = data.wrap_xpos.reshape(-1, 3)
    met = data.wrap_obj.ravel()
    lever = np.zeros((len(guides) - 1, model.nv))
    turn = np.zeros(len(guides) - 1)
    last_jacobian = np.zeros((3, model.nv))
    jacobian = np.zeros((3, model.nv))
    last = 0
    way = np.zeros(3)
    for n, (geom, body) in enumerate(guides):
        if geom >= 0 and met[point] != geom:
            continue
        if n:
            mujoco.mj_jac(model, data, jacobian, None, place[point], body)
            straight = place[point] - place[point - 1]
            before = way
            way = straight / max(math.sqrt(straight @ straight), _LEAST_M)
            lever[last] = way @ (jacobian - last_jacobian)
            turn[last] = math.acos(min(max(before @ way, -1.0), 1.0))
        last = n
        point += 1 if geom < 0 else 2
        mujoco.mj_jac(model, data, last_jacobian, None, place[point - 1], body)
    towards = slice(None, None, -1 if guides[0][1] > guides[-1][1] else 1)
    return lever[towards], turn[1:][towards]
