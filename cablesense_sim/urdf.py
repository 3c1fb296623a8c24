"""The arm as a URDF, for `robot_description`."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.drawn_shapes import PLATE_HALF_THICKNESS_M, PLATE_RADIUS, SEGMENT_RADIUS


def urdf_xml(arm: Arm) -> str:
    """The URDF text of an arm for `robot_description` (RViz, robot_state_publisher).

    Cables have no place in a URDF; it carries the links `base_link`, `segment_n` and the joints
    that `joint_states` names.
    """
    mechanism = mechanism_of(arm)
    radius = float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())
    parent = "base_link"
    position = mechanism.plate_offset_m
    offset = mechanism.plate_offset_m
    parts = [f'<link name="base_link">{_disc(0.0, radius)}</link>']
    for n in range(arm.segment_count):
        middle = f"segment_{n + 1}_pitched"
        child = f"segment_{n + 1}"
        limit = float(mechanism.bend_limit_rad[n])
        length = float(mechanism.segment_length_m[n])
        mass = float(mechanism.mass_kg[n])
        centre = float(mechanism.centre_of_mass_m[n])
        across = mass * (3.0 * radius**2 + length**2) / 12.0
        inertial = _inertial(mass, centre, 0.5 * mass * radius**2, across)
        shape = _cylinder(0.5 * length, length, SEGMENT_RADIUS * length)
        plates = [offset, length - offset] if n + 1 < arm.segment_count else [offset]
        parts += [
            f'<link name="{middle}">{_inertial(1e-6, 0.0, 1e-9, 1e-9)}</link>',
            _joint(f"joint_{n + 1}_pitch", parent, middle, position, "0 1 0", limit),
            f'<link name="{child}">{inertial}{shape}',
            *(_disc(x, radius) for x in plates),
            "</link>",
            _joint(f"joint_{n + 1}_yaw", middle, child, 0.0, "0 0 1", limit),
        ]
        parent = child
        position = length
    robot = ElementTree.fromstring(f'<robot name="{arm.name}">{"".join(parts)}</robot>')
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True)


def _joint(name: str, parent: str, child: str, x_m: float, axis: str, limit_rad: float) -> str:
    return f"""<joint name="{name}" type="revolute">
        <parent link="{parent}"/><child link="{child}"/><origin xyz="{x_m:.6g} 0 0" rpy="0 0 0"/>
        <axis xyz="{axis}"/>
        <limit lower="{-limit_rad:.6g}" upper="{limit_rad:.6g}" effort="1000" velocity="3"/>
        </joint>"""


def _inertial(mass_kg: float, x_m: float, along: float, across: float) -> str:
    return f"""<inertial><origin xyz="{x_m:.6g} 0 0" rpy="0 0 0"/><mass value="{mass_kg:.6g}"/>
        <inertia ixx="{along:.6g}" iyy="{across:.6g}" izz="{across:.6g}" ixy="0" ixz="0" iyz="0"/>
        </inertial>"""


def _disc(x_m: float, radius_m: float) -> str:
    return _cylinder(x_m, 2 * PLATE_HALF_THICKNESS_M, PLATE_RADIUS * radius_m)


def _cylinder(x_m: float, length_m: float, radius_m: float) -> str:
    shape = f"""<origin xyz="{x_m:.6g} 0 0" rpy="0 {np.pi / 2:.9g} 0"/><geometry>
        <cylinder length="{length_m:.6g}" radius="{radius_m:.6g}"/></geometry>"""
    return f"<visual>{shape}</visual><collision>{shape}</collision>"
