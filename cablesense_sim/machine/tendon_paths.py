"""The way of tendons from piece to piece: how long each is, what it moves, and how far it turns.

A tendon goes from element to element, sites and geoms, from its actuator on, which is at its first
site. Between two elements is a straight piece, and at each element but the first and the last the
tendon bends. Around a geom the bend is the angle of wrap, and the arc belongs to the pieces before
and behind it: up to a mark on the geom, which turns with it, so that the length of a piece changes
by just what it moves.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.machine.machine import Machine

_SITE = int(mujoco.mjtWrap.mjWRAP_SITE)
_PULLEY = int(mujoco.mjtWrap.mjWRAP_PULLEY)
_CYLINDER = int(mujoco.mjtWrap.mjWRAP_CYLINDER)
_GEOMS = (_CYLINDER, int(mujoco.mjtWrap.mjWRAP_SPHERE))
_FIXED = int(mujoco.mjtWrap.mjWRAP_JOINT)
_NOTHING_M = 1e-12
"""Shorter pieces have no direction."""
_NO_PLANE_M2 = 1e-12
"""Twice the area of a triangle: a smaller one has no plane."""
_NOTHING_RAD = 1e-9
"""By less a tendon does not turn around a geom."""


class PathsAtPose(NamedTuple):
    """K tendons of up to S pieces at a pose; zero beyond the end of a tendon.

    Attributes:
        length_m: (K, S) of the pieces; they add up to the lengths of the tendons.
        slope_m: (K, S, n) ∂length/∂r.
        bend_rad: (K, S - 1) by which a tendon turns between a piece and the next.
    """

    length_m: Array
    slope_m: Array
    bend_rad: Array


class _Geom(NamedTuple):
    """A geom that a tendon may wrap.

    Attributes:
        tendon, element: places in the arrays.
        geom: its number.
        is_cylinder: or a sphere.
    """

    tendon: int
    element: int
    geom: int
    is_cylinder: bool


class TendonPaths:
    """The paths of the K tendons of a machine, as its model or another one of the same structure.

    Attributes:
        is_piece: (K, S) whether there is a piece, that is up to the end of a tendon, and not where
            a pulley divides it.
        crosses: (K, S) whether a piece is between two bodies that move by themselves.
    """

    def __init__(self, machine: Machine, model: mujoco.MjModel | None = None) -> None:
        self._model = machine.model if model is None else model
        self._data = mujoco.MjData(self._model)
        self._coordinates = machine.coordinates
        self._ids = machine.tendons.ids.tolist()
        elements = [_elements(self._model, t) for t in self._ids]
        # a tendon that one joint alone defines has one element, and still one piece
        most = max((2, *(len(one) for one in elements)))
        shape = (len(elements), most)
        self._sites = np.full(shape, -1, dtype=np.int64)
        self._bodies = np.zeros(shape, dtype=np.int64)
        self._divisor = np.ones((shape[0], most - 1))
        self.is_piece = np.zeros((shape[0], most - 1), dtype=bool)
        self._fixed: list[int] = []
        self._geoms: list[_Geom] = []
        for row, path in enumerate(elements):
            self._take(row, path)
        body_of_motion = self._model.body_weldid[self._bodies]
        self.crosses = (body_of_motion[:, 1:] != body_of_motion[:, :-1]) & self.is_piece
        self._marks = self._marks_at(machine.reference)

    def at(self, pose: Array) -> PathsAtPose:
        """The paths at a pose (n,)."""
        slope = self._pose(pose)
        before, behind = self._points()
        arcs_m, turns_rad = self._around(before, behind)
        chord = before[:, 1:] - behind[:, :-1]
        straight_m = np.linalg.norm(chord, axis=-1) * self.is_piece
        has_direction = straight_m > _NOTHING_M
        along = chord / np.where(has_direction, straight_m, 1.0)[..., None]
        along *= has_direction[..., None]

        # direction · (J_end - J_start), with J of a point fixed to its body
        at_start = self._swept(behind[:, :-1], self._bodies[:, :-1], along)
        at_end = self._swept(before[:, 1:], self._bodies[:, 1:], along)
        scale = 1.0 / self._divisor
        length_m = (straight_m + arcs_m) * scale
        by_pose = ((at_end - at_start) * scale[..., None]) @ slope
        for row in self._fixed:
            tendon = self._ids[row]
            moment = np.zeros((1, self._model.nv))
            first = int(self._model.ten_J_rowadr[tendon])
            count = int(self._model.ten_J_rownnz[tendon])
            columns = self._model.ten_J_colind.reshape(-1)[first : first + count]
            moment[0, columns] = self._data.ten_J.reshape(-1)[first : first + count]
            length_m[row, 0] = self._data.ten_length[tendon]
            by_pose[row, 0] = (moment @ slope)[0]
        bend_rad = np.where(turns_rad > 0.0, turns_rad, _bends(along, self.is_piece))
        return PathsAtPose(length_m, by_pose, bend_rad)

    def _take(self, row: int, path: list[tuple[int, int, float]]) -> None:
        """The elements of a tendon: kind, object and parameter."""
        model = self._model
        divisor = 1.0
        for place, (kind, number, parameter) in enumerate(path):
            if kind == _FIXED:
                self._fixed.append(row)
                self.is_piece[row, 0] = True
                # a piece that moves a joint is between two bodies
                self._bodies[row, 1] = model.jnt_bodyid[number]
                return
            if kind == _SITE:
                self._sites[row, place] = number
                self._bodies[row, place] = model.site_bodyid[number]
            elif kind in _GEOMS:
                self._bodies[row, place] = model.geom_bodyid[number]
                self._geoms.append(_Geom(row, place, number, kind == _CYLINDER))
            elif kind == _PULLEY:
                divisor = parameter
            if place + 1 < len(path):
                self._divisor[row, place] = divisor
                self.is_piece[row, place] = _PULLEY not in (kind, path[place + 1][0])

    def _pose(self, pose: Array) -> Array:
        """(nv, n) slope of all joints at a pose, which the data has from then on."""
        data = self._data
        qpos = self._coordinates.positions(pose)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_tendon(self._model, data)
        return self._coordinates.slope(qpos)

    def _points(self) -> tuple[Array, Array]:
        """Points (K, E, 3) where tendons come to elements, and where they leave them.

        A geom that is not touched has the point of the straight way that is nearest to it, where
        the tendon comes to touch it.
        """
        # a tendon that joints alone define has no sites, and its points are not used
        sites = self._data.site_xpos if self._model.nsite else np.zeros((1, 3))
        before = sites[self._sites]
        behind = before.copy()
        wrapped = self._wrapped()
        for one in self._geoms:
            geom_index = (one.tendon, one.element)
            if geom_index in wrapped:
                before[geom_index], behind[geom_index] = wrapped[geom_index]
                continue
            last = behind[one.tendon, one.element - 1]
            following = before[one.tendon, one.element + 1]
            nearest = self._nearest(one, last, following)
            before[geom_index] = nearest
            behind[geom_index] = nearest
        return before, behind

    def _nearest(self, one: _Geom, start: Array, end: Array) -> Array:
        """The point between two others that is nearest to the middle, or the axis, of a geom."""
        way = end - start
        off = self._data.geom_xpos[one.geom] - start
        if one.is_cylinder:
            axis = self._data.geom_xmat[one.geom].reshape(3, 3)[:, 2]
            way = way - (way @ axis) * axis
        share = float(off @ way) / max(float(way @ way), _NOTHING_M**2)
        return np.asarray(start + min(max(share, 0.0), 1.0) * (end - start))

    def _wrapped(self) -> dict[tuple[int, int], tuple[Array, Array]]:
        """Where tendons begin and end to touch geoms, by tendon and element."""
        data = self._data
        points = data.wrap_xpos.reshape(-1, 3)
        objects = data.wrap_obj.reshape(-1)
        touched: dict[tuple[int, int], tuple[Array, Array]] = {}
        by_tendon: dict[int, list[_Geom]] = {}
        for one in self._geoms:
            by_tendon.setdefault(one.tendon, []).append(one)
        for row, geoms in by_tendon.items():
            first = int(data.ten_wrapadr[self._ids[row]])
            place = first
            end = first + int(data.ten_wrapnum[self._ids[row]])
            sites_passed = 0
            for one in geoms:
                # a geom that is touched stands between the sites that are next to it
                sites_before = int((self._sites[row, : one.element] >= 0).sum())
                while sites_passed < sites_before:
                    sites_passed += int(objects[place] == -1)
                    place += 1
                if place < end and objects[place] == one.geom:
                    touched[row, one.element] = points[place].copy(), points[place + 1].copy()
        return touched

    def _around(self, before: Array, behind: Array) -> tuple[Array, Array]:
        """Arcs (K, S) that pieces have on geoms next to them, and turns (K, S - 1) there.

        The arc before a geom's mark is that of the piece before. Where a tendon does not touch a
        geom, what one of its pieces has up to the mark the other has less.

        For example, a tendon touches a roller of 10 mm for 1.6 rad, an arc of 16 mm. With the mark
        half way, each of the two pieces has 8 mm of it. As the roller turns by 0.1 rad with the
        tendon, the mark goes on by 1 mm: the piece before has 9 mm, the one behind 7 mm, and no
        cable has slid over the roller.
        """
        arcs_m = np.zeros((before.shape[0], before.shape[1] - 1))
        turns_rad = np.zeros((before.shape[0], before.shape[1] - 2))
        for one, mark in zip(self._geoms, self._marks, strict=True):
            geom_index = (one.tendon, one.element)
            arrival = before[geom_index]
            departure = behind[geom_index]
            chord = arrival - behind[one.tendon, one.element - 1]
            arc = _arc_of(self._model, self._data, one, arrival, chord)
            if arc is None:
                continue
            turn = self._data.geom_xmat[one.geom].reshape(3, 3)
            until_rad = arc.angle_rad(arrival, arc.middle + turn @ mark)
            whole_rad = arc.angle_rad(arrival, departure)
            if abs(whole_rad) > _NOTHING_RAD:
                whole_rad %= 2.0 * np.pi
            around_m = arc.radius_m * whole_rad
            along_m = float((departure - arrival) @ arc.axis) if one.is_cylinder else 0.0
            length_m = float(np.hypot(around_m, along_m))
            until_m = arc.radius_m * until_rad
            if around_m > 0.0:
                until_m *= length_m / around_m
                # a helix turns by its angle around the axis times the cosine of its slope
                turns_rad[one.tendon, one.element - 1] = around_m * whole_rad / length_m
            arcs_m[one.tendon, one.element - 1] += until_m
            arcs_m[one.tendon, one.element] += length_m - until_m
        return arcs_m, turns_rad

    def _marks_at(self, reference: Array) -> Array:
        """(G, 3) half way along each arc in the reference pose, in the frames of the geoms."""
        self._pose(reference)
        before, behind = self._points()
        marks = np.zeros((len(self._geoms), 3))
        for row, one in enumerate(self._geoms):
            geom_index = (one.tendon, one.element)
            turn = self._data.geom_xmat[one.geom].reshape(3, 3)
            halfway = 0.5 * (before[geom_index] + behind[geom_index])
            marks[row] = turn.T @ (halfway - self._data.geom_xpos[one.geom])
        return marks

    def _swept(self, points: Array, bodies: NDArray[np.int64], along: Array) -> Array:
        """(K, S, nv) velocities of points of bodies along directions, by all joints."""
        model = self._model
        by_force = np.zeros((model.nbody, 3, model.nv))
        by_moment = np.zeros((model.nbody, 3, model.nv))
        for body in np.unique(bodies).tolist():
            mujoco.mj_jacBody(model, self._data, by_force[body], by_moment[body], body)
        arm_m = points - self._data.xpos[bodies]
        moment = np.cross(arm_m, along)
        swept = along[:, :, None] @ by_force[bodies] + moment[:, :, None] @ by_moment[bodies]
        return np.asarray(swept[:, :, 0])


class _Arc(NamedTuple):
    """A cable on a round geom.

    Attributes:
        middle: (3,) of the geom.
        axis: (3,) about which it goes, positively.
        radius_m: of the geom.
    """

    middle: Array
    axis: Array
    radius_m: float

    def angle_rad(self, start: Array, end: Array) -> float:
        """From one point to another about the axis, between -π and π."""
        first = start - self.middle
        second = end - self.middle
        first = first - (first @ self.axis) * self.axis
        second = second - (second @ self.axis) * self.axis
        return float(np.arctan2(np.cross(first, second) @ self.axis, first @ second))


def _arc_of(
    model: mujoco.MjModel, data: mujoco.MjData, one: _Geom, arrival: Array, chord: Array
) -> _Arc | None:
    """The arc of a tendon that reaches a geom at a point by a straight chord, m, both (3,).

    None where it comes straight at the middle.
    """
    middle = data.geom_xpos[one.geom].copy()
    normal_m2 = np.cross(arrival - middle, chord)
    twice_area_m2 = float(np.linalg.norm(normal_m2))
    if twice_area_m2 < _NO_PLANE_M2:
        return None
    if one.is_cylinder:
        axis = data.geom_xmat[one.geom].reshape(3, 3)[:, 2]
        axis = axis * (1.0 if normal_m2 @ axis > 0.0 else -1.0)
    else:
        axis = normal_m2 / twice_area_m2
    return _Arc(middle, axis, float(model.geom_size[one.geom, 0]))


def _elements(model: mujoco.MjModel, tendon: int) -> list[tuple[int, int, float]]:
    """Kinds, objects and parameters of the elements of a tendon."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    return [
        (int(model.wrap_type[w]), int(model.wrap_objid[w]), float(model.wrap_prm[w]))
        for w in wraps
    ]


def _bends(along: Array, is_piece: NDArray[np.bool_]) -> Array:
    """(K, S - 1) angles between one direction (K, S, 3) and the next.

    A piece without one has that of the piece before.
    """
    directions = along.copy()
    for piece in range(1, directions.shape[1]):
        lacks = is_piece[:, piece] & ~directions[:, piece].any(axis=-1)
        directions[lacks, piece] = directions[lacks, piece - 1]
    apart = np.linalg.norm(directions[:, 1:] - directions[:, :-1], axis=-1)
    exist = directions[:, 1:].any(axis=-1) & directions[:, :-1].any(axis=-1)
    return np.where(exist, 2.0 * np.arcsin(np.clip(0.5 * apart, 0.0, 1.0)), 0.0)
