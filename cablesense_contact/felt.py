"""A machine as estimates see it: its channels, links, commands, and what is uncertain about it.

Two kinds of machines answer this: `felt_arm.FeltArm`, an arm of an arm file, and
`machine.felt_model.FeltModel`, a machine that MuJoCo describes. What finds contacts, takes tares
and judges readings knows no other difference between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.law import no_unrest
from cablesense_contact.slides import Belief, Slides
from cablesense_sim.parameter_groups import GroupedParameters


class ChannelLimits(NamedTuple):
    """What the M sensors can read.

    Attributes:
        names, units: of the channels, the latter `N` or `N·m`.
        lowest, highest: (M,) readings; infinite where there is no limit.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    lowest: Array
    highest: Array


class LinksAtPose(NamedTuple):
    """The N links at a pose, with T torques at the joints.

    Attributes:
        axes: (N, 3, 3) of the links' axis frames in base axes, in columns; x is along the link.
        origin_m: (N, 3) of the axis frames, in the base frame.
        by_force_m: (N, 3, T) torques of unit forces at the origins, along the links' axes.
        by_place: (N, 3, T) their slope by the place along the link.
    """

    axes: Array
    origin_m: Array
    by_force_m: Array
    by_place: Array


class LinkFrameOffsets(NamedTuple):
    """Where the links' axis frames are in their message frames, both fixed to the link.

    `cablesense_online.placed_links` says what these frames are.

    Attributes:
        axes: (N, 3, 3) of the axis frames, in columns.
        origin_m: (N, 3) of the axis frames.
    """

    axes: Array
    origin_m: Array


class SlidesUnderLoad(Protocol):
    """Slides as readings under a load show them."""

    @property
    def slides(self) -> Slides:
        """What is known of them now."""
        ...

    def after(self, reading_n: Array) -> SlidesUnderLoad:
        """The same after one more reading (M,)."""
        ...


class KnownSlides(Protocol):
    """What is known of the slides of cables at their guides, by what has moved them."""

    @property
    def unknown(self) -> Slides:
        """The machine has moved, who knows in which direction."""
        ...

    @property
    def freed(self) -> Slides:
        """After a breath, which takes friction out of all readings."""
        ...

    def matter(self, known: Belief) -> bool:
        """Whether friction is more than a trifle in what is read."""
        ...

    def after_motion(self, from_rad: Array, to_rad: Array) -> Slides:
        """Those of the unloaded machine after a straight motion between two commands."""
        ...

    def under_load(
        self, command_rad: Array, untouched_n: Array, known: Belief, arrived: Slides | None = None
    ) -> SlidesUnderLoad:
        """Follows readings at one command, from those of the untouched machine (M,) on."""
        ...

    def rounded(self, slides: Slides) -> tuple[bytes, Slides]:
        """Slides to a coarse step, and a key of them: nearly the same ones are one."""
        ...

    def carried(self, known: Belief, slides: Slides) -> Belief:
        """What is known with these slides."""
        ...

    def by_lasting(self, slope: Array, slides: Slides) -> Array:
        """Slopes (D, P) of innovations by what lasts, without what friction carries."""
        ...

    def alone(self, known: Belief, slides: Slides) -> Array:
        """Variances of what is carried by the slides alone, in the order of the parameters."""
        ...


class FeltMachine(Protocol):
    """A machine with M channels, C numbers in a command, N links, T torques, P parameters."""

    @property
    def name(self) -> str:
        """Of the machine."""
        ...

    @property
    def identity(self) -> str:
        """What tells it from others, and from itself with another description."""
        ...

    @property
    def channels(self) -> ChannelLimits:
        """Its sensors."""
        ...

    @property
    def command_names(self) -> tuple[str, ...]:
        """(C,) names in the messages of commands, or of measured joints.

        Angles of hinges are in rad, places of slides and lengths of tendons in m. Whatever is
        called `command_rad` of a machine has these units.
        """
        ...

    @property
    def reads_joints(self) -> bool:
        """Whether its commands are measured positions of joints."""
        ...

    @property
    def torque_names(self) -> tuple[str, ...]:
        """(T,) names of the joints whose torques contacts change."""
        ...

    @property
    def largest_command(self) -> float:
        """Commands are within ± this."""
        ...

    @property
    def per_radian(self) -> float:
        """By how much commands change at most where one joint turns by a radian."""
        ...

    @property
    def first_command(self) -> Array:
        """(C,) where it is taken to be before any command."""
        ...

    @property
    def link_names(self) -> tuple[str, ...]:
        """(N,) message frames: those that messages of contacts name."""
        ...

    @property
    def link_frames(self) -> LinkFrameOffsets | None:
        """The links' axis frames in their message frames; None where they are the same."""
        ...

    @property
    def parameters(self) -> GroupedParameters:
        """What is uncertain."""
        ...

    @property
    def zeros(self) -> NDArray[np.int64]:
        """(M,) numbers, among the P parameters, of what each channel reads without a load."""
        ...

    @property
    def carried_friction(self) -> slice:
        """Where the parameters stand that are the state of friction."""
        ...

    @property
    def slides(self) -> KnownSlides:
        """How that state follows from what moves the cables."""
        ...

    @property
    def surface_friction(self) -> float:
        """Bound to axial over lateral forces; zero where contacts act on the axes."""
        ...

    @property
    def known_n(self) -> float:
        """A force counts as known where both ends of its interval are within this of it, N.

        One along a link does where its standard deviation is.
        """
        ...

    @property
    def drift_per_hour(self) -> float:
        """Of the channels' zeros, in their units."""
        ...

    @property
    def slack_below(self) -> Array:
        """(M,) readings below which an unloaded cable may be slack."""
        ...

    @property
    def contact_m(self) -> Sequence[float]:
        """(N,) a point on each link at which it is said to be touched where no place is known."""
        ...

    @property
    def middle_m(self) -> Array:
        """(N,) the middle of where each link is touched."""
        ...

    @property
    def felt_across(self) -> Array:
        """(N, 2, 2) projections of forces across the links, along y and z, to what is felt."""
        ...

    @property
    def is_one_place(self) -> NDArray[np.bool_]:
        """(N,) whether a link is touched at one place only, so that all contacts are one force."""
        ...

    @property
    def joint_m(self) -> Array:
        """(N,) where the links' axis frames are along the whole machine."""
        ...

    def mean_variance(self, count: int) -> Array:
        """(M,) variance of the mean of some readings."""
        ...

    def innovation_noise(self, command: Array, variance: Array) -> Array:
        """(D, D) covariance of innovations of readings with variances (M,) at a command."""
        ...

    def unrest(self, speed_rad_s: Array, swing_rad_s2: Array) -> Array:
        """(T, T) covariance of torques by a motion of its commands (C,)."""
        ...

    def frame_pose(self, command: Array, pose: Array) -> Array:
        """The pose in whose frames contacts are stated, of a command (C,) and a pose (T,)."""
        ...

    def links_at(self, pose: Array) -> LinksAtPose:
        """The links at such a pose."""
        ...


def alike(
    known: KnownSlides, slides: Sequence[Slides]
) -> Iterator[tuple[Slides, NDArray[np.int64]]]:
    """Slides that differ, each with the positions where it stands."""
    rows: dict[bytes, list[int]] = {}
    by_key: dict[bytes, Slides] = {}
    for row, one in enumerate(slides):
        key, rounded = known.rounded(one)
        rows.setdefault(key, []).append(row)
        by_key[key] = rounded
    for key, rounded in by_key.items():
        yield rounded, np.array(rows[key], dtype=np.int64)


def torque_covariance_at_rest(machine: FeltMachine) -> Array:
    """(T, T) covariance, (N·m)², of the torques by motion of a machine at rest."""
    return no_unrest(len(machine.torque_names))
