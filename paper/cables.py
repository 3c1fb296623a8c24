"""The three tendons of Fig. 3 as MuJoCo models of a cable 1 m long: fixed, driven, or bent."""

from __future__ import annotations

import mujoco
import numpy as np

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
  <default><geom type="box" size="0.024 0.04 0.04" mass="0"/></default>
  <worldbody>{bodies}</worldbody>
  <tendon>{tendons}</tendon>
  <actuator>{servos}</actuator>
</mujoco>
"""
"""Blocks mark the ends, and have no part in the mechanics."""


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
    radius_m = CYLINDER_RADIUS_M
    half_m = 0.5 * LENGTH_M
    spring_m = (0.0, half_m - PRETENSION_N * half_m / AXIAL_RIGIDITY_N)
    inertia = 1e-3 * radius_m**2
    bodies = f"""
      <geom name="cylinder" type="cylinder" fromto="0 -0.03 0 0 0.03 0" size="{radius_m}"/>
      <body name="ring">
        <inertial pos="0 0 0" mass="0.001" diaginertia="{inertia} {inertia} {inertia}"/>
        <joint name="ring" type="hinge" axis="0 1 0"/>
        <site name="top" pos="0 0 {radius_m * _ON_SURFACE}"/>
      </body>
      <body name="drive" mocap="true" pos="{_end_m(wrap_rad, 1.0)}">
        <geom/><site name="drive"/>
      </body>
      <geom pos="{_end_m(wrap_rad, -1.0)}"/>
      <site name="anchor" pos="{_end_m(wrap_rad, -1.0)}"/>"""
    tendons = ""
    for name, side, end in (("near", 1.0, "drive"), ("far", -1.0, "anchor")):
        x_m, z_m = _at_m(side * 0.25 * wrap_rad, 1.3 * radius_m)
        bodies += f'<site name="{name}_side" pos="{x_m} 0 {z_m}"/>'
        path = f'{_site(end)}<geom geom="cylinder" sidesite="{name}_side"/>{_site("top")}'
        tendons += _tendon(name, AXIAL_RIGIDITY_N / half_m, spring_m, path)
    return _spec(bodies, tendons)


def drive_direction(wrap_rad: float) -> Array:
    """Unit vector (3,) along which the drive of `around_a_cylinder` draws the cable."""
    return np.array([np.cos(0.5 * wrap_rad), 0.0, -np.sin(0.5 * wrap_rad)])


def _end_m(wrap_rad: float, side: float) -> str:
    """The end of the half cable that leaves the cylinder half the wrap angle from its top."""
    straight_m = 0.5 * (LENGTH_M - CYLINDER_RADIUS_M * wrap_rad)
    x_m, z_m = _at_m(side * 0.5 * wrap_rad, CYLINDER_RADIUS_M)
    along = drive_direction(wrap_rad)
    return f"{x_m + straight_m * side * along[0]} 0 {z_m + straight_m * along[2]}"


def _at_m(from_top_rad: float, radius_m: float) -> tuple[float, float]:
    """X and z of a place on or over the cylinder."""
    return float(radius_m * np.sin(from_top_rad)), float(radius_m * np.cos(from_top_rad))


def _spec(bodies: str, tendons: str, servos: str = "") -> mujoco.MjSpec:
    text = _MJCF.format(bodies=bodies, tendons=tendons, servos=servos)
    return mujoco.MjSpec.from_string(text)


def _driven(name: str, x_m: float, way: int) -> str:
    return f"""
      <body name="{name}" pos="{x_m} 0 0">
        <inertial pos="0 0 0" mass="{ACTUATOR_MASS_KG}" diaginertia="1e-4 1e-4 1e-4"/>
        <joint name="{name}" type="slide" axis="{way} 0 0"/>
        <geom/><site name="{name}"/>
      </body>"""


def _servo(name: str, kp_n_m: float, kv_n_s_m: float) -> str:
    return f'<position name="{name}" joint="{name}" kp="{kp_n_m}" kv="{kv_n_s_m}"/>'


def _tendon(name: str, stiffness_n_m: float, spring_m: tuple[float, float], path: str) -> str:
    numbers = f'stiffness="{stiffness_n_m}" springlength="{spring_m[0]} {spring_m[1]}"'
    return f'<spatial name="{name}" {numbers}>{path}</spatial>'


def _site(name: str) -> str:
    return f'<site site="{name}"/>'
