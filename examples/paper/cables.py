"""The three tendons of Fig. 3 as MuJoCo models of a cable 1 m long: fixed, driven, or bent.

`fixed_and_driven`, `driven_at_both_ends` and `around_a_cylinder` are the models; `rendered_scenes`
has MuJoCo render them without a screen. A renderer that finds no OpenGL can take its whole process
with it, and the kind of OpenGL is chosen when MuJoCo is loaded. So a picture is made by a process
of its own: this module, run.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.model import ACTUATOR_MASS_KG

LENGTH_M = 1.0
SPRING_LENGTH_M = 0.999995
STIFFNESS_N_M = 1e7
"""Of sections II-B and II-C."""

PRETENSION_N = STIFFNESS_N_M * (LENGTH_M - SPRING_LENGTH_M)
AXIAL_RIGIDITY_N = STIFFNESS_N_M * LENGTH_M
"""E A of equation (3), so that a shorter piece of the same cable is stiffer."""

CYLINDER_RADIUS_M = 0.05
_ON_SURFACE = 1.0 + 1e-9
"""A tendon wraps around a cylinder only from a site outside it."""

_MJCF = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0" timestep="0.001" integrator="discrete">
    <flag contact="disable" autoreset="disable"/>
  </option>
  <visual>
    <global offwidth="1280" offheight="960"/>
    <headlight ambient="0.45 0.45 0.45" diffuse="0.55 0.55 0.55"/>
  </visual>
  <asset>
    <texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="32" height="192"/>
  </asset>
  <default>
    <geom type="box" size="0.024 0.04 0.04" mass="0" contype="0" conaffinity="0"
          rgba="0.30 0.33 0.38 1"/>
    <tendon width="0.005" rgba="0.84 0.37 0 1"/>
    <default class="drive"><geom rgba="0 0.45 0.70 1"/></default>
  </default>
  <worldbody>{bodies}</worldbody>
  <tendon>{tendons}</tendon>
  <actuator>{servos}</actuator>
</mujoco>
"""
"""Blocks and cables are larger than life, to be seen; neither has a part in the mechanics."""


def fixed_and_driven(kp_n_m: float, kv_n_s_m: float, bias_m: float | None = None) -> mujoco.MjSpec:
    """Fig. 3 (a): fixed at x = 0, drawn along +x by a servo at x = 1 m.

    Joint `drive_1` is how far the servo has drawn, and so by how much the cable is longer than
    at the start. Pretension comes from `springlength`, as in the paper, or, with `bias_m` given,
    from that much of the control signal, and the cable is just slack at the start.
    """
    free_m = SPRING_LENGTH_M if bias_m is None else LENGTH_M
    anchor = '<geom/><site name="anchor"/>'
    return _spec(
        anchor + _driven("drive_1", LENGTH_M, 1),
        _tendon("cable", STIFFNESS_N_M, (free_m, free_m), _site("anchor") + _site("drive_1")),
        _servo("drive_1", kp_n_m, kv_n_s_m),
    )


def driven_at_both_ends(kp_n_m: float, kv_n_s_m: float) -> mujoco.MjSpec:
    """Fig. 3 (b): drawn along -x by servo 1 at x = 0 and along +x by servo 2 at x = 1 m."""
    ends = _site("drive_1") + _site("drive_2")
    return _spec(
        _driven("drive_1", 0.0, -1) + _driven("drive_2", LENGTH_M, 1),
        _tendon("cable", STIFFNESS_N_M, (SPRING_LENGTH_M, SPRING_LENGTH_M), ends),
        _servo("drive_1", kp_n_m, kv_n_s_m) + _servo("drive_2", kp_n_m, kv_n_s_m),
    )


def around_a_cylinder(wrap_rad: float) -> mujoco.MjSpec:
    """Fig. 3 (c): from a drive (mocap body `drive`) over a cylinder to a fixed end.

    MuJoCo gives a tendon one tension along its whole length. So the cable is two tendons, `near`
    and `far`, which meet on a ring that can turn on the cylinder (joint `ring`): the piece of
    cable that lies there. Friction on the cylinder holds the ring, whose inertia has no part in
    slow motion. `wrap_rad` is the wrap angle.
    """
    radius_m, half_m = CYLINDER_RADIUS_M, 0.5 * LENGTH_M
    spring_m = (0.0, half_m - PRETENSION_N * half_m / AXIAL_RIGIDITY_N)
    inertia = 1e-3 * radius_m**2
    bodies = f"""
      <geom name="cylinder" type="cylinder" fromto="0 -0.03 0 0 0.03 0" size="{radius_m}"
            rgba="0.72 0.75 0.79 1"/>
      <body name="ring">
        <inertial pos="0 0 0" mass="0.001" diaginertia="{inertia} {inertia} {inertia}"/>
        <joint name="ring" type="hinge" axis="0 1 0"/>
        <site name="top" pos="0 0 {radius_m * _ON_SURFACE}"/>
      </body>
      <body name="drive" mocap="true" pos="{_end_m(wrap_rad, 1.0)}">
        <geom class="drive"/><site name="drive"/>
      </body>
      <geom pos="{_end_m(wrap_rad, -1.0)}"/>
      <site name="anchor" pos="{_end_m(wrap_rad, -1.0)}"/>"""
    tendons = ""
    for name, side, end in (("near", 1.0, "drive"), ("far", -1.0, "anchor")):
        x_m, z_m = _at_m(side * 0.25 * wrap_rad, 1.3 * radius_m)
        bodies += f'<site name="{name}_side" pos="{x_m} 0 {z_m}" rgba="0 0 0 0"/>'
        path = f'{_site(end)}<geom geom="cylinder" sidesite="{name}_side"/>{_site("top")}'
        tendons += _tendon(name, AXIAL_RIGIDITY_N / half_m, spring_m, path)
    return _spec(bodies, tendons)


def drive_direction(wrap_rad: float) -> Array:
    """Unit vector (3,) along which the drive of `around_a_cylinder` draws the cable."""
    return np.array([np.cos(0.5 * wrap_rad), 0.0, -np.sin(0.5 * wrap_rad)])


def _end_m(wrap_rad: float, side: float) -> str:
    """Where half the cable ends that leaves the cylinder half the wrap angle from its top."""
    straight_m = 0.5 * (LENGTH_M - CYLINDER_RADIUS_M * wrap_rad)
    x_m, z_m = _at_m(side * 0.5 * wrap_rad, CYLINDER_RADIUS_M)
    along = drive_direction(wrap_rad)
    return f"{x_m + straight_m * side * along[0]} 0 {z_m + straight_m * along[2]}"


def _at_m(from_top_rad: float, radius_m: float) -> tuple[float, float]:
    """Of a place on or over the cylinder: x and z."""
    return float(radius_m * np.sin(from_top_rad)), float(radius_m * np.cos(from_top_rad))


def _spec(bodies: str, tendons: str, servos: str = "") -> mujoco.MjSpec:
    text = _MJCF.format(bodies=bodies, tendons=tendons, servos=servos)
    return mujoco.MjSpec.from_string(text)


def _driven(name: str, x_m: float, way: int) -> str:
    return f"""
      <body name="{name}" pos="{x_m} 0 0">
        <inertial pos="0 0 0" mass="{ACTUATOR_MASS_KG}" diaginertia="1e-4 1e-4 1e-4"/>
        <joint name="{name}" type="slide" axis="{way} 0 0"/>
        <geom class="drive"/><site name="{name}"/>
      </body>"""


def _servo(name: str, kp_n_m: float, kv_n_s_m: float) -> str:
    return f'<position name="{name}" joint="{name}" kp="{kp_n_m}" kv="{kv_n_s_m}"/>'


def _tendon(name: str, stiffness_n_m: float, spring_m: tuple[float, float], path: str) -> str:
    numbers = f'stiffness="{stiffness_n_m}" springlength="{spring_m[0]} {spring_m[1]}"'
    return f'<spatial name="{name}" {numbers}>{path}</spatial>'


def _site(name: str) -> str:
    return f'<site site="{name}"/>'


_SCENES: Any = {
    "fixed and driven": (lambda: fixed_and_driven(1e8, 1e4), (0.5, 0.0, 0.0)),
    "driven at both ends": (lambda: driven_at_both_ends(1e8, 1e4), (0.5, 0.0, 0.0)),
    "around a cylinder": (lambda: around_a_cylinder(np.pi * 2.0 / 3.0), (0.0, 0.0, -0.1)),
}
"""Model and centre in m of each scene."""

SCENES = tuple(_SCENES)


def scene(name: str) -> tuple[Any, Any]:
    """Model and data of a scene, ready to be drawn."""
    model = _SCENES[name][0]().compile()
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
    command = [sys.executable, __file__, str(width), str(height), *names]
    for backend in sorted(BACKENDS, key=lambda kind: kind != asked):
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


if __name__ == "__main__":
    width_px, height_px, *wanted = sys.argv[1:]
    rendered = {}
    for each in wanted:
        its_model, its_data = scene(each)
        with mujoco.Renderer(its_model, int(height_px), int(width_px)) as renderer:
            renderer.update_scene(its_data, camera(each))
            rendered[each] = renderer.render()
    archive = io.BytesIO()
    np.savez(archive, **rendered)
    sys.stdout.buffer.write(archive.getvalue())
