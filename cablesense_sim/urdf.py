"""The arm as a URDF, generated for `robot_description` (RViz, robot_state_publisher).

Cables have no place in a URDF; it carries the links `base_link`, `segment_n` and the joints that
`joint_states` names.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.mechanism import Mechanism

JOINT_LIMIT_EFFORT_N_M = 1000.0
JOINT_LIMIT_VELOCITY_RAD_S = 3.0


def urdf_xml(arm: Arm) -> str:
    """The URDF text of an arm."""
    mechanism = mechanism_of(arm)
    radius = float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())
    robot = ElementTree.Element("robot", name=arm.name)
    _add_disc(ElementTree.SubElement(robot, "link", name="base_link"), 0.0, radius)
    parent, position = "base_link", mechanism.plate_offset_m
    for n in range(arm.segment_count):
        middle, child = f"segment_{n + 1}_pitched", f"segment_{n + 1}"
        limit = float(mechanism.bend_limit_rad[n])
        _add_massless(robot, middle)
        _add_joint(robot, f"joint_{n + 1}_pitch", parent, middle, position, "0 1 0", limit)
        _add_segment(robot, mechanism, n, radius)
        _add_joint(robot, f"joint_{n + 1}_yaw", middle, child, 0.0, "0 0 1", limit)
        parent, position = child, float(mechanism.segment_length_m[n])
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True)


def _add_joint(
    robot: ElementTree.Element,
    name: str,
    parent: str,
    child: str,
    x_m: float,
    axis: str,
    limit: float,
) -> None:
    joint = ElementTree.SubElement(robot, "joint", name=name, type="revolute")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=f"{x_m:.6g} 0 0", rpy="0 0 0")
    ElementTree.SubElement(joint, "axis", xyz=axis)
    ElementTree.SubElement(
        joint,
        "limit",
        lower=f"{-limit:.6g}",
        upper=f"{limit:.6g}",
        effort=f"{JOINT_LIMIT_EFFORT_N_M:g}",
        velocity=f"{JOINT_LIMIT_VELOCITY_RAD_S:g}",
    )


def _add_massless(robot: ElementTree.Element, name: str) -> None:
    _add_inertia(ElementTree.SubElement(robot, "link", name=name), 1e-6, 0.0, (1e-9, 1e-9))


def _add_segment(
    robot: ElementTree.Element, mechanism: Mechanism, n: int, radius_m: float
) -> None:
    link = ElementTree.SubElement(robot, "link", name=f"segment_{n + 1}")
    length, mass = float(mechanism.segment_length_m[n]), float(mechanism.mass_kg[n])
    inertia = (0.5 * mass * radius_m**2, mass * (3.0 * radius_m**2 + length**2) / 12.0)
    _add_inertia(link, mass, float(mechanism.centre_of_mass_m[n]), inertia)
    _add_cylinder(link, 0.5 * length, length, 0.12 * length)
    _add_disc(link, mechanism.plate_offset_m, radius_m)
    if n + 1 < mechanism.segment_count:
        _add_disc(link, length - mechanism.plate_offset_m, radius_m)


def _add_inertia(
    link: ElementTree.Element, mass_kg: float, x_m: float, inertia: tuple[float, float]
) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=f"{x_m:.6g} 0 0", rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=f"{mass_kg:.6g}")
    along, across = (f"{value:.6g}" for value in inertia)
    ElementTree.SubElement(
        inertial, "inertia", ixx=along, iyy=across, izz=across, ixy="0", ixz="0", iyz="0"
    )


def _add_disc(link: ElementTree.Element, x_m: float, radius_m: float) -> None:
    _add_cylinder(link, x_m, 0.003, 1.08 * radius_m)


def _add_cylinder(link: ElementTree.Element, x_m: float, length_m: float, radius_m: float) -> None:
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=f"{x_m:.6g} 0 0", rpy=f"0 {np.pi / 2:.9g} 0")
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(
        geometry, "cylinder", length=f"{length_m:.6g}", radius=f"{radius_m:.6g}"
    )
