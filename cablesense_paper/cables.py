"""The three tendons of Fig. 3 as MuJoCo models of a cable 1 m long: fixed, driven, or bent.

`fixed_and_driven`, `driven_at_both_ends` and `around_a_cylinder` are the models; `scene` gives one
light and a camera, and `rendered_scenes` has MuJoCo render them without a screen. A renderer that
finds no OpenGL can take its whole process with it, and the kind of OpenGL is chosen when MuJoCo is
loaded. So a picture is made by a process of its own: this module, run.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_sim.model import ACTUATOR_MASS_KG

LENGTH_M = 1.0
SPRING_LENGTH_M = 0.999995
STIFFNESS_N_M = 1e7
"""Of sections II-B and II-C."""

PRETENSION_N = STIFFNESS_N_M * (LENGTH_M - SPRING_LENGTH_M)
AXIAL_RIGIDITY_N = STIFFNESS_N_M * LENGTH_M
"""E A of equation (3), so that a shorter piece of the same cable is stiffer."""

CYLINDER_RADIUS_M = 0.05
RING_MASS_KG = 1e-3
"""Of the piece of cable on the cylinder; the inertia has no part in slow motion."""

_ON_SURFACE = 1.0 + 1e-9
"""A tendon wraps around a cylinder only from a site outside it."""

_STEEL, _DRIVE, _CABLE = (0.30, 0.33, 0.38, 1.0), (0.0, 0.45, 0.70, 1.0), (0.84, 0.37, 0.0, 1.0)


def fixed_and_driven(kp_n_m: float, kv_n_s_m: float, bias_m: float | None = None) -> mujoco.MjSpec:
    """Fig. 3 (a): fixed at x = 0, drawn along +x by a servo at x = 1 m.

    Joint `drive_1` is how far the servo has drawn, and so by how much the cable is longer than
    at the start. Pretension comes from `springlength`, as in the paper, or, with `bias_m` given,
    from that much of the control signal, and the cable is just slack at the start.
    """
    spec = _empty()
    anchor = _end(spec.worldbody, "anchor", _STEEL)
    driven = _driven(spec, 1, LENGTH_M, 1.0, kp_n_m, kv_n_s_m)
    free_m = SPRING_LENGTH_M if bias_m is None else LENGTH_M
    _tendon(spec, "cable", STIFFNESS_N_M, [free_m, free_m], (anchor, driven))
    return spec


def driven_at_both_ends(kp_n_m: float, kv_n_s_m: float) -> mujoco.MjSpec:
    """Fig. 3 (b): drawn along -x by servo 1 at x = 0 and along +x by servo 2 at x = 1 m."""
    spec = _empty()
    left = _driven(spec, 1, 0.0, -1.0, kp_n_m, kv_n_s_m)
    right = _driven(spec, 2, LENGTH_M, 1.0, kp_n_m, kv_n_s_m)
    _tendon(spec, "cable", STIFFNESS_N_M, [SPRING_LENGTH_M] * 2, (left, right))
    return spec


def around_a_cylinder(wrap_rad: float) -> mujoco.MjSpec:
    """Fig. 3 (c): from a drive (mocap body `drive`) over a cylinder to a fixed end.

    MuJoCo gives a tendon one tension along its whole length. So the cable is two tendons, `near`
    and `far`, which meet on a ring that can turn on the cylinder (joint `ring`): the piece of
    cable that lies there. Friction on the cylinder holds the ring. `wrap_rad` is the wrap angle.
    """
    spec = _empty()
    body = spec.worldbody.add_body(name="cylinder")
    body.add_geom(
        name="cylinder", type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        fromto=[0.0, -0.03, 0.0, 0.0, 0.03, 0.0], size=[CYLINDER_RADIUS_M, 0.0, 0.0],
        rgba=(0.72, 0.75, 0.79, 1.0), contype=0, conaffinity=0,
    )  # fmt: skip
    ring = spec.worldbody.add_body(name="ring")
    ring.add_joint(name="ring", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0])
    ring.explicitinertial = True
    ring.mass, ring.inertia = RING_MASS_KG, np.full(3, RING_MASS_KG * CYLINDER_RADIUS_M**2)
    top = ring.add_site(name="top", pos=[0.0, 0.0, CYLINDER_RADIUS_M * _ON_SURFACE])
    drive = spec.worldbody.add_body(name="drive", mocap=True, pos=_end_m(wrap_rad, 1.0))
    pulled = _end(drive, "drive", _DRIVE)
    fixed = _end(spec.worldbody, "anchor", _STEEL, _end_m(wrap_rad, -1.0))
    half = 0.5 * LENGTH_M
    free_m = half - PRETENSION_N * half / AXIAL_RIGIDITY_N
    for name, side, end in (("near", 1.0, pulled), ("far", -1.0, fixed)):
        outside = spec.worldbody.add_site(
            name=f"{name}_side",
            pos=_at_m(side * 0.25 * wrap_rad, 1.3 * CYLINDER_RADIUS_M),
            rgba=(0.0, 0.0, 0.0, 0.0),
        )
        tendon = _tendon(spec, name, AXIAL_RIGIDITY_N / half, [0.0, free_m], (end,))
        tendon.wrap_geom("cylinder", outside.name)
        tendon.wrap_site(top.name)
    return spec


def drive_direction(wrap_rad: float) -> Array:
    """Unit vector (3,) along which the drive of `around_a_cylinder` draws the cable."""
    return np.array([np.cos(0.5 * wrap_rad), 0.0, -np.sin(0.5 * wrap_rad)])


def _end_m(wrap_rad: float, side: float) -> list[float]:
    """Where half the cable ends that leaves the cylinder half the wrap angle from its top."""
    straight_m = 0.5 * (LENGTH_M - CYLINDER_RADIUS_M * wrap_rad)
    leaves = np.array(_at_m(side * 0.5 * wrap_rad, CYLINDER_RADIUS_M))
    along = drive_direction(wrap_rad) * [side, 1.0, 1.0]
    return [float(x) for x in leaves + straight_m * along]


def _at_m(from_top_rad: float, radius_m: float) -> list[float]:
    return [float(radius_m * np.sin(from_top_rad)), 0.0, float(radius_m * np.cos(from_top_rad))]


def _empty() -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = np.zeros(3)
    spec.option.timestep = 1e-3
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return spec


def _driven(
    spec: mujoco.MjSpec, number: int, x_m: float, way: float, kp_n_m: float, kv_n_s_m: float
) -> Any:
    name = f"drive_{number}"
    body = spec.worldbody.add_body(name=name, pos=[x_m, 0.0, 0.0])
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[way, 0.0, 0.0])
    body.explicitinertial = True
    body.mass, body.inertia = ACTUATOR_MASS_KG, np.full(3, 1e-4)
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=kp_n_m, kv=kv_n_s_m)
    return _end(body, name, _DRIVE)


def _end(
    body: Any, name: str, rgba: tuple[float, ...], at_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> Any:
    """A block and the site at its middle, where a cable ends."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=at_m, size=[0.012, 0.02, 0.02], rgba=rgba,
        contype=0, conaffinity=0, mass=0.0,
    )  # fmt: skip
    return body.add_site(name=name, pos=at_m)


def _tendon(
    spec: mujoco.MjSpec, name: str, stiffness_n_m: float, free_m: list[float], ends: Any
) -> Any:
    tendon = spec.add_tendon(
        name=name, stiffness=[stiffness_n_m, 0.0, 0.0], springlength=free_m, width=0.002,
        rgba=_CABLE,
    )  # fmt: skip
    for site in ends:
        tendon.wrap_site(site.name)
    return tendon


_KP_N_M, _KV_N_S_M = 1e8, 1e4
_SCENES: Any = {
    "fixed and driven": (lambda: fixed_and_driven(_KP_N_M, _KV_N_S_M), (0.5, 0.0, 0.0)),
    "driven at both ends": (lambda: driven_at_both_ends(_KP_N_M, _KV_N_S_M), (0.5, 0.0, 0.0)),
    "around a cylinder": (lambda: around_a_cylinder(np.pi * 2.0 / 3.0), (0.0, 0.0, -0.1)),
}
"""Model and centre in m of each scene."""

SCENES = tuple(_SCENES)
_CABLE_WIDTH_M, _ENLARGED = 0.005, 2.0


def scene(name: str) -> tuple[Any, Any]:
    """Model and data of a scene, ready to be drawn; cables and blocks are enlarged."""
    spec = _SCENES[name][0]()
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=[1.0, 1.0, 1.0], rgb2=[1.0, 1.0, 1.0],
        width=32, height=192,
    )  # fmt: skip
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
    view.lookat[:] = _SCENES[name][1]
    view.distance, view.azimuth, view.elevation = 0.85, 83.0, -14.0
    return view


BACKENDS = ("egl", "osmesa")
"""Kinds of OpenGL that need no screen, by MuJoCo's names (`MUJOCO_GL`)."""

_LONGEST_S = 60.0

Pixels = NDArray[np.uint8]


def rendered_scenes(names: tuple[str, ...], width: int, height: int) -> tuple[list[Pixels], str]:
    """Pictures (height, width, 3), and the kind of OpenGL; none and "" where there is none.

    A kind that the environment names in `MUJOCO_GL` is tried first.
    """
    asked = os.environ.get("MUJOCO_GL", "")
    command = [sys.executable, "-m", __name__, str(width), str(height), *names]
    for backend in dict.fromkeys((*([asked] if asked in BACKENDS else []), *BACKENDS)):
        environment = {**os.environ, "MUJOCO_GL": backend}
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, check=True, timeout=_LONGEST_S
            )
        except subprocess.SubprocessError:
            continue
        with np.load(io.BytesIO(done.stdout)) as saved:
            return [saved[name] for name in names], backend
    return [], ""


def _render(names: list[str], width: int, height: int) -> None:
    """Write pictures to the standard output, as one NumPy archive."""
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
