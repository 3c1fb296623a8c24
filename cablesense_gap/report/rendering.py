"""Renders the film of a robot: `python -m cablesense_gap.report.rendering FOLDER`.

It is run as a process of its own, as a driver of graphics may end the process that loads it. The
folder has the model and the positions; the animation and the poster go there.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cablesense_base import Array

MODEL = "model.mjb"
POSITIONS = "positions.npz"
ANIMATION = "film.webp"
POSTER = "poster.webp"
FRAMES_HZ = 15.0
_HEIGHT_PX = 330
_WIDTH_PX = 440
_QUALITY = 70
_HELD_S = 1.0
"""How long the last frame stays."""
_MEASURED = (0.25, 0.28, 0.32, 1.0)
_FIXED = (0.85, 0.87, 0.89, 1.0)
_WHITE = (1.0, 1.0, 1.0, 1.0)
_PREDICTED_OPACITY = 0.75
_EMISSION = 0.5
"""Of colours, so that they are those of the page in the shade, too."""
_ROOM = 1.06
"""Distance of the camera by that at which all just fits in."""
_BEHIND = 1.5
"""Distance of the wall from the middle, by the radius of all that moves."""
_THICKNESS = 0.02
"""Of links without shapes, by that radius."""
_STEEPEST_DEG = 89.0
_VIEWED = 8
"""Frames by which the camera is placed."""

Picture = NDArray[np.uint8]


class Stage:
    """A robot as it is drawn: measured, and over it as it is predicted.

    The camera looks along the direction in which its bodies are spread least, so that a machine
    that moves in a plane is seen from the side; rather from above than from below.

    Attributes:
        camera: through which it is seen.
    """

    def __init__(self, model: mujoco.MjModel, positions: Array) -> None:
        """`positions` (K, J) are within what will be drawn."""
        self._model = model
        self._data = mujoco.MjData(model)
        self._option = mujoco.MjvOption()
        self._moving = model.body_weldid > 0
        visible = self._option.geomgroup[model.geom_group] > 0
        self._shapes = np.flatnonzero(visible & self._moving[model.geom_bodyid])
        places_m = np.array([self._places_m(position) for position in positions])
        points = places_m.reshape(-1, 3)
        middle_m = 0.5 * (points.min(axis=0) + points.max(axis=0))
        away_m = np.linalg.norm(places_m - middle_m, axis=2)
        if len(self._shapes):
            away_m += model.geom_rbound[self._shapes]
        self._radius_m = float(away_m.max())
        self._forward = _least_spread(points)
        self.camera = mujoco.MjvCamera()
        self.camera.lookat[:] = middle_m
        half_view = np.radians(0.5 * model.vis.global_.fovy)
        self.camera.distance = _ROOM * self._radius_m / np.sin(half_view)
        self.camera.azimuth = np.degrees(np.arctan2(self._forward[1], self._forward[0]))
        elevation_deg = np.degrees(np.arcsin(self._forward[2]))
        self.camera.elevation = max(elevation_deg, -_STEEPEST_DEG)

    def picture(
        self, renderer: mujoco.Renderer, measured: Array, predicted: Array, rgb: Array
    ) -> Picture:
        """One panel (H, W, 3): the robot at both positions (J,), the predicted one in `rgb`."""
        scene = renderer.scene
        self._place(measured)
        renderer.update_scene(self._data, self.camera, self._option)
        for geom in scene.geoms[: scene.ngeom]:
            moves = geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC
            _paint(geom, _MEASURED if moves else _FIXED)
        self._add_rods(scene, _MEASURED)
        first = scene.ngeom
        self._place(predicted)
        mujoco.mjv_addGeoms(
            self._model,
            self._data,
            self._option,
            mujoco.MjvPerturb(),
            mujoco.mjtCatBit.mjCAT_DYNAMIC,
            scene,
        )
        colour = (*rgb, _PREDICTED_OPACITY)
        for geom in scene.geoms[first : scene.ngeom]:
            _paint(geom, colour)
        self._add_rods(scene, colour)
        self._add_wall(scene)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        return np.asarray(renderer.render()).copy()

    def _place(self, position: Array) -> None:
        self._data.qpos[:] = position
        mujoco.mj_forward(self._model, self._data)

    def _places_m(self, position: Array) -> Array:
        """(N, 3) of the shapes that move, without any of bodies' frames and centres of mass."""
        self._place(position)
        if len(self._shapes):
            return self._data.geom_xpos[self._shapes]
        return np.concatenate([self._data.xpos[self._moving], self._data.xipos[self._moving]])

    def _add_rods(self, scene: mujoco.MjvScene, rgba: tuple[float, ...]) -> None:
        """Of a model without shapes, rods from frame to frame and to the centres of mass."""
        if len(self._shapes):
            return
        data = self._data
        width_m = _THICKNESS * self._radius_m
        for body in np.flatnonzero(self._moving).tolist():
            frame = data.xpos[body]
            frame_before = data.xpos[self._model.body_parentid[body]]
            for begin, end in ((frame_before, frame), (frame, data.xipos[body])):
                rod = _added(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, rgba)
                mujoco.mjv_connector(rod, mujoco.mjtGeom.mjGEOM_CAPSULE, width_m, begin, end)

    def _add_wall(self, scene: mujoco.MjvScene) -> None:
        """A white wall behind all: the renderer's own background is black."""
        wall = _added(scene, mujoco.mjtGeom.mjGEOM_BOX, _WHITE)
        half_m = 10.0 * self.camera.distance
        forward = self._forward
        wall.size[:] = half_m
        wall.pos[:] = self.camera.lookat + (_BEHIND * self._radius_m + half_m) * forward
        across, up, _normal = np.linalg.svd(np.eye(3) - np.outer(forward, forward))[0].T
        wall.mat[:] = np.column_stack([across, up, forward])
        wall.emission = 1.0


def _least_spread(points: Array) -> Array:
    """The unit vector (3,) along which points (K, 3) are spread least; downwards, else along y."""
    direction = np.linalg.svd(points - points.mean(axis=0))[2][-1]
    towards = direction[[2, 1, 0]] * (-1.0, 1.0, 1.0)
    sizeable = towards[np.abs(towards) > 1e-6]
    return np.asarray(direction * np.sign(sizeable[0]))


def _added(scene: mujoco.MjvScene, kind: mujoco.mjtGeom, rgba: tuple[float, ...]) -> Any:
    """A new shape in the scene."""
    geom = scene.geoms[scene.ngeom]
    colour = np.array(rgba, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, np.ones(3), np.zeros(3), np.eye(3).ravel(), colour)
    geom.emission = _EMISSION
    scene.ngeom += 1
    return geom


def _paint(geom: Any, rgba: tuple[float, ...]) -> None:
    geom.rgba[:] = rgba
    geom.matid = -1
    geom.emission = _EMISSION


def main() -> None:
    """Render the film of the folder that the command names."""
    folder = Path(sys.argv[1])
    model = mujoco.MjModel.from_binary_path(str(folder / MODEL))
    content = np.load(folder / POSITIONS)
    measured = content["measured"]
    predictions = content["predicted"]
    colours = content["colours"]
    viewed = np.linspace(0, len(measured) - 1, _VIEWED).round().astype(int)
    drawn = np.concatenate([measured[None], predictions])[:, viewed]
    stage = Stage(model, drawn.reshape(-1, model.nq))
    pictures = []
    with mujoco.Renderer(model, _HEIGHT_PX, _WIDTH_PX) as renderer:
        for frame, position in enumerate(measured):
            panels = [
                stage.picture(renderer, position, predicted[frame], rgb)
                for predicted, rgb in zip(predictions, colours, strict=True)
            ]
            pictures.append(Image.fromarray(np.hstack(panels)))
    frame_ms = round(1e3 / FRAMES_HZ)
    duration_ms = [frame_ms] * (len(pictures) - 1) + [round(1e3 * _HELD_S)]
    pictures[0].save(
        folder / ANIMATION,
        save_all=True,
        append_images=pictures[1:],
        duration=duration_ms,
        loop=0,
        quality=_QUALITY,
        method=2,
    )
    pictures[-1].save(folder / POSTER, quality=_QUALITY)


if __name__ == "__main__":
    main()
