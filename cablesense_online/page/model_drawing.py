"""What is drawn of a model of MuJoCo: the shapes of its bodies, and the paths of its tendons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_online.page.colours import Rgb
from cablesense_online.page.shown import DrawnPose, Extent, Mesh, Solid, Sphere
from cablesense_sim.machine.machine import Machine

_DRAWN_GROUPS = 3
"""Shapes of these first groups are drawn, as MuJoCo's viewer has it: others are for contacts."""
_LOOK_RGB: Rgb = (120, 128, 142)
"""Colour of a shape that has MuJoCo's own grey."""
_OWN_GREY = (0.5, 0.5, 0.5)
"""That of a shape without a colour of its own."""
_DARKER = 0.6
"""Of a model's colours, which are made for a bright ground."""
_SEEN_THROUGH = 0.55
"""Opacity of shapes: most tendons run inside of them."""
_FLOOR_GAP = 0.35
"""Between the machine and the floor, as a share of its size."""
_PULLEY = -2
"""MuJoCo's mark between two branches of a tendon."""


@dataclass(frozen=True)
class TendonPieces:
    """The straight pieces of tendons, a fixed number P of them.

    A tendon that does not touch a pulley has fewer: the pieces that are left have no length.

    Attributes:
        channel: (P,) that reads the tension, -1 where none does.
        tendon: (P,) number of the tendon in the model.
        place: (P,) number of the piece on its tendon.
    """

    channel: NDArray[np.int64]
    tendon: NDArray[np.int64]
    place: NDArray[np.int64]

    def at(self, data: mujoco.MjData) -> Array:
        """(P, 2, 3) ends of the pieces in base axes, where the model's data has the tendons."""
        points = data.wrap_xpos.reshape(-1, 3)
        marks = data.wrap_obj.reshape(-1)
        ends = np.zeros((len(self.tendon), 2, 3))
        last = np.zeros(3)
        for row, (tendon, place) in enumerate(zip(self.tendon, self.place, strict=True)):
            first = int(data.ten_wrapadr[tendon])
            count = int(data.ten_wrapnum[tendon])
            here = first + int(place)
            if place + 1 >= count:
                ends[row] = last
                continue
            is_gap = _PULLEY in (marks[here], marks[here + 1])
            last = points[here + 1]
            ends[row] = last if is_gap else points[here : here + 2]
        return ends


def tendon_pieces(machine: Machine) -> TendonPieces:
    """The pieces of the tendons that pull: one to each site, and two more around each shape."""
    model = machine.model
    read_by = {
        int(tendon): channel
        for channel, tendon in enumerate(machine.channels.tendon)
        if tendon >= 0
    }
    channels: list[int] = []
    tendons: list[int] = []
    places: list[int] = []
    for number, tendon in enumerate(machine.tendons.ids.tolist()):
        first = int(model.tendon_adr[tendon])
        kinds = model.wrap_type[first : first + int(model.tendon_num[tendon])]
        is_site = kinds == mujoco.mjtWrap.mjWRAP_SITE
        if kinds[0] == mujoco.mjtWrap.mjWRAP_JOINT:
            continue  # no path in space
        most = 2 * len(kinds) - int(is_site.sum()) - 1
        channels += [read_by.get(number, -1)] * most
        tendons += [tendon] * most
        places += range(most)
    return TendonPieces(
        np.array(channels, dtype=np.int64),
        np.array(tendons, dtype=np.int64),
        np.array(places, dtype=np.int64),
    )


def model_solids(machine: Machine) -> list[Solid]:
    """The shapes that MuJoCo's viewer draws; planes and height fields are left out."""
    model = machine.model
    most_opaque = _SEEN_THROUGH if len(machine.tendons.ids) else 1.0
    links = {int(body): number for number, body in enumerate(machine.links.bodies, start=1)}
    solids = []
    for geom in range(model.ngeom):
        shape = _shape(model, geom)
        if shape is None or int(model.geom_group[geom]) >= _DRAWN_GROUPS:
            continue
        *rgb, own_opacity = _rgba(model, geom)
        if own_opacity == 0.0:
            continue
        opacity = min(own_opacity, most_opaque)
        body = int(model.geom_bodyid[geom])
        x, y, z = model.geom_pos[geom].tolist()
        solids.append(
            Solid(
                name=f"shape_{geom}",
                body=body,
                shape=shape,
                rgb=_shown_rgb(tuple(rgb)),
                position_m=(x, y, z),
                opacity=None if opacity == 1.0 else opacity,
                link=links.get(body, 0),
            )
        )
    return solids


def _rgba(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    material = int(model.geom_matid[geom])
    colour = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    red, green, blue, opacity = (float(share) for share in colour)
    return red, green, blue, opacity


def _shown_rgb(shares: Sequence[float]) -> Rgb:
    if np.allclose(shares, _OWN_GREY):
        return _LOOK_RGB
    red, green, blue = (round(255.0 * _DARKER * share) for share in shares)
    return red, green, blue


def _shape(model: mujoco.MjModel, geom: int) -> Sphere | Mesh | None:
    """A shape about the origin of its frame, turned as it is in its body."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    size_m = model.geom_size[geom]
    match kind:
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return Sphere(float(size_m[0]))
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            solid = trimesh.creation.capsule(2.0 * size_m[1], size_m[0], [16, 16])
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            solid = trimesh.creation.cylinder(size_m[0], 2.0 * size_m[1], 32)
        case mujoco.mjtGeom.mjGEOM_BOX:
            solid = trimesh.creation.box(2.0 * size_m)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            solid = trimesh.creation.icosphere(3).apply_scale(size_m)
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _turned(model, geom, *_mesh(model, int(model.geom_dataid[geom])))
        case _:
            return None
    return _turned(model, geom, np.asarray(solid.vertices), np.asarray(solid.faces))


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[Array, NDArray[np.int64]]:
    first = int(model.mesh_vertadr[mesh])
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    first = int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[first : first + int(model.mesh_facenum[mesh])]
    return np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64)


def _turned(model: mujoco.MjModel, geom: int, vertices: Array, faces: NDArray[np.int64]) -> Mesh:
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return Mesh(vertices @ turn.reshape(3, 3).T, np.asarray(faces, dtype=np.int64))


def model_extent(solids: Sequence[Solid], drawn: DrawnPose) -> Extent:
    """The room of the shapes and tendons at a pose."""
    corners = [drawn.piece_m.reshape(-1, 3), drawn.links.origin_m]
    for solid in solids:
        local_m = _corners_m(solid) + np.array(solid.position_m)
        corners.append(drawn.body_m[solid.body] + local_m @ drawn.body_axes[solid.body].T)
    every_corner = np.vstack(corners)
    lowest = every_corner.min(axis=0)
    highest = every_corner.max(axis=0)
    size_m = float(np.linalg.norm(highest - lowest))
    floor_m = float(lowest[2]) - _FLOOR_GAP * size_m
    return Extent(0.5 * (lowest + highest), size_m, floor_m)


def _corners_m(solid: Solid) -> Array:
    if isinstance(solid.shape, Mesh):
        return solid.shape.vertices_m
    return solid.shape.radius_m * np.vstack([np.eye(3), -np.eye(3)])
