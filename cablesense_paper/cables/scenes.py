"""The three tendons of Fig. 3 as scenes to look at: the models, with light and a camera."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cablesense_paper.cables.one_metre_cable import (
    around_a_cylinder,
    driven_at_both_ends,
    fixed_and_driven,
)

SCENES = ("fixed and driven", "driven at both ends", "around a cylinder")
WRAP_RAD = float(np.pi) * 2.0 / 3.0
_KP_N_M, _KV_N_S_M = 1e8, 1e4
_CENTRE_M = {
    "fixed and driven": (0.5, 0.0, 0.0),
    "driven at both ends": (0.5, 0.0, 0.0),
    "around a cylinder": (0.0, 0.0, -0.1),
}
_CABLE_WIDTH_M, _ENLARGED = 0.005, 2.0


def scene(name: str) -> tuple[Any, Any]:
    """Model and data of a scene, ready to be drawn; cables and blocks are enlarged."""
    spec = {
        "fixed and driven": lambda: fixed_and_driven(_KP_N_M, _KV_N_S_M),
        "driven at both ends": lambda: driven_at_both_ends(_KP_N_M, _KV_N_S_M),
        "around a cylinder": lambda: around_a_cylinder(WRAP_RAD),
    }[name]()
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[1.0, 1.0, 1.0],
        rgb2=[1.0, 1.0, 1.0],
        width=32,
        height=192,
    )
    for tendon in spec.tendons:
        tendon.width = _CABLE_WIDTH_M
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            geom.size = _ENLARGED * np.asarray(geom.size)
    visual: Any = getattr(spec.visual, "global")
    visual.offwidth, visual.offheight = 1280, 960
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.55, 0.55, 0.55]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def camera(name: str) -> Any:
    """From the side and a little from above."""
    view = mujoco.MjvCamera()
    view.lookat[:] = _CENTRE_M[name]
    view.distance, view.azimuth, view.elevation = 0.85, 83.0, -14.0
    return view
