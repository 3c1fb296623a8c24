"""An arm as the plant sees it: its body as arrays, and the numbers of its arm file.

The arm file is read here and nowhere else, without the simulator's description of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.files import read_bounded_text
from cablesense_base.plain_yaml import parse_plain_mapping
from cablesense_plants.cases import NO_FAULT, PlantError

Ints = NDArray[np.int64]

_MAX_FILE_BYTES = 200_000


@dataclass(frozen=True)
class CableContact:
    """Cables that touch and push each other aside, and so lengthen, beyond an angle of one joint.

    They lengthen by ``depth_m_rad2 * max(0, toward . angles - from_rad)^2``.
    """

    joint: int
    toward: tuple[float, float]
    cables: tuple[int, ...]
    depth_m_rad2: float
    from_rad: float


@dataclass(frozen=True)
class TipSpring:
    """A spring between the end of the last segment and its surroundings.

    A tether pulls the end towards `anchor_m`; a wall (`normal` given) pushes it back along
    the normal once it is beyond the plane through `anchor_m`.
    """

    anchor_m: tuple[float, float, float]
    stiffness_n_m: float
    normal: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Body:
    """J universal joints in a chain, M cables through holes, point masses, springs.

    A joint turns its frame by ``skew * Ry(pitch) * Rz(yaw) * skew^T``. A rigid segment has one
    joint; one that bends has a second in its middle.

    Attributes:
        gravity_m_s2: (3,) base frame.
        spacing_m: (J,) from the joint before, the first from x = 0.
        before_m: (J, M, 3) hole in the plate before each joint, from its centre, frame before it.
        after_m: (J, M, 3) hole in the plate after each joint, in the frame that it turns.
        passes: (J, M) whether the cable passes the joint.
        skew: (J, 3, 3) rotation of the joint's axes.
        mass_kg: (K,) point masses.
        mass_joint: (K,) the joint whose frame carries each.
        mass_at_m: (K, 3) where in that frame.
        contact_joint: (4, N) the joints whose frames carry the points of each segment where
            forces can act: its contact point, its joint centre, its middle and its end.
        contact_at_m: (4, N, 3) where in these frames.
        tip_at_m: (3,) the arm's end in the last frame.
        stiffness_n_m: (M,) at the pretension.
        pretension_n: (M,) straight and weightless.
        driven: (N,) the commanded joints, among the J.
        spring_nm_rad: (J, 2) joints' springs, neutral at straight.
        hardening_nm_rad3: (J, 2) their cubic part.
        cogging_nm: (J, 2) amplitude of a torque periodic in the angle.
        cogging_per_turn: its periods a turn.
        exponent: the tension grows with this power of the stretch; 1 is a linear cable.
    """

    gravity_m_s2: Array
    spacing_m: Array
    before_m: Array
    after_m: Array
    passes: NDArray[np.bool_]
    skew: Array
    mass_kg: Array
    mass_joint: Ints
    mass_at_m: Array
    contact_joint: Ints
    contact_at_m: Array
    tip_at_m: Array
    stiffness_n_m: Array
    pretension_n: Array
    driven: Ints
    spring_nm_rad: Array = NO_FAULT
    hardening_nm_rad3: Array = NO_FAULT
    cogging_nm: Array = NO_FAULT
    cogging_per_turn: float = 60.0
    exponent: float = 1.0
    cable_contacts: tuple[CableContact, ...] = ()
    tip_springs: tuple[TipSpring, ...] = ()

    @property
    def inside_m(self) -> Array:
        """(J - 1, M, 3) the straight pieces of cable inside the segments between joints."""
        pieces = self.before_m[1:] - self.after_m[:-1]
        pieces[..., 0] += self.spacing_m[1:, None]
        return pieces

    @property
    def joint_count(self) -> int:
        """J."""
        return len(self.spacing_m)

    @property
    def cable_count(self) -> int:
        """M."""
        return len(self.pretension_n)


@dataclass(frozen=True)
class Nominal:
    """The arm as drawn, N segments and M cables.

    Attributes:
        body: one joint a segment, each with its mass on the axis at half length.
        length_m: (N,) joint centre to joint centre.
        contact_m: (N,) from a segment's joint centre to its contact point, on the axis.
        touched_m: (N, 2) from there to where a segment can be touched, nearest and farthest.
        per_segment: cables that end on a segment.
        radius_m: (M,) of a cable's guide holes about the axis.
        pretension_n: with the arm straight and weightless.
        run_m: from actuator to base plate.
        noise_std_n: of a reading, before it is rounded to whole steps `step_n`.
    """

    body: Body
    segment_count: int
    length_m: Array
    contact_m: Array
    touched_m: Array
    per_segment: int
    radius_m: Array
    pretension_n: float
    run_m: float
    rate_hz: float
    noise_std_n: float
    step_n: float

    @property
    def cable_count(self) -> int:
        """M."""
        return self.segment_count * self.per_segment

    @property
    def floor_n(self) -> float:
        """Root mean square error of one reading: noise, and rounding over one step."""
        return float(np.sqrt(self.noise_std_n**2 + self.step_n**2 / 12.0))

    def read_n(self, signal_n: Array, rng: np.random.Generator) -> Array:
        """Readings of signals: noise, then whole steps."""
        noisy = signal_n + self.noise_std_n * rng.standard_normal(signal_n.shape)
        return np.round(noisy / self.step_n) * self.step_n if self.step_n > 0.0 else noisy


def read_nominal(path: str | Path) -> Nominal:
    """Read the numbers of an arm file.

    Raises:
        PlantError: the file cannot be read, lacks a number, or describes another kind of arm.
    """
    try:
        text = read_bounded_text(path, _MAX_FILE_BYTES, "an arm file", PlantError)
        keys = "segments, cables, sensors, gravity_m_s2"
        return _nominal(parse_plain_mapping(text, str(path), keys, PlantError))
    except KeyError as error:
        raise PlantError(f"{path}: {error} is missing; the plant needs a complete arm") from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise PlantError(
            f"{path}: {error}; the plant builds arms like config/arms/cdsm_lab.yaml, with one "
            "number or one for each segment"
        ) from error


def _nominal(text: Any) -> Nominal:
    segments = text["segments"]
    cables = text["cables"]
    sensors = text["sensors"]
    if text.get("effects"):
        raise ValueError("effects are listed, and the plant draws its own from a nominal arm")
    count = int(segments["count"])
    per_segment = int(cables["per_segment"])
    if count < 1 or per_segment < 3:
        raise ValueError("no segment, or fewer than 3 cables each")

    def by_segment(given: Any) -> Array:
        values = np.asarray(given, dtype=float)
        if values.shape not in ((), (count,)):
            raise ValueError(f"{given} is not one number, nor {count}, one for each segment")
        return np.broadcast_to(values, count)

    joints = np.arange(count)
    segment = np.repeat(np.arange(count), per_segment)
    offset_m = float(segments["plate_offset_m"])
    run_m = float(cables["run_m"])
    length_m = by_segment(segments["length_m"])
    contact_m = by_segment(segments["contact_m"])
    radius_m = by_segment(cables["routing_radius_m"])[segment]
    pretension_n = float(cables["pretension_n"])
    if (stiffness_n_m := cables.get("stiffness_n_m")) is None:
        before_m = np.cumsum(length_m) - length_m + 2.0 * offset_m
        alone_m_n = (run_m + before_m[segment]) / float(cables["axial_rigidity_n"])
        stiffness_n_m = 1.0 / (alone_m_n + 1.0 / float(text["actuators"]["kp_n_m"]))
    touched_m = (text.get("touch") or {}).get("reach_m")
    if touched_m is None:
        touched_m = np.stack([np.full(count, offset_m), length_m], axis=1)
    turn = cables["angle_deg"]
    cable = np.tile(np.arange(per_segment), count)
    angle_deg = turn.get("first", 0.0) + turn["per_segment"] * segment + turn["per_cable"] * cable
    angle = np.deg2rad(angle_deg.astype(float))  # from +z towards +y
    holes_m = radius_m[:, None] * np.stack([0.0 * angle, np.sin(angle), np.cos(angle)], axis=-1)
    along = np.array([1.0, 0.0, 0.0])
    points_m = np.stack([contact_m, 0.0 * length_m, 0.5 * length_m, length_m])
    body = Body(
        gravity_m_s2=np.array(text["gravity_m_s2"], dtype=float).reshape(3),
        spacing_m=np.append(offset_m, length_m[:-1]),
        before_m=np.tile(holes_m - offset_m * along, (count, 1, 1)),
        after_m=np.tile(holes_m + offset_m * along, (count, 1, 1)),
        passes=joints[:, None] <= segment,
        skew=np.tile(np.eye(3), (count, 1, 1)),
        mass_kg=by_segment(segments["mass_kg"]),
        mass_joint=joints,
        mass_at_m=0.5 * length_m[:, None] * along,
        contact_joint=np.tile(joints, (4, 1)),
        contact_at_m=points_m[..., None] * along,
        tip_at_m=length_m[-1] * along,
        stiffness_n_m=np.broadcast_to(np.asarray(stiffness_n_m, dtype=float), segment.shape),
        pretension_n=np.full(len(segment), pretension_n),
        driven=joints,
    )
    return Nominal(
        body=body,
        segment_count=count,
        length_m=length_m,
        contact_m=contact_m,
        touched_m=np.broadcast_to(np.asarray(touched_m, dtype=float), (count, 2)),
        per_segment=per_segment,
        radius_m=radius_m,
        pretension_n=pretension_n,
        run_m=run_m,
        **{name: float(sensors[name]) for name in ("rate_hz", "noise_std_n", "step_n")},
    )
