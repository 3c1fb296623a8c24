"""The channels of a recording: labels, kinds and units, of an arm and of a robot.

A label is the name of a column in a CSV file. Checks ask for the kind of a channel and never for
the machine that it is of.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Final

from cablesense_recording.efforts import Effort, Meaning

TIME: Final = "time_s"
TRIAL: Final = "trial"
LOAD_SEGMENT: Final = "load_segment"
LOAD: Final = ("load_x_n", "load_y_n", "load_z_n")
LOAD_AT: Final = "load_at_m"
"""Optional: where on its segment a load acts; an empty cell is the arm file's `contact_m`."""


class Kind(Enum):
    """What a channel holds; the value is the word for it in a robot's label."""

    TIME = "time"
    TRIAL = "trial"
    POSITION = "position"
    TORQUE = "torque"
    COMMAND = "command"
    LOAD = "load"
    TENSION = "tension"
    POSE = "pose"


@dataclass(frozen=True)
class Channel:
    """One channel.

    Attributes:
        label: of its column.
        kind: what it holds.
        unit: of its numbers; empty for labels and for what the model gives no unit.
        of: the joint, actuator or cable that it belongs to; empty where there is none.
        needed: whether a recording without it is refused.
    """

    label: str
    kind: Kind
    unit: str
    of: str = ""
    needed: bool = True


POSE_PLACE: Final = ("x", "y", "z")
POSE_QUATERNION: Final = ("qw", "qx", "qy", "qz")
"""What stands behind `pose.FRAME.` in the labels of a pose: metres, and a unit quaternion."""


def pose_labels(frame: str) -> list[str]:
    """Labels of the place and the quaternion of a frame, seven in all."""
    return [f"{Kind.POSE.value}.{frame}.{part}" for part in (*POSE_PLACE, *POSE_QUATERNION)]


def command_columns(joint_count: int) -> list[str]:
    """`q1_cmd_rad` … for 2N joint angles, pitch then yaw of each joint, base first."""
    return [f"q{i + 1}_cmd_rad" for i in range(joint_count)]


def tension_columns(cable_count: int) -> list[str]:
    """`tension_1_n` … for M cables."""
    return [f"tension_{i + 1}_n" for i in range(cable_count)]


def arm_channels(joint_count: int, cable_count: int) -> tuple[Channel, ...]:
    """The channels of an arm with 2N joint angles and M cables, in the order of a file."""
    commands = [Channel(label, Kind.COMMAND, "rad") for label in command_columns(joint_count)]
    loads = [Channel(label, Kind.LOAD, "N") for label in LOAD]
    tensions = [
        Channel(label, Kind.TENSION, "N", f"cable_{number}")
        for number, label in enumerate(tension_columns(cable_count), start=1)
    ]
    return (
        Channel(TIME, Kind.TIME, "s"),
        Channel(TRIAL, Kind.TRIAL, ""),
        *commands,
        Channel(LOAD_SEGMENT, Kind.LOAD, ""),
        *loads,
        Channel(LOAD_AT, Kind.LOAD, "m", needed=False),
        *tensions,
    )


@dataclass(frozen=True)
class RobotChannels:
    """The channels of a robot, by the names of its model.

    Labels have the names of places, which stand in parameters and verdicts. Recordings may have
    these, or the names as the model's file spells them, with colons, points, blanks and umlauts.

    Attributes:
        model: name of the model's file, for errors.
        joints: (J,) places of the joints.
        joint_names: (J,) as the model spells them.
        actuators: (A,) names of the actuators' inputs, as the model spells them.
        position_units: (J,) rad or m.
        torque_units: (J,) N·m or N.
        limited: (J,) whether a joint has a range.
        driven: (J,) whether a drive may act on a joint; the torque of any other is rightly 0.
        efforts: (J,) what the channels of torque hold; torques where it is empty.
        frames: names of what poses may be of: bodies and sites of the model.
    """

    model: str
    joints: tuple[str, ...]
    joint_names: tuple[str, ...]
    actuators: tuple[str, ...]
    position_units: tuple[str, ...]
    torque_units: tuple[str, ...]
    limited: tuple[bool, ...]
    driven: tuple[bool, ...]
    efforts: tuple[Effort, ...] = ()
    frames: tuple[str, ...] = ()

    @cached_property
    def table(self) -> tuple[Channel, ...]:
        """All channels, in the order of a file."""
        positions = [
            Channel(f"position.{joint}", Kind.POSITION, unit, joint)
            for joint, unit in zip(self.joints, self.position_units, strict=True)
        ]
        efforts = self.efforts or (Effort(),) * len(self.joints)
        torques = [
            Channel(
                f"{effort.meaning.value}.{joint}",
                Kind.TORQUE,
                "A" if effort.meaning is Meaning.CURRENT else unit,
                joint,
                needed=False,
            )
            for joint, unit, effort in zip(self.joints, self.torque_units, efforts, strict=True)
        ]
        commands = [
            Channel(f"command.{actuator}", Kind.COMMAND, "", actuator, needed=False)
            for actuator in self.actuators
        ]
        return (
            Channel(TIME, Kind.TIME, "s"),
            Channel(TRIAL, Kind.TRIAL, "", needed=False),
            *positions,
            *torques,
            *commands,
        )

    def labels(self, kind: Kind) -> list[str]:
        """Labels of one kind, in the model's order."""
        return [channel.label for channel in self.table if channel.kind is kind]

    def label_of(self, column: str) -> str:
        """The label of a column that names its joint or actuator either way; else the same."""
        word, _, name = column.partition(".")
        numbers = self.actuator_numbers if word == Kind.COMMAND.value else self.joint_numbers
        places = self.actuators if word == Kind.COMMAND.value else self.joints
        number = numbers.get(composed(name))
        return column if number is None or not name else f"{word}.{places[number]}"

    @cached_property
    def joint_numbers(self) -> dict[str, int]:
        """The number of a joint by its place and by its name."""
        return _numbers(self.joints, self.joint_names)

    @cached_property
    def actuator_numbers(self) -> dict[str, int]:
        """The number of an actuator by its name."""
        return _numbers(self.actuators, self.actuators)


def composed(name: str) -> str:
    """A name without blanks around it, with letters as one character: `ü` is spelled two ways."""
    return unicodedata.normalize("NFC", name.strip())


def _numbers(places: Sequence[str], names: Sequence[str]) -> dict[str, int]:
    """Numbers by either spelling; a name as the model has it wins over another's place."""
    by_place = {place: number for number, place in enumerate(places)}
    by_name = {composed(name): number for number, name in enumerate(names)}
    return by_place | by_name
