"""The scene of the page as a still picture, by MuJoCo's renderer.

The renderer draws without a window where EGL or OSMesa is installed; `MUJOCO_GL` chooses between
them, before MuJoCo is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import Contact
from cablesense_online.page.arrows import CLEARANCE, ArrowScale, arrow_m
from cablesense_online.page.colours import ESTIMATE_RGB, TRUE_RGB, Rgb, full_scale_n, piece_rgb
from cablesense_online.page.marks import (
    BAND_OPACITY,
    BAND_SHARE,
    CABLE_WIDTH,
    FORCE_OUTLINE_WIDTH,
    interval_outline_m,
    place_band,
)
from cablesense_online.page.shown import Cylinder, DrawnPose, Mesh, ShownMachine, Solid, Sphere
from cablesense_online.page.snapshot import Snapshot

_ARROW_RADIUS = 0.013
"""Of an arrow's shaft, as a share of the machine's size."""
_ARROW_STRETCH = 2.0
"""MuJoCo draws an arrow half as long as what it connects."""
_VIEW_ANGLE_DEG = 35.0
_DISTANCE = 1.4
"""From the camera to the machine's middle, in sizes of the machine."""
_LOOK_ABOVE = 0.1
"""Above the machine's middle the camera looks, where arrows and text are."""
_AZIMUTH_DEG = 102.0
_ELEVATION_DEG = -24.0
_OVERSAMPLING = 2
"""Pixels of the renderer in one of the picture, along each side."""
_MOST_PIECES = 4000
"""Drawn in addition to the machine: arrows, outlines, cables."""
_SKY_RGB: Rgb = (62, 70, 86)
"""Colour of the background above, as the following one below."""
_GROUND_RGB: Rgb = (24, 27, 33)
_SKY_PX = 64
"""Size of the background's texture."""


class PictureError(CableSenseError):
    """A picture that cannot be drawn: names the fault and the remedy."""


class _Pose(NamedTuple):
    """A machine as it is drawn, with the axes (N, 3, 3) in which contacts are stated."""

    drawn: DrawnPose
    frame_axes: Array


def still_picture(
    shown: ShownMachine, snapshot: Snapshot, width_px: int, height_px: int
) -> NDArray[np.uint8]:
    """(height, width, 3) the machine with true and estimated force, and the stated interval.

    Raises:
        PictureError: there is no way to draw without a window.
    """
    model = _model(shown)
    data = mujoco.MjData(model)
    drawn = shown.drawn_at(snapshot.pose)
    turns = Rotation.from_matrix(drawn.body_axes).as_quat(scalar_first=True)
    data.mocap_pos[:] = drawn.body_m
    data.mocap_quat[:] = turns
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    height = _OVERSAMPLING * height_px
    width = _OVERSAMPLING * width_px
    model.vis.global_.offheight = height
    model.vis.global_.offwidth = width
    model.vis.global_.fovy = _VIEW_ANGLE_DEG
    try:
        renderer = mujoco.Renderer(model, height, width, max_geom=_MOST_PIECES)
    except Exception as error:  # of EGL, OSMesa and GLFW, each its own
        raise PictureError(
            f"there is no way to draw without a window ({error}); install EGL or OSMesa "
            "(apt-get install libegl1 libgl1-mesa-dri), or set MUJOCO_GL to one that is there"
        ) from error
    with renderer:
        renderer.update_scene(data, _camera(shown))
        _add_all(renderer.scene, shown, snapshot, _Pose(drawn, _frame_axes(shown, snapshot)))
        pixels = renderer.render().astype(float)
    shape = (height_px, _OVERSAMPLING, width_px, _OVERSAMPLING, 3)
    return np.rint(pixels.reshape(shape).mean(axis=(1, 3))).astype(np.uint8)


def _frame_axes(shown: ShownMachine, snapshot: Snapshot) -> Array:
    return shown.links_at(snapshot.frame_pose).axes


def _camera(shown: ShownMachine) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultCamera(camera)
    camera.lookat[:] = shown.extent.look_at_m
    camera.lookat[2] += _LOOK_ABOVE * shown.extent.size_m
    camera.distance = _DISTANCE * shown.extent.size_m
    camera.azimuth = _AZIMUTH_DEG
    camera.elevation = _ELEVATION_DEG
    return camera


def _model(shown: ShownMachine) -> mujoco.MjModel:
    """A model without physics: each drawn body is one that is put where it is to be."""
    spec = mujoco.MjSpec()
    spec.visual.headlight.ambient[:] = 0.55
    spec.visual.headlight.diffuse[:] = 0.75
    spec.visual.headlight.specular[:] = 0.15
    spec.add_texture(
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_rgba(_SKY_RGB, 1.0)[:3],
        rgb2=_rgba(_GROUND_RGB, 1.0)[:3],
        width=_SKY_PX,
        height=_SKY_PX,
    )
    extent = shown.extent
    spec.stat.extent = extent.size_m
    spec.stat.center[:] = extent.look_at_m
    bodies = [spec.worldbody.add_body(mocap=True) for _ in shown.bodies]
    for number, solid in enumerate(shown.solids):
        _add_solid(spec, bodies[solid.body], solid, f"mesh_{number}")
    return spec.compile()


def _add_solid(spec: mujoco.MjSpec, body: mujoco.MjsBody, solid: Solid, mesh_name: str) -> None:
    look = {
        "rgba": _rgba(solid.rgb, 1.0 if solid.opacity is None else solid.opacity),
        "contype": 0,
        "conaffinity": 0,
    }
    position = np.array(solid.position_m)
    match solid.shape:
        case Sphere(radius_m):
            sphere = mujoco.mjtGeom.mjGEOM_SPHERE
            body.add_geom(type=sphere, size=[radius_m, 0.0, 0.0], pos=position, **look)
        case Cylinder(radius_m, length_m):
            half = np.array([0.5 * length_m, 0.0, 0.0])
            ends = [*(position - half), *(position + half)]
            cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
            body.add_geom(type=cylinder, fromto=ends, size=[radius_m, 0.0, 0.0], **look)
        case Mesh(vertices_m, faces):
            mesh = spec.add_mesh(name=mesh_name)
            mesh.uservert = vertices_m.ravel().tolist()
            mesh.userface = faces.ravel().tolist()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            kind = mujoco.mjtGeom.mjGEOM_MESH
            body.add_geom(type=kind, meshname=mesh_name, pos=position, **look)


def _add_all(scene: mujoco.MjvScene, shown: ShownMachine, snapshot: Snapshot, pose: _Pose) -> None:
    """Cables, the band of the place, both arrows, and the outline of the interval."""
    size_m = shown.extent.size_m
    scale = ArrowScale(size_m, shown.strongest_n)
    _add_cables(scene, shown, snapshot, pose.drawn)
    links = pose.drawn.links
    for part in snapshot.region:
        n = part.segment - 1
        band = place_band(part, size_m)
        half_m = 0.5 * band.length_m
        along = links.axes[n, :, 0]
        centre = links.origin_m[n] + band.middle_m * along
        ends = np.stack([centre - half_m * along, centre + half_m * along])
        radius_m = BAND_SHARE * float(shown.surface_m[n])
        _connect(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, radius_m, ends, ESTIMATE_RGB, BAND_OPACITY)
    for contacts, rgb, aside_m in (
        (snapshot.true, TRUE_RGB, -0.5 * scale.apart_m),
        (snapshot.estimated, ESTIMATE_RGB, 0.5 * scale.apart_m),
    ):
        for contact in contacts:
            (tail_m, tip_m), _ = _arrow(shown, pose, contact, aside_m, scale)
            ends = np.stack([tail_m, tail_m + _ARROW_STRETCH * (tip_m - tail_m)])
            arrow = mujoco.mjtGeom.mjGEOM_ARROW
            _connect(scene, arrow, _ARROW_RADIUS * size_m, ends, rgb)
    if snapshot.estimated and snapshot.bounds is not None:
        contact = snapshot.estimated[0]
        n = contact.segment - 1
        _, (point_m, force_n) = _arrow(shown, pose, contact, 0.5 * scale.apart_m, scale)
        lines_m = interval_outline_m(
            point_m,
            links.axes[n, :, 0],
            force_n,
            contact.angle_deg,
            snapshot.bounds,
            CLEARANCE * float(shown.surface_m[n]),
            scale,
        )
        for line_m in lines_m:
            capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
            _connect(scene, capsule, 0.5 * FORCE_OUTLINE_WIDTH * size_m, line_m, ESTIMATE_RGB)


def _arrow(
    shown: ShownMachine, pose: _Pose, contact: Contact, aside_m: float, scale: ArrowScale
) -> tuple[Array, tuple[Array, Array]]:
    """Tail and tip (2, 3) of a contact's arrow; and its point and its force (3,)."""
    n = contact.segment - 1
    links = pose.drawn.links
    point_m = links.origin_m[n] + (contact.contact_m + aside_m) * links.axes[n, :, 0]
    force_n = pose.frame_axes[n] @ np.array(contact.wrench[:3])
    clearance_m = CLEARANCE * float(shown.surface_m[n])
    return arrow_m(point_m, force_n, clearance_m, scale), (point_m, force_n)


def _add_cables(
    scene: mujoco.MjvScene, shown: ShownMachine, snapshot: Snapshot, drawn: DrawnPose
) -> None:
    channel = shown.piece_channel
    if not len(channel) or snapshot.readings is None:
        return
    scale_n = full_scale_n(float(snapshot.readings.max()), shown.panels[0].least)
    colours = piece_rgb(snapshot.readings, channel, scale_n)
    radius_m = 0.5 * CABLE_WIDTH * shown.extent.size_m
    for ends, (red, green, blue) in zip(drawn.piece_m, colours.tolist(), strict=True):
        if np.linalg.norm(ends[1] - ends[0]) > 0.0:
            capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
            _connect(scene, capsule, radius_m, ends, (red, green, blue))


def _connect(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    radius_m: float,
    ends_m: Array,
    rgb: Rgb,
    opacity: float = 1.0,
) -> None:
    """Adds a shape from one point to another (2, 3)."""
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), _rgba(rgb, opacity)
    )
    mujoco.mjv_connector(geom, kind, radius_m, ends_m[0], ends_m[1])
    scene.ngeom += 1


def _rgba(rgb: Sequence[int], opacity: float) -> NDArray[np.float32]:
    return np.array([*(share / 255.0 for share in rgb), opacity], dtype=np.float32)
