"""The arm as a MuJoCo model, by `mujoco.MjSpec`.

Cables are spatial tendons with `springlength = [0, L0]`: a spring beyond L0 and nothing
below, so they pull and never push. An actuator of finite stiffness is a slide joint under a
position servo at the cable's far end; a rigid one is a mocap body that sits exactly where it is
commanded.
"""

from __future__ import annotations

import mujoco
import numpy as np

from cablesense_sim import kinematics
from cablesense_sim.drawn_shapes import PLATE_HALF_THICKNESS_M, PLATE_RADIUS, SEGMENT_RADIUS
from cablesense_sim.mechanism import Mechanism

ACTUATOR_MASS_KG = 0.5
"""Moving mass of one ball screw; it has no part in statics."""

_CABLE_WIDTH_M = 0.0008
"""Of a cable as drawn: MuJoCo's tendons have no thickness."""
_Rgba = tuple[float, float, float, float]
_TIMESTEP_S = 1e-3
"""Of the MuJoCo model, unless its user sets another one."""
_LIGHTEST_BODY_KG = 1e-6
"""Mass of a segment, at least: MuJoCo refuses a body without."""
_ACTUATOR_INERTIA_KG_M2 = 1e-4
"""Of an actuator's screw, which slides only: MuJoCo wants some."""
_SEGMENT_RGBA = (0.55, 0.58, 0.62, 1.0)
"""Colour of segments."""
_PLATE_RGBA = (0.30, 0.33, 0.38, 1.0)
"""Colour of guide plates."""


def build_spec(mechanism: Mechanism, name: str = "arm") -> mujoco.MjSpec:
    """The arm's model specification, with the names of the contract.

    Bodies `segment_n`, joints `joint_n_pitch|yaw`, tendons `cable_i`, sites `contact_n`.

    Compile it with `spec.compile()`. Time step 1 ms, integrator `discrete`, which treats cable and
    servo stiffness implicitly and so stays stable however stiff they are.
    """
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.option.gravity = mechanism.gravity_m_s2
    spec.option.timestep = _TIMESTEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    bodies = _add_chain(spec, mechanism)
    for i in range(mechanism.cable_count):
        _add_cable(spec, bodies, mechanism, i)
    return spec


def unstretched_length_m(mechanism: Mechanism) -> np.ndarray:
    """(M,) straight length minus the stretch by pretension: where a cable is just slack."""
    straight = kinematics.cable_lengths_m(mechanism, np.zeros(mechanism.joint_count))
    return np.asarray(straight - mechanism.pretension_n / mechanism.stiffness_n_m)


def _add_chain(spec: mujoco.MjSpec, mechanism: Mechanism) -> list[mujoco.MjsBody]:
    """World and segments; body n carries the plates after joint n and before joint n + 1."""
    bodies = [spec.worldbody]
    radius = float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())
    _add_plate(spec.worldbody, 0.0, radius)
    position = mechanism.plate_offset_m
    for n in range(mechanism.segment_count):
        length = mechanism.segment_length_m[n]
        mass = mechanism.mass_kg[n]
        body = bodies[-1].add_body(name=f"segment_{n + 1}", pos=[position, 0.0, 0.0])
        damping = [mechanism.joint_damping_n_m_s, 0.0, 0.0]
        stiffness = [mechanism.joint_stiffness_n_m_rad[n], 0.0, 0.0]
        for axis, direction in (("pitch", [0, 1, 0]), ("yaw", [0, 0, 1])):
            hinge = {"type": mujoco.mjtJoint.mjJNT_HINGE, "axis": direction}
            name = f"joint_{n + 1}_{axis}"
            body.add_joint(name=name, damping=damping, stiffness=stiffness, **hinge)
        body.explicitinertial = True
        body.mass = max(mass, _LIGHTEST_BODY_KG)
        body.ipos = [mechanism.centre_of_mass_m[n], 0.0, 0.0]
        across = (3.0 * radius**2 + length**2) / 12.0
        body.inertia = body.mass * np.array([0.5 * radius**2, across, across])
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        _add_shape(body, capsule, 0.0, length, SEGMENT_RADIUS * length, _SEGMENT_RGBA)
        _add_plate(body, mechanism.plate_offset_m, radius)
        if n + 1 < mechanism.segment_count:
            _add_plate(body, length - mechanism.plate_offset_m, radius)
        body.add_site(name=f"contact_{n + 1}", pos=[mechanism.contact_m[n], 0.0, 0.0])
        bodies.append(body)
        position = length
    return bodies


def _add_plate(body: mujoco.MjsBody, x_m: float, radius_m: float) -> None:
    ends = x_m - PLATE_HALF_THICKNESS_M, x_m + PLATE_HALF_THICKNESS_M
    _add_shape(body, mujoco.mjtGeom.mjGEOM_CYLINDER, *ends, PLATE_RADIUS * radius_m, _PLATE_RGBA)


def _add_shape(
    body: mujoco.MjsBody, kind: int, from_m: float, to_m: float, radius_m: float, rgba: _Rgba
) -> None:
    """Seen along the axis: without mass and without contacts."""
    body.add_geom(
        type=kind,
        fromto=[from_m, 0.0, 0.0, to_m, 0.0, 0.0],
        size=[radius_m, 0.0, 0.0],
        rgba=rgba,
        contype=0,
        conaffinity=0,
        mass=0.0,
    )


def _add_cable(
    spec: mujoco.MjSpec, bodies: list[mujoco.MjsBody], mechanism: Mechanism, i: int
) -> None:
    name = f"cable_{i + 1}"
    o = mechanism.plate_offset_m
    y = mechanism.hole_y_m[i]
    z = mechanism.hole_z_m[i]
    actuator = spec.worldbody.add_body(name=f"actuator_{i + 1}", pos=[-mechanism.run_m, y, z])
    rigid = not np.isfinite(mechanism.actuator_stiffness_n_m)
    actuator.mocap = rigid
    if not rigid:
        _add_servo(spec, actuator, mechanism.actuator_stiffness_n_m, i)
    spool = actuator.add_site(name=f"{name}_actuator")
    tendon = spec.add_tendon(
        name=name,
        stiffness=[mechanism.cable_stiffness_n_m[i], 0.0, 0.0],
        springlength=[0.0, unstretched_length_m(mechanism)[i]],
        width=_CABLE_WIDTH_M,
    )
    tendon.wrap_site(spool.name)
    before, after = mechanism.plate_holes_m
    for n in range(mechanism.cable_segment[i]):
        ahead = mechanism.segment_length_m[n - 1] - o if n else 0.0
        for body, x, side, (across, up) in (
            (bodies[n], ahead, "before", before),
            (bodies[n + 1], o, "after", after),
        ):
            place = [x, across[i, n], up[i, n]]
            hole = body.add_site(name=f"{name}_{side}_joint_{n + 1}", pos=place)
            tendon.wrap_site(hole.name)


def _add_servo(spec: mujoco.MjSpec, body: mujoco.MjsBody, stiffness_n_m: float, i: int) -> None:
    """A screw that draws its cable back along -x by the control signal, metres."""
    joint = body.add_joint(
        name=f"screw_{i + 1}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[-1.0, 0.0, 0.0]
    )
    body.explicitinertial = True
    body.gravcomp = 1.0
    body.mass = ACTUATOR_MASS_KG
    body.inertia = np.full(3, _ACTUATOR_INERTIA_KG_M2)
    servo = spec.add_actuator(
        name=f"servo_{i + 1}", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    servo.set_to_position(kp=stiffness_n_m, kv=2.0 * np.sqrt(stiffness_n_m * ACTUATOR_MASS_KG))
