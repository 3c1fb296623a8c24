"""What recordings of one machine hold: names of columns, of messages' entries, and of links.

Readers and checks ask a layout and never for the kind of machine: an arm of an arm file, whose
channels are numbered, or a machine that MuJoCo describes, whose channels have names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import MAX_JOINT_ANGLE_RAD, Load, read_load
from cablesense_msgs_py.topics import Frames
from cablesense_recording.channels import (
    LOAD,
    LOAD_SEGMENT,
    TRIAL,
    Kind,
    command_columns,
    tension_columns,
)
from cablesense_recording.units import ANGLE_UNITS, COMMAND_UNITS, FORCE_UNITS, READING_UNITS
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.loads import contact_of_wrench
from cablesense_sim.touch import touched_places

if TYPE_CHECKING:
    from cablesense_sim.machine.machine import Machine

Described: TypeAlias = "Arm | Machine"
"""What a recording can be of."""

LABELS = (TRIAL, LOAD_SEGMENT, *LOAD)
"""Columns of the trial and of the known load."""
_LARGEST_COMMAND = 1e3
"""rad or m, that a machine's command states: a number beyond is not meant."""
_OFF_POINT_M = 0.01
"""An arm under load is elsewhere than where it is commanded, by less than this along its axis: a
wrench so near a contact point is taken for one at it."""


class Layout(Protocol):
    """A machine with M channels, C numbers in a command, and N links."""

    @property
    def name(self) -> str:
        """Of the machine, with the word for its kind."""
        ...

    @property
    def channel_names(self) -> tuple[str, ...]:
        """(M,) in messages."""
        ...

    @property
    def command_names(self) -> tuple[str, ...]:
        """(C,) in messages."""
        ...

    @property
    def link_names(self) -> tuple[str, ...]:
        """(N,) frames of the links."""
        ...

    @property
    def command_topic(self) -> str:
        """Whose messages say where the machine is: its commands, or its measured joints."""
        ...

    @property
    def reading_units(self) -> Mapping[str, float]:
        """Units in which readings may be recorded, in SI units."""
        ...

    @property
    def command_units(self) -> Mapping[str, float]:
        """Units in which commands may be recorded, in SI units."""
        ...

    @property
    def reading_columns(self) -> list[str]:
        """(M,) labels."""
        ...

    @property
    def command_columns(self) -> list[str]:
        """(C,) labels."""
        ...

    @property
    def needs_labels(self) -> bool:
        """Whether a CSV file without trials and loads is refused."""
        ...

    @property
    def largest_command(self) -> float:
        """Commands are within ± this."""
        ...

    @property
    def loadable_m(self) -> Array:
        """(N, 2) where loads may act on the links, along their axes."""
        ...

    @property
    def default_m(self) -> str:
        """What an empty place of a load stands for, in words."""
        ...

    def is_foreign(self, column: str) -> bool:
        """Whether a column that this machine does not have shows that the file is of another."""
        ...

    def load_of(self, message: Any, command: Array | None) -> Load:
        """The load in a `WrenchStamped`, at a command (C,) where one was given.

        Raises:
            CableSenseError: the message breaks the contract.
        """
        ...


def layout_of(machine: Described) -> Layout:
    """The layout of recordings of an arm, or of a machine that MuJoCo describes."""
    return ArmLayout(machine) if isinstance(machine, Arm) else MachineLayout(machine)


class ArmLayout:
    """Channels, commands and links of an arm: `tension_1_n` …, `q1_cmd_rad` …, `segment_1` …."""

    command_topic = topics.JOINT_COMMANDS
    needs_labels = True
    largest_command = MAX_JOINT_ANGLE_RAD
    default_m = "contact_m of the arm file"
    reading_units: Mapping[str, float] = FORCE_UNITS
    command_units: Mapping[str, float] = ANGLE_UNITS

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.name = f"arm {arm.name}"
        self.channel_names = tuple(arm.cable_names)
        self.command_names = tuple(arm.joint_names)
        self.link_names = tuple(f"segment_{n + 1}" for n in range(arm.segment_count))
        self.reading_columns = tension_columns(arm.cable_count)
        self.command_columns = command_columns(arm.joint_count)

    @property
    def loadable_m(self) -> Array:
        """(N, 2) the whole segments, though an arm file's `touch.reach_m` may be narrower."""
        length_m = mechanism_of(self._arm).segment_length_m
        return np.stack([np.zeros_like(length_m), length_m], axis=1)

    def is_foreign(self, column: str) -> bool:
        """Channels are numbered, so one beyond the last is of a larger arm."""
        is_command = column.startswith("q") and column.endswith("_cmd_rad")
        return is_command or column.startswith("tension_")

    def load_of(self, message: Any, command: Array | None) -> Load:
        """The load on a segment in a `WrenchStamped`, at a command (2N,), straight where none was.

        In the base frame the torque says where the load acts.
        """
        frames = _frames(message.header.frame_id, self.link_names)
        pose_rad = np.zeros(self._arm.joint_count) if command is None else command
        mechanism = mechanism_of(self._arm)

        def contact_of(force_n: Array, torque_n_m: Array) -> tuple[int, float]:
            touched_m = touched_places(self._arm).touched_m
            return contact_of_wrench(mechanism, pose_rad, touched_m, force_n, torque_n_m)

        load = read_load(message, frames, contact_of)
        if load.contact_m is None:
            return load
        off_m = load.contact_m - mechanism.contact_m[load.segment - 1]
        if abs(off_m) > _OFF_POINT_M:
            return load
        return Load(load.segment, load.force_base_n)


class MachineLayout:
    """Channels, commands and links of a machine that MuJoCo describes, by its model's names.

    Columns are `command.JOINT`, or `position.JOINT` where joints are measured, `tension.TENDON`
    and `torque.JOINT`.
    """

    needs_labels = False
    largest_command = _LARGEST_COMMAND
    default_m = "the middle of where the link is touched"
    reading_units: Mapping[str, float] = READING_UNITS
    command_units: Mapping[str, float] = COMMAND_UNITS

    def __init__(self, machine: Machine) -> None:
        self.name = f"machine {machine.name}"
        self.channel_names = machine.channels.names
        self.command_names = machine.command_names
        self.link_names = machine.links.names
        self.loadable_m = machine.links.touched_m
        kind = Kind.POSITION if machine.is_measured else Kind.COMMAND
        self.command_topic = topics.JOINT_STATES if machine.is_measured else topics.JOINT_COMMANDS
        self.command_columns = [f"{kind.value}.{name}" for name in self.command_names]
        kinds = [Kind.TENSION if at >= 0 else Kind.TORQUE for at in machine.channels.tendon]
        self.reading_columns = [
            f"{kind.value}.{name}" for kind, name in zip(kinds, self.channel_names, strict=True)
        ]

    def is_foreign(self, column: str) -> bool:
        """Never: a file may hold more of a machine than its machine file reads."""
        del column
        return False

    def load_of(self, message: Any, command: Array | None) -> Load:
        """The load on a link in a `WrenchStamped`, which is in the frame of that link."""
        del command
        return read_load(message, _frames(message.header.frame_id, self.link_names))


def _frames(frame_id: str, link_names: Sequence[str]) -> Frames:
    """The frames of a machine's links, with the prefix that a message has before one of them."""
    known = sorted(["base_link", *link_names], key=len, reverse=True)
    named = next((name for name in known if frame_id.endswith(name)), "")
    prefix = frame_id.removesuffix(named) if named else ""
    return Frames(len(link_names), prefix, tuple(link_names))
