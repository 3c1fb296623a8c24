"""Forces in a machine at a pose, and where it comes to rest: MuJoCo's kinematics, our balance.

With coordinates r, tendons of lengths l(r), unstretched lengths L and stiffness k have the
tensions T = max(0, k (l - L)). The machine is at rest where the residual force

    F(r) + Σ_c J_c(r)' f_c = 0,      F(r) = weight(r) + springs(r) - (∂l/∂r)' T(r)

vanishes, f_c being forces that act on links. F is exact, by MuJoCo. Of its derivative the part of
the tendons' stiffness, -J' K J with J = ∂l/∂r, is exact too; the rest, at constant tensions, is by
differences, as only these cover paths around geoms, pulleys and joints that follow others.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.joint_motion import SUDDEN_OVER_STEADY
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import Indices, Machine

_STEP = 1e-6
"""Of a coordinate, rad or m, by which derivatives are taken: forces differ in the tenth digit."""
_REST = 1e-9
"""A machine is at rest where the step that is left is shorter, rad or m."""
_MOST_STEPS = 100
_LEAST_SHARE = 1e-6
"""Shortest part of a step that is tried before a search for rest ends."""
_LONGEST_STEP = 0.5
"""Longest step, rad or m: a machine is another one there."""
_LESS = 0.1
"""Share by which the force behind a step that goes too far must be less than the one before it,
and by which a step with an old derivative must lessen the force along it."""
_QUICKLY = 0.02
"""The derivative at constant tensions is used again if a step with it leaves less."""


class Balance(NamedTuple):
    """A machine with K tendons and n coordinates at a pose.

    Attributes:
        length_m: (K,) of the tendons.
        moment: (K, n) ∂l/∂r.
        load: (n,) generalised forces of weights and of springs in joints.
        pull: (K, n) generalised forces of unit tensions, against them: the moments, but for what
            friction makes of tensions along a tendon.
    """

    length_m: Array
    moment: Array
    load: Array
    pull: Array


class LinkFrames(NamedTuple):
    """The N links at a pose.

    Attributes:
        origin_m: (N, 3) of the links' frames, in base axes.
        axes: (N, 3, 3) of the frames, in columns.
        by_force_m: (N, 3, n) generalised forces of unit forces in base axes at the origins.
        by_moment: (N, 3, n) of unit moments.
    """

    origin_m: Array
    axes: Array
    by_force_m: Array
    by_moment: Array


@dataclass(frozen=True)
class LinkForce:
    """A force on a link, which keeps its direction in base axes while the machine gives way.

    Attributes:
        link: number of the link, from 0 on.
        point_m: (3,) where it acts, in the link's frame; on its axis at (place, 0, 0).
        force_n: (3,) in base axes.
    """

    link: int
    point_m: Array
    force_n: Array


class _Acting(NamedTuple):
    """A force (3,) in base axes at a point (3,) that is fixed to a body, in the body's frame."""

    body: int
    point_m: Array
    force_n: Array


class _State(NamedTuple):
    """A machine under forces at a pose (n,).

    Attributes:
        pose: (n,).
        tensions_n: (K,).
        moment: (K, n) ∂l/∂r.
        residual: (n,) forces that nothing balances.
    """

    pose: Array
    tensions_n: Array
    moment: Array
    residual: Array


class Rest(NamedTuple):
    """Where a machine is at rest.

    Attributes:
        pose: (n,).
        tensions_n: (K,) of its tendons.
    """

    pose: Array
    tensions_n: Array


class MachineStatics:
    """A machine, as its model or with changes of its own, at any pose.

    Attributes:
        machine: the machine.
        model: its own copy of the model.
        stiffness_n_m: (K,) of the tendons.
    """

    def __init__(
        self,
        machine: Machine,
        model: mujoco.MjModel | None = None,
        stiffness_n_m: Array | None = None,
    ) -> None:
        self.machine = machine
        self.model = machine.model if model is None else model
        tendons = machine.tendons
        self.stiffness_n_m = tendons.stiffness_n_m if stiffness_n_m is None else stiffness_n_m
        self._beside_m: Array | None = None
        self._data = mujoco.MjData(self.model)
        self._coordinates = machine.coordinates
        self._tied = bool(machine.coordinates.ties)
        # ∂q/∂r where joints follow others, at the pose that was asked for last
        self._joints_by_coordinate = np.zeros((self.model.nv, len(machine.coordinates)))
        self._columns = machine.coordinates.joints
        self._are_all_joints = np.array_equal(self._columns, np.arange(self.model.nv))
        self._tendon_ids = machine.tendons.ids
        self._moment_places = _moment_places(self.model)[machine.tendons.ids]
        # the last one stays zero: what does not move a tendon
        self._path_slopes = np.zeros(self._data.ten_J.size + 1)
        self._bias = np.zeros(self.model.nv)
        self._has_springs = bool(self.model.jnt_stiffness.any() or self.model.body_gravcomp.any())
        self._links = machine.links
        self._of_body = (np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv)))

    def at(self, pose: Array) -> Balance:
        """Lengths and forces at a pose (n,)."""
        data = self._data
        model = self.model
        data.qpos[:] = self._coordinates.positions(pose)
        if self._tied:
            self._joints_by_coordinate = self._coordinates.slope(data.qpos)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        load = -self._bias
        if self._has_springs:
            mujoco.mj_passive(model, data)
            load += data.qfrc_passive
        self._path_slopes[:-1] = data.ten_J.reshape(-1)
        moment = self._reduced(self._path_slopes[self._moment_places])
        length_m = data.ten_length[self._tendon_ids]
        return Balance(length_m, moment, self._reduced(load), self._pull(moment))

    def rubbing(self, beside_m: Array, stretch: Array) -> MachineStatics:
        """The same machine with friction, near a pose; it shares the pose that was asked for last.

        A unit tension at the actuator pulls with moments (K, n) `beside_m` those of an even one,
        and stretches its tendon by `stretch` (K,) times as much.
        """
        rubbing = copy.copy(self)
        rubbing.stiffness_n_m = self.stiffness_n_m / stretch
        rubbing._beside_m = beside_m
        return rubbing

    def tensions_n(self, lengths_m: Array, unstretched_m: Array) -> Array:
        """(K,) tensions at lengths (K,), of cables that pull and never push."""
        return np.maximum(self.stiffness_n_m * (lengths_m - unstretched_m), 0.0)

    def residual(self, pose: Array, unstretched_m: Array) -> Array:
        """(n,) F: generalised forces that nothing balances at a pose (n,)."""
        balance = self.at(pose)
        tensions = self.tensions_n(balance.length_m, unstretched_m)
        return np.asarray(balance.load - tensions @ balance.pull)

    def slope(self, pose: Array, unstretched_m: Array) -> Array:
        """(n, n) ∂F/∂r at a pose (n,): of weights, springs and paths, and -J' K J of tendons."""
        balance = self.at(pose)
        tensions_n = self.tensions_n(balance.length_m, unstretched_m)
        elastic = self.elastic_slope(balance.moment, tensions_n)
        return self.load_slope(pose, tensions_n) + elastic

    def elastic_slope(self, moment: Array, tensions_n: Array) -> Array:
        """(n, n) the part -J' K J of ∂F/∂r, of the tendons that are taut, with moments (K, n)."""
        stiffness = self.stiffness_n_m * (tensions_n > 0.0)
        return np.asarray((self._pull(moment).T * -stiffness) @ moment)

    def load_slope(self, pose: Array, tensions_n: Array) -> Array:
        """(n, n) the part of ∂F/∂r at constant tensions (K,), at a pose (n,)."""
        return self._slope_at(pose, tensions_n, ())

    def links(self) -> LinkFrames:
        """The links at the pose that was asked for last."""
        data = self._data
        links = self._links
        count = len(links.bodies)
        turns = data.xmat[links.bodies].reshape(count, 3, 3)
        origins = data.xpos[links.bodies] + np.einsum("nij,nj->ni", turns, links.origin_m)
        by_force = np.empty((count, 3, self.model.nv))
        by_moment = np.empty((count, 3, self.model.nv))
        for n, body in enumerate(links.bodies.tolist()):
            mujoco.mj_jac(self.model, data, by_force[n], by_moment[n], origins[n], body)
        return LinkFrames(
            origins, turns @ links.axes, self._reduced(by_force), self._reduced(by_moment)
        )

    def by_masses(self, bodies: Indices) -> tuple[Array, Array, Array]:
        """How weights follow from masses and their centres, at the pose asked for last.

        Returns:
            (B, n) forces by the mass of each of B bodies; (B, 3, n) by the place of its centre in
            its own axes; (3, n) by the components of gravity.
        """
        data = self._data
        gravity = self.model.opt.gravity
        at_point, turning = self._of_body
        of_mass = np.empty((len(bodies), self.model.nv))
        of_centre = np.empty((len(bodies), 3, self.model.nv))
        of_gravity = np.zeros((3, self.model.nv))
        for row, body in enumerate(bodies.tolist()):
            mujoco.mj_jac(self.model, data, at_point, turning, data.xipos[body], body)
            mass = float(self.model.body_mass[body])
            of_mass[row] = gravity @ at_point
            # a centre that moves by R d adds the moment (R d) x m g
            axes = data.xmat[body].reshape(3, 3)
            moments = np.cross(axes.T, mass * gravity)
            of_centre[row] = moments @ turning
            of_gravity += mass * at_point
        return self._reduced(of_mass), self._reduced(of_centre), self._reduced(of_gravity)

    def unrest(self, speed: Array, acceleration: Array) -> Array:
        """(n, n) covariance of torques of inertia and damping at the pose asked for last.

        `speed` and `acceleration` (n,) are those of a motion that swings the machine: an undamped
        one by twice what a steady acceleration bends it.
        """
        data = self._data
        model = self.model
        mujoco.mj_crb(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        by_coordinate = self._coordinates.slope(data.qpos)
        of_inertia = by_coordinate.T @ inertia @ by_coordinate
        swing = SUDDEN_OVER_STEADY * of_inertia * acceleration
        damping = (by_coordinate.T * model.dof_damping) @ by_coordinate @ speed
        return np.asarray(swing @ swing.T + np.diag(damping**2))

    def rest(
        self,
        unstretched_m: Array,
        forces: Sequence[LinkForce],
        start: Array,
        load_slope: Array | None = None,
    ) -> Rest:
        """Where the machine comes to rest under forces, from a pose (n,) on.

        Newton's steps r - H⁻¹ F, shortened until the potential energy falls, which is least at
        rest, and of which F is the steepest descent. The force along a step may grow: where H is
        not definite, the machine is on its way from another rest. The part of H at constant
        tensions is used again as long as it leads on quickly; `load_slope` (n, n) is what it is
        near the start, where that is known.

        Raises:
            MachineError: it finds no rest: the forces are larger than it can bear, or nothing
                holds one of its joints.
        """
        acting = [self._acting(force) for force in forces]
        here = self._state(start.copy(), unstretched_m, acting)
        is_fresh = load_slope is None
        constant = load_slope
        if constant is None:
            constant = self._slope_at(here.pose, here.tensions_n, acting)
        for _ in range(_MOST_STEPS):
            step = self._compliance(here, constant) @ here.residual
            length = float(np.abs(step).max())
            if length < _REST:
                return Rest(here.pose, here.tensions_n)
            downhill = float(step @ here.residual)
            share = min(1.0, _LONGEST_STEP / length)
            there = self._state(here.pose + share * step, unstretched_m, acting)
            # the energy falls by about the mean of the forces along the step at both its ends
            while is_fresh and float(step @ there.residual) < -(1.0 - _LESS) * downhill:
                share *= 0.5
                if share < _LEAST_SHARE:
                    raise self._no_rest()
                there = self._state(here.pose + share * step, unstretched_m, acting)
            left = abs(float(step @ there.residual)) / downhill
            if is_fresh or left < 1.0 - _LESS:
                here = there
            is_fresh = left > _QUICKLY
            if is_fresh:
                constant = self._slope_at(here.pose, here.tensions_n, acting)
        raise self._no_rest()

    def _pull(self, moment: Array) -> Array:
        return moment if self._beside_m is None else moment + self._beside_m

    def _no_rest(self) -> MachineError:
        return MachineError(
            f"{self.machine.name}: finds no rest; a force may be larger than the tendons can "
            "bear, or nothing holds one of its joints"
        )

    def _compliance(self, here: _State, constant: Array) -> Array:
        """(n, n) -H⁻¹ at a pose: how the machine gives way; stiffened where it would give all."""
        stiffness = -self.elastic_slope(here.moment, here.tensions_n) - constant
        scale = float(np.abs(np.diagonal(stiffness)).max())
        if not scale > 0.0:
            raise self._no_rest()
        symmetric = 0.5 * (stiffness + stiffness.T)
        identity = np.eye(len(here.pose))
        added = 0.0
        while True:
            try:
                np.linalg.cholesky(symmetric + added * identity)
                break
            except np.linalg.LinAlgError:
                added = max(10.0 * added, 1e-6 * scale)
        return np.asarray(np.linalg.inv(stiffness + added * identity))

    def _slope_at(self, pose: Array, tensions_n: Array, acting: Sequence[_Acting]) -> Array:
        """(n, n) ∂/∂r of F and of what acts, at a pose (n,) and constant tensions (K,)."""
        count = len(pose)
        along = np.empty((count + 1, count))
        for j in range(count + 1):
            moved = pose.copy()
            if j < count:
                moved[j] += _STEP
            balance = self.at(moved)
            along[j] = balance.load - tensions_n @ balance.moment + self._contacts(acting)
        return (along[:count] - along[count]).T / _STEP

    def _state(self, pose: Array, unstretched_m: Array, acting: Sequence[_Acting]) -> _State:
        balance = self.at(pose)
        tensions_n = self.tensions_n(balance.length_m, unstretched_m)
        residual = balance.load - tensions_n @ balance.pull + self._contacts(acting)
        return _State(pose, tensions_n, balance.moment, residual)

    def _acting(self, force: LinkForce) -> _Acting:
        links = self._links
        n = force.link
        point_m = links.origin_m[n] + links.axes[n] @ force.point_m
        return _Acting(int(links.bodies[n]), point_m, force.force_n)

    def _contacts(self, acting: Sequence[_Acting]) -> Array | float:
        """(n,) generalised forces of what acts on links, at the pose that was asked for last."""
        if not acting:
            return 0.0
        data = self._data
        at_point, _ = self._of_body
        total = np.zeros(self.model.nv)
        for force in acting:
            place = data.xpos[force.body] + data.xmat[force.body].reshape(3, 3) @ force.point_m
            mujoco.mj_jac(self.model, data, at_point, None, place, force.body)
            total += force.force_n @ at_point
        return self._reduced(total)

    def _reduced(self, generalised: Array) -> Array:
        """Forces (..., nv) on all joints as forces (..., n) of the coordinates."""
        if self._tied:
            return np.asarray(generalised @ self._joints_by_coordinate)
        if self._are_all_joints:
            return generalised
        return np.asarray(generalised[..., self._columns])


def force_on(frames: LinkFrames, force: LinkForce) -> Array:
    """(n,) generalised forces of a force on a link."""
    n = force.link
    arm_m = frames.axes[n] @ force.point_m
    moment = np.cross(arm_m, force.force_n)
    return np.asarray(force.force_n @ frames.by_force_m[n] + moment @ frames.by_moment[n])


def _moment_places(model: mujoco.MjModel) -> NDArray[np.int64]:
    """(ntendon, nv) where each ∂l/∂q stands among MuJoCo's sparse ones, and last what is zero."""
    sparse = model.ten_J_colind.reshape(-1)
    places = np.full((model.ntendon, model.nv), len(sparse), dtype=np.int64)
    for t in range(model.ntendon):
        first = int(model.ten_J_rowadr[t])
        cells = np.arange(first, first + int(model.ten_J_rownnz[t]))
        places[t, sparse[cells]] = cells
    return places
