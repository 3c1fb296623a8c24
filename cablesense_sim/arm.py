"""The arm file: one typed, validated description, the whole truth about an arm.

Everything else (the MuJoCo model, the equilibrium, the URDF, the estimator) is made from it.
Bounds on the numbers are those of any plausible cable-driven arm; their purpose is to catch a
wrong unit, not to judge a design. A bundled arm is found by its name, any other by its path.
"""

from __future__ import annotations

import hashlib
import json
import os
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator

from cablesense_base import Array, CableSenseError
from cablesense_base.files import read_bounded_text
from cablesense_base.installation import BundledFiles
from cablesense_base.plain_yaml import Count, FilePart, Number, read_plain
from cablesense_sim.effects.registry import checked_entry
from cablesense_sim.tolerances import Tolerances

MAX_FILE_BYTES = 200_000
"""An arm file is a page of text; anything larger is not one."""

LEAST_HOLE_DISTANCE_M = 1e-4
"""Between the centres of two guide holes of a plate: no cable is thinner."""


class ArmFileError(CableSenseError):
    """An arm file that cannot be true: names the key, its value and what would be valid."""


Length = Annotated[Number, Field(gt=0.0, le=5.0)]
Radius = Annotated[Number, Field(ge=0.001, le=1.0)]
Mass = Annotated[Number, Field(ge=0.0, le=200.0)]
Gravity = Annotated[Number, Field(ge=-30.0, le=30.0)]
_FEWEST_CABLES = 3
PerSegmentLength = Length | Annotated[list[Length], Field(min_length=1)]
PerSegmentRadius = Radius | Annotated[list[Radius], Field(min_length=1)]
PerSegmentMass = Mass | Annotated[list[Mass], Field(min_length=1)]


class Segments(FilePart):
    """The chain: `count` rigid segments on universal joints. One number, or one per segment."""

    count: Annotated[Count, Field(ge=1, le=16)]
    length_m: PerSegmentLength
    mass_kg: PerSegmentMass
    joint_axes: tuple[Literal["y"], Literal["z"]] = ("y", "z")
    plate_offset_m: Annotated[Number, Field(gt=0.0, le=1.0)]
    contact_m: PerSegmentLength
    joint_damping_n_m_s: Annotated[Number, Field(ge=0.0, le=100.0)] = 0.5


class CableAngles(FilePart):
    """Where the guide holes are: angle of cable k of segment n, from +z towards +y."""

    first: Annotated[Number, Field(ge=-360.0, le=360.0)] = 0.0
    per_segment: Annotated[Number, Field(ge=-360.0, le=360.0)]
    per_cable: Annotated[Number, Field(ge=-360.0, le=360.0)]


def _one_for_all_segments(count: Any) -> Any:
    if isinstance(count, list):
        raise ValueError(
            f"= {reprlib.repr(count)}: must be one whole number, as on all segments end as many "
            "cables; describe an arm with other numbers by a machine file (docs/machines.md)"
        )
    return count


def _enough_for_both_axes(count: int) -> int:
    if count < _FEWEST_CABLES:
        raise ValueError(
            f"= {count}: must be at least {_FEWEST_CABLES}, as cables only pull and a segment "
            "turns about two axes; describe an arm with fewer cables by a machine file "
            "(docs/machines.md)"
        )
    return count


PerSegmentCables = Annotated[
    Count,
    BeforeValidator(_one_for_all_segments),
    Field(le=16),
    AfterValidator(_enough_for_both_axes),
]


class CableSet(FilePart):
    """The cables: cable P (n - 1) + k + 1 ends on segment n and passes every joint from 1 to n.

    `stiffness_n_m` counts from command to anchor, cable and actuator in series; `axial_rigidity_n`
    is the cable's own E*A, to which the actuator's stiffness is then added in series.
    """

    per_segment: PerSegmentCables
    routing_radius_m: PerSegmentRadius
    angle_deg: CableAngles
    stiffness_n_m: Annotated[Number, Field(ge=1e2, le=1e9)] | None = None
    axial_rigidity_n: Annotated[Number, Field(ge=1e1, le=1e8)] | None = None
    pretension_n: Annotated[Number, Field(gt=0.0, le=1e5)]
    unilateral: Literal[True] = True
    run_m: Annotated[Number, Field(ge=0.0, le=20.0)]

    @model_validator(mode="after")
    def _one_elasticity(self) -> CableSet:
        if (self.stiffness_n_m is None) == (self.axial_rigidity_n is None):
            raise ValueError(
                f"gives stiffness_n_m = {self.stiffness_n_m} and axial_rigidity_n = "
                f"{self.axial_rigidity_n}; give exactly one: stiffness_n_m in N/m, or "
                "axial_rigidity_n, E*A in N (the stiffness is then E*A over a cable's own length)"
            )
        return self


class Actuators(FilePart):
    """Self-locking position actuators; `kp_n_m` of `.inf` is a rigid one."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    kind: Literal["position"]
    kp_n_m: Annotated[Number, Field(ge=1e2)]


class Sensors(FilePart):
    """Tension sensors at the actuator ends: Gaussian noise, then rounding to a step.

    `range_n` are the lowest and highest reading. A sample with a reading at either end is refused,
    as the tension may be beyond it; but zero, as the lowest, is what a slack cable reads.
    """

    place: Literal["actuator end"]
    rate_hz: Annotated[Number, Field(gt=0.0, le=10_000.0)]
    noise_std_n: Annotated[Number, Field(ge=0.0, le=1_000.0)]
    step_n: Annotated[Number, Field(ge=0.0, le=1_000.0)]
    range_n: tuple[Number, Number] | None = None

    @model_validator(mode="after")
    def _range_ascends(self) -> Sensors:
        if self.range_n is not None and self.range_n[0] >= self.range_n[1]:
            raise ValueError(
                f"gives range_n = {list(self.range_n)}; it must be [lowest, highest] in N"
            )
        return self


class Touch(FilePart):
    """How the arm is touched: tensions do not follow from it, only what estimates state.

    `radius_m` is that of the surface, from the axis, by default where the outermost cables run;
    `friction` is the Coulomb coefficient there. With a radius of zero contacts act on the axis;
    with a friction of zero they do so with any axial force.
    `reach_m` is the range on each segment that can be touched, from its joint centre; by default
    all of its length. Inside the code it is `touched_m`, one range for each segment
    (`cablesense_sim.touch`).
    """

    radius_m: Annotated[Number, Field(ge=0.0, le=1.0)] | None = None
    friction: Annotated[Number, Field(ge=0.0, le=2.0)] = 0.3
    reach_m: tuple[Number, Number] | None = None


class ListedEffect(FilePart):
    """Effects of the arm beyond the ideal: an effect's name, its place, and its parameters."""

    effect: str
    at: str = "arm"
    parameters: dict[str, Number] = Field(default_factory=dict)


class Arm(FilePart):
    """A cable-driven serial arm, as its file describes it: SI units, or degrees in `_deg`."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]
    gravity_m_s2: tuple[Gravity, Gravity, Gravity]
    segments: Segments
    cables: CableSet
    actuators: Actuators
    sensors: Sensors
    touch: Touch = Field(default_factory=Touch)
    tolerances: Tolerances = Field(default_factory=Tolerances)
    effects: list[ListedEffect] = Field(default_factory=list)

    @model_validator(mode="after")
    def _geometry_is_possible(self) -> Arm:
        count = self.segments.count
        for key, value in (
            ("segments.length_m", self.segments.length_m),
            ("segments.mass_kg", self.segments.mass_kg),
            ("segments.contact_m", self.segments.contact_m),
            ("cables.routing_radius_m", self.cables.routing_radius_m),
        ):
            if isinstance(value, list) and len(value) != count:
                raise ValueError(
                    f"{key} lists {len(value)} values; give one number or {count} (segments.count)"
                )
        lengths = of_each_segment(self.segments.length_m, count)
        contacts = of_each_segment(self.segments.contact_m, count)
        for n, (length, contact) in enumerate(zip(lengths, contacts, strict=True)):
            if length <= 2.0 * self.segments.plate_offset_m:
                raise ValueError(
                    f"segments.plate_offset_m = {self.segments.plate_offset_m} leaves no room "
                    f"between the guide plates of segment {n + 1}; it must be below half of "
                    f"length_m = {length}"
                )
            if contact > length:
                raise ValueError(
                    f"segments.contact_m = {contact} lies beyond the end of segment {n + 1}; "
                    f"it must be at most length_m = {length}"
                )
        reach = self.touch.reach_m
        if reach is not None and not 0.0 <= reach[0] < reach[1] <= min(lengths):
            raise ValueError(
                f"touch.reach_m = {list(reach)}; it must be [nearest, farthest] from the joint "
                f"centre, within the shortest segment's {min(lengths)} m"
            )
        stiffness = self.cables.stiffness_n_m
        if stiffness is not None and self.actuators.kp_n_m <= stiffness:
            raise ValueError(
                f"actuators.kp_n_m = {self.actuators.kp_n_m:g} must exceed cables.stiffness_n_m = "
                f"{stiffness:g}, which is that of cable and actuator in series"
            )
        self._check_cables_span_every_joint()
        self._check_holes_are_apart()
        try:
            for listed in self.effects:
                sizes = self.segment_count, self.cable_count
                checked_entry(listed.effect, listed.at, listed.parameters, *sizes)
        except CableSenseError as error:
            raise ValueError(f"effects: {error}") from error
        return self

    def _check_cables_span_every_joint(self) -> None:
        """Cables only pull: around a segment no half-turn may be free of holes."""
        per_cable = self.cables.angle_deg.per_cable
        holes = sorted((k * per_cable) % 360.0 for k in range(self.cables.per_segment))
        gaps = [b - a for a, b in zip(holes, [*holes[1:], holes[0] + 360.0], strict=True)]
        if max(gaps) >= 180.0 - 1e-9:
            raise ValueError(
                f"cables.angle_deg.per_cable = {per_cable} leaves {max(gaps):.0f} degrees of a "
                "segment without a cable; cables only pull, so every gap must be below 180 degrees"
            )

    def _check_holes_are_apart(self) -> None:
        """All cables pass the plates at joint 1, each in a separate hole."""
        radius, angle = self.holes
        places = np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=-1)
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        near = np.argwhere(np.triu(apart < LEAST_HOLE_DISTANCE_M, 1))
        if len(near):
            (i, j) = near[0]
            segment_cables = self.cables.per_segment
            raise ValueError(
                f"cables.angle_deg puts cable_{i + 1} and cable_{j + 1} into one hole, "
                f"{radius[i]:g} m from the axis at {np.rad2deg(angle[i]) % 360.0:g} "
                f"degrees; {segment_cables} cables on each of {self.segments.count} segments are "
                f"apart, for example, with per_cable = {-360.0 / segment_cables:g}, per_segment = "
                f"{360.0 / len(places):g}"
            )

    @property
    def holes(self) -> tuple[Array, Array]:
        """Each cable's holes in the plates: (M,) m from the axis and (M,) rad from +z to +y."""
        segment, cable = np.divmod(np.arange(self.cable_count), self.cables.per_segment)
        radius = np.array(of_each_segment(self.cables.routing_radius_m, self.segments.count))
        angles = self.cables.angle_deg
        degrees = angles.first + angles.per_segment * segment + angles.per_cable * cable
        return radius[segment], np.deg2rad(degrees)

    @property
    def segment_count(self) -> int:
        """Number of segments N."""
        return self.segments.count

    @property
    def cable_count(self) -> int:
        """Number of cables M."""
        return self.segments.count * self.cables.per_segment

    @property
    def joint_count(self) -> int:
        """Number of joint angles 2N."""
        return 2 * self.segments.count

    @property
    def cable_names(self) -> tuple[str, ...]:
        """`cable_1` … `cable_M`, the order of every tension array."""
        return tuple(f"cable_{i + 1}" for i in range(self.cable_count))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """`joint_1_pitch`, `joint_1_yaw`, …, the order of every joint-angle array."""
        return tuple(
            f"joint_{n + 1}_{axis}" for n in range(self.segment_count) for axis in ("pitch", "yaw")
        )

    @property
    def nominal(self) -> Arm:
        """The arm as it was drawn, without effects."""
        return self.model_copy(update={"effects": []}) if self.effects else self

    @property
    def identity(self) -> str:
        """Name and the first 12 hex digits of the SHA-256 of what its tensions follow from.

        By it a model or a calibration is known to be of this arm. Every key of an arm file counts
        but those that are left out here: a new key makes all models and calibrations of all arms
        unfit, unless it says nothing of tensions and is left out, too.
        """
        content = self.model_dump(mode="json", exclude={"touch", "tolerances"})
        text = json.dumps(content, sort_keys=True)
        return f"{self.name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def of_each_segment(value: float | Sequence[float], count: int) -> list[float]:
    """One number for all segments, or a list of one each, as a list of `count` numbers."""
    return [float(value)] * count if isinstance(value, int | float) else [float(v) for v in value]


def load_arm(path: str | Path) -> Arm:
    """Read an arm file.

    Raises:
        ArmFileError: the file cannot be read, is not YAML, has an unknown key or a value that
            cannot be true.
    """
    text = read_bounded_text(path, MAX_FILE_BYTES, "an arm file", ArmFileError)
    return parse_arm(text, source=str(path))


def parse_arm(text: str, source: str = "arm description") -> Arm:
    """Read an arm from YAML text; `source` names it in errors.

    Raises:
        ArmFileError: as `load_arm`.
    """
    return read_plain(text, source, Arm, ArmFileError)


_BUNDLED = BundledFiles("arm", "arms", (".yaml", ".yml"), ArmFileError)


bundled_arms = _BUNDLED.names
"""Names of the bundled arms, for example `cdsm`."""

_OTHER_MODELS = (".xml", ".mjcf", ".urdf")
"""Endings of files that describe other machines."""


def find_arm(name_or_path: str | Path) -> Path:
    """The arm file that a name (`cdsm`) or a path (`my/arm.yaml`) means.

    Raises:
        ArmFileError: neither a bundled name nor an arm file; of a model of another machine the
            message says which commands take that.
    """
    path = Path(name_or_path)
    if path.suffix.lower() in _OTHER_MODELS and os.path.isfile(path):  # noqa: PTH113
        raise ArmFileError(
            f"{path}: is a model of any machine, and no arm file: cablesense gap diagnose, adapt, "
            "predict, protocol and watch take it as --model; all else takes a machine file, which "
            f"`cablesense machine {path}` writes, or an arm file (cablesense info --template)"
        )
    return _BUNDLED.find(name_or_path)


def open_arm(name_or_path: str | Path) -> Arm:
    """Find and read an arm.

    Raises:
        ArmFileError: as `find_arm` and `load_arm`.
    """
    return load_arm(find_arm(name_or_path))
