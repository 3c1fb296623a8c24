"""A machine that MuJoCo describes, as the page shows it."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from cablesense_base import Array
from cablesense_contact.felt import LinksAtPose
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_msgs_py.messages import Load, read_load
from cablesense_msgs_py.topics import Frames
from cablesense_online.page.headline import Words
from cablesense_online.page.model_drawing import model_extent, model_solids, tendon_pieces
from cablesense_online.page.shown import STEP_DEG, CommandSlider, DrawnPose, Label, ReadingPanel
from cablesense_online.page.snapshot import PlaceInterval
from cablesense_online.placed_links import PlacedLinks
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine

_MOST_LABELS = 9
"""More names of links would cover the machine."""
_FREE_RANGE_RAD = math.radians(20.0)
"""Range of a slider to both sides of home, where the model limits no hinge."""
_WIDEST_RAD = math.radians(45.0)
"""The same where it limits one: further away tendons of many machines go slack."""
_FREE_RANGE_M = 0.002
"""The same of a slide, or of a length that an actuator is commanded."""
_STEP_MM = 0.01
"""Of the sliders of lengths."""
_MM = 1e3
"""In a metre."""
_TENSION_SHARE = 1.25
"""Full scale of tensions, at least, over the largest pretension."""
_TORQUE_SCALE_N_M = 1.0
"""Full scale of torques, at least."""


class ShownModel:
    """A machine on the page: a `shown.ShownMachine` whose bodies are those of the model."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._model = machine.model
        self._data = mujoco.MjData(machine.model)
        self._lock = threading.Lock()
        self.felt = FeltModel(machine)
        self._placed = PlacedLinks(self.felt.link_frames)
        links = machine.links
        self.words = Words("machine", "link", links.names)
        self.sliders = tuple(_sliders(machine))
        self.panels = tuple(_panels(machine))
        self.strongest_n: float = machine.source.file.touch.largest_n
        self.touched_m: Array = links.touched_m
        self.unobstructed_m: Array = links.touched_m
        self.usual_m: Array = links.touched_m.mean(axis=1)
        names = [machine.model.body(b).name or f"body_{b}" for b in range(machine.model.nbody)]
        self.bodies = tuple(f"/machine/{number}_{name}" for number, name in enumerate(names))
        self.solids = tuple(model_solids(machine))
        self._pieces = tendon_pieces(machine)
        self.piece_channel = self._pieces.channel
        drawn = self.drawn_at(machine.reference)
        self.extent = model_extent(self.solids, drawn)
        thinnest_m = 0.01 * self.extent.size_m
        self.surface_m = np.maximum(links.radius_m, thinnest_m)
        self.labels = tuple(_labels(machine, self.surface_m))

    def pose_of(self, command: Array) -> Array:
        """(n,) the commanded one; the reference where actuators are commanded."""
        if self._machine.source.file.joints == "actuators":
            return self._machine.reference
        return command

    def command_near(self, turn_rad: Array) -> Array:
        """(C,) with hinges turned by such angles (n,) from the reference pose."""
        machine = self._machine
        turned = np.where(machine.coordinates.is_hinge, turn_rad, 0.0)
        return Holding(machine).command_of(machine.reference + turned)

    def drawn_at(self, pose: Array) -> DrawnPose:
        """The machine at coordinates (n,)."""
        with self._lock:
            data = self._data
            data.qpos[:] = self._machine.coordinates.positions(pose)
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            mujoco.mj_tendon(self._model, data)
            return DrawnPose(
                body_m=data.xpos.copy(),
                body_axes=data.xmat.reshape(-1, 3, 3).copy(),
                piece_m=self._pieces.at(data),
                links=self.felt.links_at(pose),
            )

    def links_at(self, pose: Array) -> LinksAtPose:
        """The links at coordinates (n,)."""
        with self._lock:
            return self.felt.links_at(pose)

    def checked_command(self, command: Array) -> Array:
        """A command (C,) of finite numbers.

        Raises:
            MachineError: one is not, or is beyond what commands state.
        """
        largest = self.felt.largest_command
        for name, value in zip(self.felt.command_names, command, strict=True):
            if not abs(value) <= largest:
                raise MachineError(
                    f"the command of {name} is {value:g}; it must be finite and within "
                    f"±{largest:g}"
                )
        return command

    def read_load(self, message: Any, frames: Frames, pose: Array) -> Load:
        """The load of a message in a link's frame, with a torque where it states a place.

        Raises:
            CableSenseError: see `messages.read_load` and `PlacedLinks.load_place_m`.
        """

        def place_of(link: int, force_n: Array, torque_n_m: Array) -> float:
            return self._placed.load_place_m(link, self.links_at(pose), force_n, torque_n_m)

        return read_load(message, frames, place_of=place_of)

    def load_frame(self, load: Load, frames: Frames, pose: Array) -> tuple[str, Array]:
        """The link's frame, and the torque about its origin where the load states a place."""
        frame = frames.segment(load.segment)
        if load.contact_m is None:
            return frame, np.zeros(3)
        links = self.links_at(pose)
        force_n = load.force_base_n
        return frame, self._placed.load_torque(load.segment, links, force_n, load.contact_m)

    def covered(self, link: int, low_m: float, high_m: float) -> tuple[PlaceInterval, ...]:
        """What lies on the link itself: what is beyond its ends may be several links."""
        first_m, last_m = self.touched_m[link - 1].tolist()
        part = PlaceInterval(
            link, min(max(low_m, first_m), last_m), min(max(high_m, first_m), last_m)
        )
        return (part,)


def _sliders(machine: Machine) -> Iterator[CommandSlider]:
    first = Holding(machine).command_of(machine.reference)
    if machine.source.file.joints == "actuators":
        numbers = machine.tendons.drawn_by
        gears = machine.tendons.gear[numbers >= 0]
        for name, home, gear in zip(machine.command_names, first, gears, strict=True):
            # a servo's control is its gear times a length
            per_unit = _MM / float(gear)
            yield _slider(f"{name}, mm", float(home), _FREE_RANGE_M * float(gear), per_unit)
        return
    coordinates = machine.coordinates
    model = machine.model
    for number, joint in enumerate(coordinates.joints.tolist()):
        name = coordinates.names[number]
        home = float(first[number])
        is_hinge = bool(coordinates.is_hinge[number])
        reach = _FREE_RANGE_RAD if is_hinge else _FREE_RANGE_M
        limits = None
        if model.jnt_limited[joint]:
            lowest, highest = model.jnt_range[joint].tolist()
            limits = (lowest, highest)
            reach = _WIDEST_RAD if is_hinge else max(highest - home, home - lowest)
        unit = "°" if is_hinge else "mm"
        per_unit = math.degrees(1.0) if is_hinge else _MM
        yield _slider(f"{name}, {unit}", home, reach, per_unit, limits)


def _slider(
    label: str,
    home: float,
    reach: float,
    per_unit: float,
    limits: tuple[float, float] | None = None,
) -> CommandSlider:
    """Of a number from `reach` below home to `reach` above it, in its command's unit."""
    step = STEP_DEG if label.endswith("°") else _STEP_MM
    lowest = home - reach
    highest = home + reach
    if limits is not None:
        lowest = max(lowest, limits[0])
        highest = min(highest, limits[1])
    return CommandSlider(
        label=label,
        lowest=round(step * math.ceil(per_unit * lowest / step), 2),
        highest=round(step * math.floor(per_unit * highest / step), 2),
        step=step,
        home=round(per_unit * home, 2),
        per_unit=per_unit,
    )


def _panels(machine: Machine) -> Iterator[ReadingPanel]:
    channels = machine.channels
    tensions = [n for n, tendon in enumerate(channels.tendon.tolist()) if tendon >= 0]
    if tensions:
        read = channels.tendon[tensions]
        yield ReadingPanel(
            quantity="tension",
            unit="N",
            channels=tuple(tensions),
            names=tuple(channels.names[n] for n in tensions),
            groups=tuple(_body_at_end(machine, int(tendon)) for tendon in read),
            order="by the body that a tendon ends on",
            least=_TENSION_SHARE * float(machine.tendons.pretension_n[read].max()),
        )
    for unit in sorted(set(channels.units)):
        drives = [
            n for n, other in enumerate(channels.units) if other == unit and channels.tendon[n] < 0
        ]
        if drives:
            yield ReadingPanel(
                quantity="torque" if unit == "N·m" else "force",
                unit=unit,
                channels=tuple(drives),
                names=tuple(channels.names[n] for n in drives),
                groups=("joints",) * len(drives),
                order="of the drives of joints",
                least=_TORQUE_SCALE_N_M,
                signed=True,
            )


def _body_at_end(machine: Machine, tendon: int) -> str:
    """The body of a tendon's last site, or nothing of a tendon without a path in space."""
    model = machine.model
    number = int(machine.tendons.ids[tendon])
    last = int(model.tendon_adr[number] + model.tendon_num[number]) - 1
    if model.wrap_type[last] != mujoco.mjtWrap.mjWRAP_SITE:
        return "tendons"
    body = int(model.site_bodyid[int(model.wrap_objid[last])])
    return model.body(body).name or f"body {body}"


def _labels(machine: Machine, surface_m: Array) -> Iterator[Label]:
    links = machine.links
    every = math.ceil(len(links.names) / _MOST_LABELS)
    for n, name in enumerate(links.names):
        if (n + 1) % every:
            continue
        middle_m = float(links.touched_m[n].mean())
        axes = links.axes[n]
        place = links.origin_m[n] + middle_m * axes[:, 0] + 1.9 * surface_m[n] * axes[:, 1]
        x, y, z = place.tolist()
        yield Label(name, int(links.bodies[n]), (x, y, z), "top-center")
