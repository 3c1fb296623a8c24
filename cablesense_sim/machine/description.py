"""The machine file: what an MJCF or a URDF does not say of a machine that is to be felt through.

A model of MuJoCo has bodies, joints, tendons and actuators. The machine file beside it states
which of their forces are read and how well, how joints are commanded, where the machine can be
touched, and by how much it may differ from its model.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from cablesense_base import CableSenseError
from cablesense_base.files import read_bounded_bytes, read_bounded_text
from cablesense_base.plain_yaml import FilePart, Number, read_plain
from cablesense_sim.tolerances import StandardDeviations

MAX_FILE_BYTES = 200_000
"""A machine file is a page or two of text."""
_MAX_MODEL_BYTES = 50_000_000
_COMMENTS = re.compile(rb"<!--.*?-->", re.DOTALL)
_TAKEN_IN = re.compile(rb"<(?:include|model)\b[^>]*?\bfile\s*=\s*[\"']([^\"']+\.xml)[\"']")
"""Files that an MJCF includes, or attaches parts of; paths count from the folder of the first."""


class MachineError(CableSenseError):
    """A machine that cannot be used: names the file, the fault and the remedy."""


_Name = Annotated[str, Field(min_length=1, max_length=120)]
_Place = tuple[Number, Number, Number]
_Positive = Annotated[Number, Field(gt=0.0)]
_NotNegative = Annotated[Number, Field(ge=0.0)]
_Share = Annotated[Number, Field(ge=0.0, le=0.5)]


class SensorGroup(FilePart):
    """Sensors of one kind: whose forces they read, their noise, step and range.

    Attributes:
        of: names of tendons or joints in the model, in the order of the channels.
        noise_std: standard deviation of one reading, N, or N·m at a hinge.
        step: by which readings are rounded.
        range: lowest and highest reading; None where there is no limit.
    """

    of: Annotated[list[_Name], Field(min_length=1)]
    noise_std: _NotNegative
    step: _NotNegative = 0.0
    range: tuple[Number, Number] | None = None

    @model_validator(mode="after")
    def _is_possible(self) -> SensorGroup:
        if len(set(self.of)) < len(self.of):
            raise ValueError("names a tendon or joint twice; each has one sensor")
        if self.noise_std == 0.0 and self.step == 0.0:
            raise ValueError("has neither noise nor step; a sensor has one of them above zero")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"gives range = {list(self.range)}; it must be [lowest, highest]")
        return self


class Sensors(FilePart):
    """What is read.

    Attributes:
        tension: of tendons, at their actuators.
        torque: of joints: what the drive gives, as `effort` of `joint_states`.
    """

    tension: SensorGroup | None = None
    torque: SensorGroup | None = None

    @model_validator(mode="after")
    def _reads_something(self) -> Sensors:
        if self.tension is None and self.torque is None:
            raise ValueError(
                "has no sensors; state `tension:` of tendons or `torque:` of joints, with `of` "
                "and `noise_std`"
            )
        return self


USUAL_FRICTION = 0.05
"""Coefficient of tendons of steel over bearings or PTFE, at most; in sheaths it is more."""


class Cables(FilePart):
    """The tendons, where the model leaves something open.

    Attributes:
        stiffness_n_m: of all, or by name; by default that of the model: of the tendon's spring
            and of the position servo that draws it, in series.
        pretension_n: at the reference pose, of all or by name; by default what the model has
            there.
        friction_coefficient: of tendons that are read, over sites, pulleys and geoms: from none to
            this. Half of it is mean and deviation. By default what tendons over pulleys have.
        unread: tendons that nothing reads and that are springs, which is thereby known.
    """

    stiffness_n_m: _Positive | dict[_Name, _Positive] | None = None
    pretension_n: _NotNegative | dict[_Name, _NotNegative] | None = None
    friction_coefficient: Annotated[Number, Field(ge=0.0, le=1.0)] = USUAL_FRICTION
    unread: list[_Name] = Field(default_factory=list)


class TouchedLink(FilePart):
    """A link that can be touched: a piece of a straight axis in its body's frame.

    Attributes:
        link: name of the body.
        start_m, end_m: of the piece.
        radius_m: of the surface, from the axis; zero where contacts act on the axis.
    """

    link: _Name
    start_m: _Place
    end_m: _Place
    radius_m: _NotNegative = 0.0

    @model_validator(mode="after")
    def _has_an_axis(self) -> TouchedLink:
        if self.length_m < 1e-6:
            raise ValueError(
                f"gives link {self.link} no axis: start_m and end_m are the same place; for a tip "
                "state a piece of some millimetres"
            )
        return self

    @property
    def length_m(self) -> float:
        """Of the piece."""
        pairs = zip(self.start_m, self.end_m, strict=True)
        return float(sum((end - start) ** 2 for start, end in pairs)) ** 0.5


class Touch(FilePart):
    """Where and how the machine is touched.

    Attributes:
        links: in an order that later answers keep; each body at most once.
        friction: Coulomb coefficient of the surfaces; with zero contacts act on the axis with any
            axial force.
        largest_n: lateral force up to which contacts are expected.
    """

    links: Annotated[list[TouchedLink], Field(min_length=1)]
    friction: Annotated[Number, Field(ge=0.0, le=2.0)] = 0.3
    largest_n: _Positive = 200.0

    @model_validator(mode="after")
    def _each_link_once(self) -> Touch:
        names = [touched.link for touched in self.links]
        if len(set(names)) < len(names):
            raise ValueError("names a link twice; a link has one axis")
        return self


class MachineTolerances(StandardDeviations):
    """By how much a built machine may differ from its model: one standard deviation each.

    The defaults are those of a careful workshop, as those of the arm file (`Tolerances`).

    Attributes:
        stiffness_share: of each tendon.
        pretension_n: of each tendon, as set at the reference pose.
        routing_m: of each site that a tendon passes, in each direction across the tendon.
        mass_share, centre_of_mass_m: of each body, and in each direction.
        joint_stiffness_share: of each joint's spring, independent of the others.
        common_joint_stiffness_share: of all joints' springs together, as those of a rod that is
            modelled by several hinges, whose material is softer throughout.
        base_tilt_deg: of the base about each horizontal axis.
        gain_share: of each channel.
        zero_n, zero_n_m: of each channel before a tare: of forces, and of hinges' torques.
        joint_zero_deg, joint_zero_m: of each hinge's and slide's position or command.
        joint_noise_deg, joint_noise_m: of one reading of a measured joint.
        drift_per_hour: of each channel's zero since its last unloaded reading, N or N·m.
    """

    stiffness_share: _Share = 0.05
    pretension_n: _NotNegative = 1.0
    routing_m: Annotated[Number, Field(ge=0.0, le=0.02)] = 1e-4
    mass_share: _Share = 0.02
    centre_of_mass_m: Annotated[Number, Field(ge=0.0, le=0.1)] = 0.001
    joint_stiffness_share: _Share = 0.05
    common_joint_stiffness_share: _Share = 0.0
    base_tilt_deg: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.5
    gain_share: _Share = 0.005
    zero_n: _NotNegative = 0.5
    zero_n_m: _NotNegative = 0.1
    joint_zero_deg: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.2
    joint_zero_m: Annotated[Number, Field(ge=0.0, le=0.02)] = 1e-4
    joint_noise_deg: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.005
    joint_noise_m: Annotated[Number, Field(ge=0.0, le=0.02)] = 1e-5
    drift_per_hour: _NotNegative = 1.0


class MachineFile(FilePart):
    """A machine, as its file describes it: SI units, or degrees in `_deg`.

    Attributes:
        name: of the machine.
        model: path of the MJCF or URDF, from the folder of this file.
        joints: `commanded`: tendons hold the lengths of commanded joint positions.
            `measured`: joint positions are read. `actuators`: actuators are commanded, and
            tendons hold those lengths.
        reference: keyframe of the pose in which tendons are pretensioned; by default `qpos0`.
        locked: joints that are held where the reference pose has them.
        sensors, cables, touch, tolerances: parts of the machine.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]
    model: Annotated[str, Field(min_length=1, max_length=1_000)]
    joints: Literal["commanded", "measured", "actuators"] = "commanded"
    reference: _Name | None = None
    locked: list[_Name] = Field(default_factory=list)
    sensors: Sensors
    cables: Cables = Field(default_factory=Cables)
    touch: Touch
    tolerances: MachineTolerances = Field(default_factory=MachineTolerances)


@dataclass(frozen=True)
class OpenedMachine:
    """A machine file that was read, with where it lies and what identifies it.

    Attributes:
        file: what it says.
        path: of it.
        model_path: of the model.
        identity: name, and a hash of both.
    """

    file: MachineFile
    path: Path
    model_path: Path
    identity: str


def read_machine_file(path: str | Path) -> OpenedMachine:
    """Read a machine file; its model is not opened, but part of the identity.

    Raises:
        MachineError: no such file, or one that cannot be true.
    """
    path = Path(path)
    text = read_bounded_text(path, MAX_FILE_BYTES, "a machine file", MachineError)
    description = read_plain(text, str(path), MachineFile, MachineError)
    model_path = path.parent / description.model
    stated = json.dumps(description.model_dump(mode="json"), sort_keys=True).encode()
    digest = hashlib.sha256(stated + _model_content(model_path)).hexdigest()[:12]
    return OpenedMachine(
        file=description, path=path, model_path=model_path, identity=f"{description.name}-{digest}"
    )


def _model_content(path: Path) -> bytes:
    """The text of a model, followed by those of the MJCF files that it takes in."""
    pending = [path]
    read: dict[Path, bytes] = {}
    while pending:
        part = pending.pop(0)
        if part in read:
            continue
        read[part] = read_bounded_bytes(part, _MAX_MODEL_BYTES, "an MJCF or a URDF", MachineError)
        text = _COMMENTS.sub(b"", read[part])
        pending += [path.parent / name.decode() for name in _TAKEN_IN.findall(text)]
    return b"".join(read.values())


def is_machine_file(path: str | Path) -> bool:
    """Whether a file is YAML that describes a machine by a model of MuJoCo, and not an arm."""
    if Path(path).suffix not in (".yaml", ".yml"):
        return False
    try:
        text = read_bounded_text(Path(path), MAX_FILE_BYTES, "a machine file", MachineError)
    except MachineError:
        return False
    return any(line.startswith("model:") for line in text.splitlines())
