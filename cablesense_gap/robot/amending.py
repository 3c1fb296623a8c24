"""The amended model: an MJCF with what MJCF can say, and a JSON beside it with all else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_gap.robot.catalogue import changed, in_model, known_effects
from cablesense_gap.robot.effects.effect import PRESLIDING, SIDE
from cablesense_gap.robot.model import Robot, RobotError, load_robot, read_spec
from cablesense_gap.simulator import Assignment, Term

AMENDED_MODEL, BESIDE_MODEL = "amended_model.xml", "amended_model.json"
"""In the folder of a diagnosis."""
_MAX_BYTES = 10_000_000


def write_amended(folder: Path, robot: Robot, values: Assignment, beside: Assignment) -> None:
    """Write both files: the model with `values`, and what no MJCF can say of them.

    `beside` are effects that the nominal model's own JSON has listed already.

    Raises:
        RobotError: the place cannot be written to.
    """
    write_atomically(folder / AMENDED_MODEL, amended_xml(robot, in_model(values)), RobotError)
    left = dict(beside)
    for term, value in values.items():
        if term not in in_model(values):  # what is found again comes on top
            known = 0.0 if term.parameter in (PRESLIDING, SIDE) else left.get(term, 0.0)
            left[term] = known + value
    listed: dict[tuple[str, str], dict[str, float]] = {}
    for term, value in left.items():
        listed.setdefault(term[:2], {})[term.parameter] = float(value)
    content = {
        "model": AMENDED_MODEL,
        "effects": [{"effect": e, "at": p, "parameters": n} for (e, p), n in listed.items()],
    }
    write_atomically(folder / BESIDE_MODEL, json.dumps(content, indent=2) + "\n", RobotError)


def amended_xml(robot: Robot, values: Assignment) -> str:
    """The model as MJCF with the changes that it can say."""
    change, nominal = changed(robot, [values]), robot.nominal()
    model = robot.varied(change)
    spec = read_spec(robot.path)
    folder = robot.path.parent.resolve()
    if spec.meshes or spec.textures:  # the amended model lies in another folder
        spec.meshdir, spec.texturedir = (str(folder / d) for d in (spec.meshdir, spec.texturedir))
    spec.option.gravity = change.gravity_m_s2
    bodies = {body.name: body for body in spec.bodies}  # a URDF's fixed links have no number
    for k, b in enumerate(robot.body_ids):
        moved = any(
            not np.array_equal(getattr(change, name)[k], getattr(nominal, name)[k])
            for name in ("mass_kg", "centre_m", "inertia_kg_m2")
        )
        if moved:
            body = bodies[model.body(b).name]
            body.explicitinertial, body.fullinertia = True, [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
            body.mass, body.ipos = model.body_mass[b], model.body_ipos[b]
            body.iquat, body.inertia = model.body_iquat[b], model.body_inertia[b]
    for j in range(model.njnt):
        joint = spec.joint(model.joint(j).name)
        joint.armature, joint.frictionloss = change.armature[j], change.friction[j]
        for name in ("damping", "stiffness"):
            own = np.array(getattr(joint, name), dtype=float)
            own[0] = getattr(change, name)[j]
            setattr(joint, name, own)
    return str(spec.to_xml())


def load_amended(path: str | Path) -> tuple[Robot, dict[Term, float]]:
    """A model with the effects of the JSON beside it; of a folder the amended model in it.

    Raises:
        RobotError: as `load_robot`; a JSON that is none, or lists what cannot be.
    """
    path = Path(path)
    if path.is_dir():
        path = path / AMENDED_MODEL
    robot = load_robot(path)
    beside = path.with_suffix(".json")
    if path.name != AMENDED_MODEL or not beside.is_file():
        return robot, {}
    text = read_bounded_text(beside, _MAX_BYTES, "effects beside a model", RobotError)
    try:
        listed = json.loads(text)["effects"]
        values = {
            Term(each["effect"], each["at"], name): float(value)
            for each in listed
            for name, value in each["parameters"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RobotError(f"{beside}: is no list of effects ({error}); diagnose again") from error
    return robot, _checked(beside, robot, values)


def _checked(path: Path, robot: Robot, values: Mapping[Term, float]) -> dict[Term, float]:
    for term, value in values.items():
        effect = known_effects().get(term.effect)
        if effect is None:
            raise RobotError(
                f"{path}: effect {term.effect!r} is unknown; known: {', '.join(known_effects())}"
            )
        if term.place not in effect.places(robot):
            raise RobotError(
                f"{path}: effect {term.effect} cannot be at {term.place!r}; valid: "
                f"{', '.join(effect.places(robot)[:8])}"
            )
        if not np.isfinite(value):
            raise RobotError(f"{path}: {term} must be a finite number")
    return dict(values)
