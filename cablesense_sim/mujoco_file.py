"""Models that MuJoCo describes, as files: an MJCF or a URDF is read, or refused in one line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from cablesense_base import Array, CableSenseError, some_of
from cablesense_base.files import printable_path, read_bounded_text

_MAX_BYTES = 50_000_000
_URDF = re.compile(r"<robot[\s>]")
_XACRO = re.compile(r"<xacro:|=\s*[\"'][^\"'<>]*\$[{(]")
"""Its elements, or an attribute with an expression; an expanded file may keep the name space."""
_COMMENTS = re.compile(r"<!--.*?-->", re.DOTALL)
_SHAPES = re.compile(r"<(visual|collision)\b(?:[^>]*/>|.*?</\1>)", re.DOTALL)


def read_spec(path: Path, refusal: type[CableSenseError]) -> mujoco.MjSpec:
    """The model to be compiled or amended; of a URDF without its shapes, whose files may be far.

    Raises:
        CableSenseError: of the class `refusal`: no such file, or not a model.
    """
    text = read_bounded_text(path, _MAX_BYTES, "an MJCF or a URDF", refusal)
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise refusal(
            f"{printable_path(path)}: the path is no UTF-8 text, which MuJoCo needs; rename it"
        ) from None
    if _URDF.search(text) and _XACRO.search(_COMMENTS.sub("", text)):
        name = path.name.removesuffix(".xacro").removesuffix(".urdf")
        expanded = f"{name}.urdf" if path.suffix == ".xacro" else f"{name}_expanded.urdf"
        raise refusal(f"{path}: is a xacro file; expand it: xacro {path.name} > {expanded}")
    try:
        if _URDF.search(text):
            spec = mujoco.MjSpec.from_string(_SHAPES.sub("", text))
        else:
            spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise _unreadable(path, error, refusal) from error
    for number, body in enumerate(spec.bodies):
        body.simple = False  # inertias compiled as simple ones could not be changed
        body.name = body.name or f"body_{number}"
    return spec


def compiled(spec: mujoco.MjSpec, path: Path, refusal: type[CableSenseError]) -> mujoco.MjModel:
    """The model of a file that `read_spec` has read.

    Raises:
        CableSenseError: of the class `refusal`: MuJoCo cannot compile it.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise _unreadable(path, error, refusal) from error


def _unreadable(path: Path, error: ValueError, refusal: type[CableSenseError]) -> CableSenseError:
    without = _links_without_mass(path, refusal)
    if without:
        others = f", nor have {some_of(without[1:])}" if len(without) > 1 else ""
        return refusal(
            f"{path}: link {without[0]} has no <inertial> with a mass{others}; masses from shapes "
            "are not used: give one to each link that a joint moves"
        )
    line = " ".join(str(error).split())[:300]
    return refusal(f"{path}: MuJoCo cannot read this as MJCF or URDF ({line})")


def _links_without_mass(path: Path, refusal: type[CableSenseError]) -> list[str]:
    """Links of a URDF that a joint moves, and that have no mass with all that is fixed to them."""
    text = read_bounded_text(path, _MAX_BYTES, "an MJCF or a URDF", refusal)
    if not _URDF.search(text):
        return []
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return []
    massive = {link.get("name") for link in root.iter("link") if _mass_kg(link) > 0.0}
    fixed_to: dict[str | None, list[str | None]] = {}
    moved: list[str] = []
    for joint in root.findall("joint"):
        child = joint.find("child")
        parent = joint.find("parent")
        if child is None or parent is None:
            continue
        if joint.get("type") == "fixed":
            fixed_to.setdefault(parent.get("link"), []).append(child.get("link"))
        else:
            moved.append(str(child.get("link")))
    return [link for link in moved if not _weighs(link, massive, fixed_to)]


def _mass_kg(link: ElementTree.Element) -> float:
    mass = link.find("inertial/mass")
    try:
        return float(mass.get("value", "0")) if mass is not None else 0.0
    except ValueError:
        return 0.0


def _weighs(
    link: str | None, massive: set[str | None], fixed_to: dict[str | None, list[str | None]]
) -> bool:
    parts = [link]
    seen: set[str | None] = set()
    while parts:
        part = parts.pop()
        if part in massive:
            return True
        if part not in seen:
            seen.add(part)
            parts += fixed_to.get(part, [])
    return False


@dataclass(frozen=True)
class JointTie:
    """An equality that ties a joint to another, or to a place.

    Attributes:
        joint: number of the joint that follows.
        leader: number of the joint that it follows; None where it is held.
        curve: (5,) coefficients of its position, from the reference, by the leader's from its own.
        reference: positions of joint and leader from which the curve counts, rad or m.
    """

    joint: int
    leader: int | None
    curve: tuple[float, ...]
    reference: tuple[float, float]

    def followed(self, leading: Array) -> Array:
        """The joint's positions by those of its leader, of the same shape."""
        away = leading - self.reference[1]
        position = np.zeros_like(away)
        for coefficient in reversed(self.curve):  # Horner's rule; it is asked for at each pose
            position = position * away + coefficient
        return np.asarray(self.reference[0] + position)

    def slope(self, leading: float) -> float:
        """dq/dp: derivative of the joint's position q by its leader's, p, at p = `leading`."""
        away = leading - self.reference[1]
        slope = 0.0
        for power in range(len(self.curve) - 1, 0, -1):
            slope = slope * away + power * self.curve[power]
        return slope


def joint_ties(
    model: mujoco.MjModel, source: str | Path, refusal: type[CableSenseError]
) -> list[JointTie]:
    """The active equalities of joints, no two of one joint; one that is not active ties nothing.

    Raises:
        CableSenseError: of the class `refusal`, with the name `source` of the model: two of them
            tie one joint, so that where it is depends on how soft each of them is.
    """
    ties: list[JointTie] = []
    for e in range(model.neq):
        if model.eq_type[e] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[e]:
            continue
        joint = int(model.eq_obj1id[e])
        if joint in {tie.joint for tie in ties}:
            raise refusal(
                f"{source}: two equalities tie joint {model.joint(joint).name}; leave one of them "
                "in the model, or tie the other joint by it"
            )
        leader = int(model.eq_obj2id[e])
        led = leader >= 0
        reference = float(model.qpos0[joint]), float(model.qpos0[leader]) if led else 0.0
        curve = tuple(model.eq_data[e, :5].tolist())
        ties.append(JointTie(joint, leader if led else None, curve, reference))
    return ties
