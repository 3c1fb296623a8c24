"""Arms as a workshop builds them: each with errors of its own, which no file states.

They are the truth for tests of estimators that know an arm by its file and its tolerances only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import astuple, dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.arm import ADDED, SCALED, RealArm, ideal_arm, turned
from cablesense_plants.arm.body import Body, Nominal
from cablesense_plants.arm.friction import Creep, PathState, PlantFriction, QuasiStaticPath
from cablesense_plants.arm.statics import BodyRest, commanded_angles_rad, find_rest, frames, turns
from cablesense_plants.cases import PlantError

_STEP_RAD = np.deg2rad(0.25)
_STEP_SHARE = 0.05
"""Of the pretension, by which pushes change in one step of a walk.

With these steps and friction of 0.15, the laboratory arm's tensions are within 0.1 N of those with
steps a quarter as large.
"""
_CORNERS = np.concatenate([np.zeros((1, 3)), np.eye(3)])
"""The points of a segment at which pushes are applied, in lengths of the segment."""


@dataclass(frozen=True)
class Workmanship:
    """How well arms are built: standard deviations of normal, independent errors.

    The defaults are those of an arm that is built well.

    Attributes:
        cable_stiffness_share: of each cable's stiffness.
        pretension_n: of each cable.
        segment_mass_share: of each segment's mass.
        centre_of_mass_m: of each segment, in each of its three axes.
        base_tilt_deg: by which the base is turned, about any horizontal axis.
        hole_radial_m: of each hole, away from the axis. A cable has one hole in the base plate,
            and one in each segment, whose two plates were drilled together.
        hole_around_m: of each hole, around the axis, as length of arc.
        segment_length_m: of each segment, from joint centre to joint centre.
        sensor_gain_share: of each channel.
        sensor_zero_n: of each channel.
        joint_zero_deg: of each joint angle, between the command and what the actuators hold.
    """

    cable_stiffness_share: float = 0.05
    pretension_n: float = 1.0
    segment_mass_share: float = 0.02
    centre_of_mass_m: float = 0.001
    base_tilt_deg: float = 0.5
    hole_radial_m: float = 1e-4
    hole_around_m: float = 1e-4
    segment_length_m: float = 1e-4
    sensor_gain_share: float = 0.005
    sensor_zero_n: float = 0.5
    joint_zero_deg: float = 0.2

    def scaled(self, factor: float) -> Workmanship:
        """All deviations `factor` times as large.

        The same random numbers then make the same errors, `factor` times as large.
        """
        return Workmanship(*(factor * deviation for deviation in astuple(self)))


@dataclass(frozen=True)
class Push:
    """One contact: a force that keeps its direction while the arm gives way.

    Attributes:
        segment: from 1.
        place_m: from the segment's joint centre along its axis; may lie beyond both ends.
        force_n: (3,) of the environment on the arm, base axes.
        at_side_m: (3,) from the axis to the touched point, in the segment's axes. Its x is
            ignored. None is on the axis.
    """

    segment: int
    place_m: float
    force_n: Array
    at_side_m: Array | None = None

    @property
    def at_m(self) -> Array:
        """(3,) the touched point, from the joint centre, in the segment's axes."""
        if self.at_side_m is None:
            return np.array([self.place_m, 0.0, 0.0])
        return np.array([self.place_m, self.at_side_m[1], self.at_side_m[2]])


class BuiltArm:
    """An arm of N segments and M cables, with errors that are drawn once.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        body: as it was built.
        gains: (M,) of the sensors.
        zeros_n: (M,) of the sensors.
        joint_zero_rad: (2N,) what the actuators hold, less the command.
        friction: of its cables on their guides, and on a pulley behind the sensor.
    """

    def __init__(
        self,
        nominal: Nominal,
        workmanship: Workmanship,
        rng: np.random.Generator,
        *,
        friction: float = 0.0,
        pulley_rad: float = 1.0,
    ) -> None:
        """Draw the errors.

        `friction` is the coefficient of all cables, `pulley_rad` the wrap on their pulleys; only
        a `walk` meets them.

        Raises:
            PlantError: the deviations are so large that no such arm exists.
        """
        self.nominal = nominal
        self.body = _built_body(nominal, workmanship, rng)
        cables = nominal.cable_count
        self.gains = 1.0 + workmanship.sensor_gain_share * rng.standard_normal(cables)
        self.zeros_n = workmanship.sensor_zero_n * rng.standard_normal(cables)
        joint_zero_rad = np.deg2rad(workmanship.joint_zero_deg)
        self.joint_zero_rad = joint_zero_rad * rng.standard_normal(2 * nominal.segment_count)
        self.friction = PlantFriction(np.full(cables, friction), pulley_rad=pulley_rad)
        self._drawn = ideal_arm(nominal)
        self._cornered = replace(
            self.body, contact_at_m=_CORNERS[:, None] * nominal.length_m[:, None]
        )

    def altered(self, change: Callable[[Body], Body]) -> BuiltArm:
        """The same arm with something about its body changed that no workshop's scatter makes."""
        arm = copy(self)
        arm.body = change(self.body)
        arm._cornered = change(self._cornered)
        return arm

    def held_m(self, command_rad: Array) -> Array:
        """(B, M) cable that the actuators pay out at commands (B, 2N), less the straight arm's."""
        return self._drawn.held_m(command_rad + self.joint_zero_rad)

    def corner_loads_n(self, pushes: Sequence[Push]) -> Array:
        """(4N, 3) pushes as forces at fixed points of the segments, however these turn.

        The four points of a segment are its joint centre, and a length away from it along each
        axis. Any point is a weighted mean of them, so each gets its weight's share of the force:
        the law of the lever in three dimensions.

        Raises:
            PlantError: a push is on no segment of this arm.
        """
        count = self.nominal.segment_count
        loads_n = np.zeros((4, count, 3))
        for push in pushes:
            if not 1 <= push.segment <= count:
                raise PlantError(f"a push on segment {push.segment}; the arm has 1 to {count}")
            segment = push.segment - 1
            shares = push.at_m / self.nominal.length_m[segment]
            weights = np.append(1.0 - shares.sum(), shares)
            loads_n[:, segment] += np.outer(weights, push.force_n)
        return loads_n.reshape(-1, 3)

    def rests(self, command_rad: Array, pushes: Sequence[Sequence[Push]]) -> BodyRest:
        """Rests of B commands (B, 2N), each under its own pushes, without friction.

        They are sought from the commanded angles. Where slack cables leave two rests, a `walk`
        without friction tells which one a growing push leads to.

        Raises:
            PlantError: commands without rest.
        """
        loads_n = np.array([self.corner_loads_n(row) for row in pushes])
        start_rad = commanded_angles_rad(self.body, command_rad + self.joint_zero_rad)
        return find_rest(self._cornered, start_rad, self.held_m(command_rad), loads_n)

    def tensions_n(self, command_rad: Array, pushes: Sequence[Push] = ()) -> Array:
        """(M,) at rest under a command (2N,) and pushes, without friction.

        Raises:
            PlantError: the arm finds no rest.
        """
        return self.rests(command_rad[None], [pushes]).tensions_n[0]

    def read(self, tensions_n: Array, rng: np.random.Generator) -> Array:
        """Readings of tensions (..., M): gain and zero, then noise and whole steps."""
        return self.nominal.read_n(self.gains * tensions_n + self.zeros_n, rng)

    def axes(self, command_rad: Array) -> Array:
        """(N, 3, 3) the segments' axes at the commanded angles (2N,), as columns in base axes."""
        angles_rad = commanded_angles_rad(self.body, command_rad[None])
        placed = frames(self.body, angles_rad, turns(self.body, angles_rad))
        return placed.rotation[0, self.body.driven]

    def path(self) -> QuasiStaticPath:
        """Takes this arm with its friction from rest to rest, under `corner_loads_n`."""
        return QuasiStaticPath(self._cornered, self.friction, Creep(), self.nominal.run_m)

    def walk(self, command_rad: Array) -> Walk:
        """A walk with friction, which begins unloaded at a command (2N,), before any sliding.

        Raises:
            PlantError: the arm finds no rest.
        """
        return Walk(self, command_rad)


def built_as(nominal: Nominal, workmanship: Workmanship, rng: np.random.Generator) -> RealArm:
    """A built arm without friction, to hide changes in and to record.

    Raises:
        PlantError: the deviations are so large that no such arm exists.
    """
    built = BuiltArm(nominal, workmanship, rng)
    scaled = (SCALED, lambda signal_n, _time_s: built.gains * signal_n)
    zeroed = (ADDED, lambda signal_n, _time_s: signal_n + built.zeros_n)
    return replace(
        ideal_arm(nominal),
        body=built.body,
        sensing=(scaled, zeroed),
        joint_zero_rad=built.joint_zero_rad,
    )


class Walk:
    """An arm with friction on its way from rest to rest, where each rest depends on the last.

    Attributes:
        arm: whose walk it is.
        command_rad: (2N,) the present one.
        state: of the arm and its guides.
    """

    def __init__(self, arm: BuiltArm, command_rad: Array) -> None:
        """Begin unloaded at a command (2N,)."""
        self.arm = arm
        self.command_rad = command_rad
        self._path = arm.path()
        (held_m,) = arm.held_m(command_rad[None])
        self.state: PathState = self._path.start(
            command_rad + arm.joint_zero_rad, held_m, arm.corner_loads_n(())
        )

    @property
    def tensions_n(self) -> Array:
        """(M,) present tensions at the actuators, where the sensors are."""
        return self.state.sensed_n

    def go(self, command_rad: Array, pushes: Sequence[Push] = ()) -> Array:
        """Go to a command (2N,) and pushes; tensions (M,) at the actuators.

        Command and forces change evenly and together, in small steps: a push that is not among
        the new ones leaves while these come. To lift one first, go to the old command without it.

        Raises:
            PlantError: some step has no rest. The walk then stays where it was.
        """
        before_n = self.state.loads_n
        command_change_rad = command_rad - self.command_rad
        load_change_n = self.arm.corner_loads_n(pushes) - before_n
        shares = np.linspace(0.0, 1.0, self._step_count(command_change_rad, load_change_n) + 1)[1:]
        held_m = self.arm.held_m(self.command_rad + shares[:, None] * command_change_rad)
        state = self.state
        for share, row_m in zip(shares, held_m, strict=True):
            state = self._path.advance(state, row_m, before_n + share * load_change_n, 1.0)
        self.state = state
        self.command_rad = command_rad
        return self.tensions_n

    def _step_count(self, command_change_rad: Array, load_change_n: Array) -> int:
        by_command = np.abs(command_change_rad).max() / _STEP_RAD
        step_n = _STEP_SHARE * self.arm.nominal.pretension_n
        by_load = np.linalg.norm(load_change_n, axis=1).sum() / step_n
        return max(1, int(np.ceil(max(by_command, by_load))))


def _built_body(nominal: Nominal, workmanship: Workmanship, rng: np.random.Generator) -> Body:
    drawn = nominal.body
    count = nominal.segment_count
    cables = nominal.cable_count
    stiffness_error = workmanship.cable_stiffness_share * rng.standard_normal(cables)
    pretension_error_n = workmanship.pretension_n * rng.standard_normal(cables)
    mass_error = workmanship.segment_mass_share * rng.standard_normal(count)
    centre_error_m = workmanship.centre_of_mass_m * rng.standard_normal((count, 3))
    tilt_rad = np.deg2rad(workmanship.base_tilt_deg * rng.standard_normal())
    gravity_m_s2 = _tilted(drawn.gravity_m_s2, tilt_rad, rng)
    plates = (count + 1, cables)  # the base plate, then one pattern a segment
    outwards_m = workmanship.hole_radial_m * rng.standard_normal(plates)
    around_m = workmanship.hole_around_m * rng.standard_normal(plates)
    longer_m = workmanship.segment_length_m * rng.standard_normal(count)
    end_moved_m = np.array([longer_m[-1], 0.0, 0.0])
    body = replace(
        drawn,
        gravity_m_s2=gravity_m_s2,
        spacing_m=drawn.spacing_m + np.append(0.0, longer_m[:-1]),
        before_m=_displaced(drawn.before_m, outwards_m[:-1], around_m[:-1]),
        after_m=_displaced(drawn.after_m, outwards_m[1:], around_m[1:]),
        mass_kg=drawn.mass_kg * (1.0 + mass_error),
        mass_at_m=drawn.mass_at_m + centre_error_m,
        contact_at_m=drawn.contact_at_m + _moved_points_m(longer_m),
        tip_at_m=drawn.tip_at_m + end_moved_m,
        stiffness_n_m=drawn.stiffness_n_m * (1.0 + stiffness_error),
        pretension_n=drawn.pretension_n + pretension_error_n,
    )
    _require_buildable(body)
    return body


def _tilted(gravity_m_s2: Array, tilt_rad: float, rng: np.random.Generator) -> Array:
    """Gravity as a base sees it that is turned about a random horizontal axis."""
    sideways = np.cross(gravity_m_s2, rng.standard_normal(3))
    length = np.linalg.norm(sideways)
    if length == 0.0:  # weightless
        return gravity_m_s2
    across_m_s2 = np.linalg.norm(gravity_m_s2) / length * sideways
    return np.asarray(np.cos(tilt_rad) * gravity_m_s2 + np.sin(tilt_rad) * across_m_s2)


def _displaced(holes_m: Array, outwards_m: Array, around_m: Array) -> Array:
    """Holes (J, M, 3) moved away from the axis and around it, both (J, M)."""
    radius_m = np.linalg.norm(holes_m[..., 1:], axis=-1)
    moved_m = holes_m.copy()
    moved_m[..., 1:] *= (1.0 + outwards_m / radius_m)[..., None]
    return turned(moved_m, around_m / radius_m)


def _moved_points_m(longer_m: Array) -> Array:
    """(4, N, 3) by which the points of `Body.contact_at_m` move on segments longer by (N,)."""
    along_share = np.array([0.0, 0.0, 0.5, 1.0])
    moved_m = np.zeros((4, len(longer_m), 3))
    moved_m[..., 0] = np.outer(along_share, longer_m)
    return moved_m


def _require_buildable(body: Body) -> None:
    positive = {
        "stiffness": body.stiffness_n_m,
        "pretension": body.pretension_n,
        "mass": body.mass_kg,
    }
    for name, values in positive.items():
        if values.min() < 0.0:
            raise PlantError(f"an arm with a negative {name} was drawn; use a finer workmanship")
