"""MuJoCo's own pictures of the scenes, made without a screen where the machine has an OpenGL.

A renderer that finds no OpenGL can take its whole process with it, and the kind of OpenGL is
chosen when MuJoCo is loaded. So a picture is made by a process of its own: this module, run.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys

import numpy as np
from numpy.typing import NDArray

BACKENDS = ("egl", "osmesa")
"""Kinds of OpenGL that need no screen, by MuJoCo's names (`MUJOCO_GL`)."""

_LONGEST_S = 60.0

Pixels = NDArray[np.uint8]


def rendered_scenes(names: tuple[str, ...], width: int, height: int) -> tuple[list[Pixels], str]:
    """Pictures (height, width, 3), and the kind of OpenGL; none and "" where there is none.

    A kind that the environment names in `MUJOCO_GL` is tried first.
    """
    asked = os.environ.get("MUJOCO_GL", "")
    for backend in dict.fromkeys((*([asked] if asked in BACKENDS else []), *BACKENDS)):
        pictures = _by(backend, names, width, height)
        if pictures:
            return pictures, backend
    return [], ""


def _by(backend: str, names: tuple[str, ...], width: int, height: int) -> list[Pixels]:
    command = [sys.executable, "-m", __name__, str(width), str(height), *names]
    try:
        done = subprocess.run(
            command,
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            check=False,
            timeout=_LONGEST_S,
        )
    except subprocess.TimeoutExpired:
        return []
    if done.returncode:
        return []
    with np.load(io.BytesIO(done.stdout)) as saved:
        return [saved[name] for name in names]


def _render(names: list[str], width: int, height: int) -> None:
    """Write pictures to the standard output, as one NumPy archive."""
    import mujoco

    from cablesense_paper.cables.scenes import camera, scene

    pictures = {}
    for name in names:
        model, data = scene(name)
        with mujoco.Renderer(model, height, width) as renderer:
            renderer.update_scene(data, camera(name))
            pictures[name] = renderer.render()
    buffer = io.BytesIO()
    np.savez(buffer, **pictures)
    sys.stdout.buffer.write(buffer.getvalue())


if __name__ == "__main__":
    _render(sys.argv[3:], int(sys.argv[1]), int(sys.argv[2]))
