"""Effects applied to a robot, and the amended model that results.

The amended model is an MJCF, with a JSON file for the effects that MJCF cannot express.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from pydantic import ValidationError

from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_base.plain_yaml import FilePart, describe_problem
from cablesense_gap.robot import effects
from cablesense_gap.robot.effects import OF_FORM, RobotEffect
from cablesense_gap.robot.model import Change, Robot, RobotError, load_robot
from cablesense_gap.simulator import Assignment, Term
from cablesense_sim.arm import ListedEffect
from cablesense_sim.effects.registry import effects_in
from cablesense_sim.mujoco_file import read_spec

AMENDED_MODEL = "amended_model.xml"
BESIDE_MODEL = "amended_model.json"
ROBOT_FILES = ("verdict.json", AMENDED_MODEL, BESIDE_MODEL, "report.html")
"""In the folder of a diagnosis."""
_MAX_BYTES = 10_000_000
"""Of a file of effects beside a model: some thousand times a usual one."""


class _Beside(FilePart):
    """Effects that act on a model in addition to its MJCF."""

    model: str
    effects: tuple[ListedEffect, ...]


@cache
def known_robot_effects() -> Mapping[str, RobotEffect]:
    """Effects by name, tolerances included: those of the folder `effects`."""
    by_name = effects_in(effects, RobotEffect)
    return MappingProxyType(dict(sorted(by_name.items())))


def changed(robot: Robot, lists: Sequence[Assignment]) -> Change:
    """The robot with effects, one list after the other, each in the order of its names.

    Numbers that a list does not give are zero. Those that add up do so where they come first.
    """
    change = robot.nominal()
    for values in _added_up(lists):
        for (name, place), numbers in sorted(_by_site(values).items()):
            effect = known_robot_effects()[name]
            place_index = effect.places(robot).index(place)
            effect.act(change, place_index, defaultdict(float, numbers))
    return change


def _added_up(lists: Sequence[Assignment]) -> list[dict[Term, float]]:
    """The lists; numbers that add up stand in the first list that has their effect at a place."""
    summed: list[dict[Term, float]] = []
    first: dict[tuple[str, str], dict[Term, float]] = {}
    for values in lists:
        own: dict[Term, float] = {}
        for term, value in values.items():
            into = own
            if known_robot_effects()[term.effect].adds_up:
                into = first.setdefault(term[:2], own)
            into[term] = into.get(term, 0.0) + value
        summed.append(own)
    return summed


def _by_site(values: Assignment) -> dict[tuple[str, str], dict[str, float]]:
    """Numbers by effect and place, then by parameter."""
    by_site: dict[tuple[str, str], dict[str, float]] = {}
    for term, value in values.items():
        by_site.setdefault(term[:2], {})[term.parameter] = float(value)
    return by_site


def write_amended(folder: Path, robot: Robot, values: Assignment, beside: Assignment) -> None:
    """Write both files: the model with `values`, and what no MJCF can say of them.

    `beside` are effects that the nominal model's JSON file lists already.

    Raises:
        RobotError: the place cannot be written to.
    """
    write_atomically(folder / AMENDED_MODEL, amended_xml(robot, _in_model(values)), RobotError)
    remaining = dict(beside)
    for term, value in values.items():
        if term not in _in_model(values):  # what is found again comes on top
            known = 0.0 if term.parameter in OF_FORM else remaining.get(term, 0.0)
            remaining[term] = known + value
    content = {
        "model": AMENDED_MODEL,
        "effects": [
            {"effect": e, "at": p, "parameters": n} for (e, p), n in _by_site(remaining).items()
        ],
    }
    write_atomically(folder / BESIDE_MODEL, json.dumps(content, indent=2) + "\n", RobotError)


def amended_xml(robot: Robot, values: Assignment) -> str:
    """The model as MJCF with the changes that it can say."""
    change = changed(robot, [values])
    nominal = robot.nominal()
    model = robot.varied(change)
    spec = read_spec(robot.path, RobotError)
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
            body.explicitinertial = True
            body.fullinertia = [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
            body.mass = model.body_mass[b]
            body.ipos = model.body_ipos[b]
            body.iquat = model.body_iquat[b]
            body.inertia = model.body_inertia[b]
    for j in range(model.njnt):
        joint = spec.joint(model.joint(j).name)
        joint.armature = change.armature[j]
        joint.frictionloss = change.friction[j]
        for name in ("damping", "stiffness"):
            coefficients = np.array(getattr(joint, name), dtype=float)
            coefficients[0] = getattr(change, name)[j]
            setattr(joint, name, coefficients)
    for a in robot.servos[change.servo_gain != 0.0].tolist():
        spec.actuators[a].gainprm = model.actuator_gainprm[a]
        spec.actuators[a].biasprm = model.actuator_biasprm[a]
    for body in spec.bodies:
        body.simple = True  # as by default, which is not written: MuJoCo 3.2 does not know it
    return str(spec.to_xml())


def load_amended(path: str | Path) -> tuple[Robot, dict[Term, float]]:
    """A model and the effects in its JSON file; in a folder, the amended model.

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
        listed = _Beside.model_validate_json(text).effects
    except ValidationError as error:
        problem = describe_problem(error, _Beside)
        raise RobotError(f"{beside}: is no list of effects ({problem}); diagnose again") from None
    for item in listed:
        effect = known_robot_effects().get(item.effect)
        if effect is None:
            known = ", ".join(known_robot_effects())
            raise RobotError(f"{beside}: effect {item.effect!r} is unknown; known: {known}")
        if item.at not in effect.places(robot):
            raise RobotError(
                f"{beside}: effect {item.effect} cannot be at {item.at!r}; valid: "
                f"{', '.join(effect.places(robot)[:8])}"
            )
    numbers = [(e, name, value) for e in listed for name, value in e.parameters.items()]
    return robot, {Term(e.effect, e.at, name): value for e, name, value in numbers}


def _in_model(values: Mapping[Term, float]) -> dict[Term, float]:
    """Those of the values that an MJCF can say."""
    return {
        term: value
        for term, value in values.items()
        if known_robot_effects()[term.effect].in_model and term.parameter not in OF_FORM
    }
