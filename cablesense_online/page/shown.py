"""A machine as the page shows it: its drawn parts, its links, its readings and its sliders.

Two kinds of machines answer this: `shown_arm.ShownArm`, an arm of an arm file, and
`shown_model.ShownModel`, a machine that MuJoCo describes. The page knows no other difference
between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.felt import FeltMachine, LinksAtPose
from cablesense_msgs_py.messages import Load
from cablesense_msgs_py.topics import Frames
from cablesense_online.page.colours import Rgb
from cablesense_online.page.headline import Words
from cablesense_online.page.snapshot import PlaceInterval

STEP_DEG = 0.5
"""Of the sliders of angles."""


@dataclass(frozen=True)
class Sphere:
    """A ball."""

    radius_m: float


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along x."""

    radius_m: float
    length_m: float


@dataclass(frozen=True)
class Mesh:
    """Triangles: their corners (V, 3), m, and the numbers of these (F, 3)."""

    vertices_m: Array
    faces: NDArray[np.int64]


@dataclass(frozen=True)
class Solid:
    """A drawn part of a body.

    Attributes:
        name: among the parts of the body.
        body: its number.
        shape: about its own origin.
        rgb: colour.
        position_m: of the shape's origin in the body's frame.
        opacity: below one it is seen through; None is opaque.
        link: that is touched by touching it, from 1; 0 is none.
    """

    name: str
    body: int
    shape: Sphere | Cylinder | Mesh
    rgb: Rgb
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    opacity: float | None = None
    link: int = 0


@dataclass(frozen=True)
class Label:
    """A text beside a body, at a place in its frame; the anchor is of the text."""

    text: str
    body: int
    position_m: tuple[float, float, float]
    anchor: Literal["bottom-center", "top-center"]


@dataclass(frozen=True)
class Extent:
    """How much room a machine takes in the scene.

    Attributes:
        look_at_m: (3,) the middle of the view.
        size_m: length of the machine, to which all drawn sizes are proportional.
        floor_m: height of the floor.
    """

    look_at_m: Array
    size_m: float
    floor_m: float


class DrawnPose(NamedTuple):
    """A machine with B bodies, P pieces of cables and N links at a pose, in base axes.

    Attributes:
        body_m: (B, 3) origins of the bodies.
        body_axes: (B, 3, 3) their frames, in columns.
        piece_m: (P, 2, 3) ends of the straight pieces of cables.
        links: the links.
    """

    body_m: Array
    body_axes: Array
    piece_m: Array
    links: LinksAtPose


@dataclass(frozen=True)
class ReadingPanel:
    """Readings of one unit, as a chart and as numbers.

    Attributes:
        quantity: `tension`, `torque` or `force`.
        unit: of them.
        channels: numbers of the machine's channels.
        names: of these.
        groups: under which heading each is listed.
        order: what the headings are, as a sentence's end.
        least: the scale's full size covers at least this.
        signed: whether readings may be negative.
    """

    quantity: str
    unit: str
    channels: tuple[int, ...]
    names: tuple[str, ...]
    groups: tuple[str, ...]
    order: str
    least: float
    signed: bool = False


@dataclass(frozen=True)
class CommandSlider:
    """One number of a command as a person sets it: value = `per_unit` · number.

    Attributes:
        label: name and unit.
        lowest, highest, step: of the value.
        home: the value at the machine's first command.
        per_unit: degrees in a radian, or the like.
    """

    label: str
    lowest: float
    highest: float
    step: float
    home: float
    per_unit: float


class ShownMachine(Protocol):
    """A machine that is `felt`, with C numbers in a command, N links, T joints, P pieces."""

    @property
    def felt(self) -> FeltMachine:
        """What estimates know of it."""
        ...

    @property
    def words(self) -> Words:
        """What it and its links are called."""
        ...

    @property
    def sliders(self) -> Sequence[CommandSlider]:
        """(C,) of its commands."""
        ...

    @property
    def panels(self) -> Sequence[ReadingPanel]:
        """One for each unit that its channels have."""
        ...

    @property
    def strongest_n(self) -> float:
        """The largest force of the sliders."""
        ...

    @property
    def touched_m(self) -> Array:
        """(N, 2) where each link can be touched, along its axis."""
        ...

    @property
    def unobstructed_m(self) -> Array:
        """(N, 2) of these, what no drawn part is in the way of."""
        ...

    @property
    def usual_m(self) -> Array:
        """(N,) where a load acts that states no place."""
        ...

    @property
    def surface_m(self) -> Array:
        """(N,) distance of the drawn surface from each link's axis."""
        ...

    @property
    def extent(self) -> Extent:
        """Its room in the scene."""
        ...

    @property
    def bodies(self) -> Sequence[str]:
        """(B,) names of the bodies in the scene, a path each."""
        ...

    @property
    def solids(self) -> Sequence[Solid]:
        """What is drawn of the bodies."""
        ...

    @property
    def labels(self) -> Sequence[Label]:
        """Texts beside the bodies."""
        ...

    @property
    def piece_channel(self) -> NDArray[np.int64]:
        """(P,) the channel that reads a piece's tension, -1 where none does."""
        ...

    def pose_of(self, command: Array) -> Array:
        """(T,) where the machine is drawn at a command (C,) as long as nothing measures it."""
        ...

    def command_near(self, turn_rad: Array) -> Array:
        """(C,) that holds it near its first pose, its T joints turned by so much."""
        ...

    def drawn_at(self, pose: Array) -> DrawnPose:
        """The machine at a pose (T,), from any thread."""
        ...

    def links_at(self, pose: Array) -> LinksAtPose:
        """Its links alone, from any thread."""
        ...

    def checked_command(self, command: Array) -> Array:
        """A command (C,) that it can take.

        Raises:
            CableSenseError: it cannot.
        """
        ...

    def read_load(self, message: Any, frames: Frames, pose: Array) -> Load:
        """The load that a message puts on it at a pose (T,).

        Raises:
            CableSenseError: see `messages.read_load`.
        """
        ...

    def load_frame(self, load: Load, frames: Frames, pose: Array) -> tuple[str, Array]:
        """The frame of a message of a load, and the torque (3,) that states its place."""
        ...

    def covered(self, link: int, low_m: float, high_m: float) -> tuple[PlaceInterval, ...]:
        """What an interval of places along a link covers of it, and of others beyond it."""
        ...
