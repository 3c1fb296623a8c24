"""A simulated machine in real time, as the sim node runs it.

Two kinds answer this: `arm_simulation.ArmSimulation`, an arm of an arm file with its dynamics, and
`machine_simulation.MachineSimulation`, a machine that MuJoCo describes, at rest at each reading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Level, Load
from cablesense_msgs_py.topics import Frames


@dataclass(frozen=True)
class SimulationSettings:
    """What a user chooses of a simulation.

    Attributes:
        rate_hz: of readings; 0 is the machine's own.
        joint_speed_rad_s: peak speed at which joints approach a command.
        load_timeout_s: after which a load lapses; 0 is never.
        built_seed: of the errors with which the machine was built; -1 is none.
    """

    rate_hz: float
    joint_speed_rad_s: float
    load_timeout_s: float
    built_seed: int

    @property
    def built_by(self) -> str:
        """What the machine was built by, as words."""
        return "its file" if self.built_seed < 0 else f"its tolerances, seed {self.built_seed}"


class SimulationHealth(NamedTuple):
    """How a simulation does: a level, one sentence, and figures."""

    level: Level
    message: str
    values: Mapping[str, str]


class Simulation(Protocol):
    """A machine with M channels and C numbers in a command; times are of one clock, s."""

    @property
    def identity(self) -> str:
        """Of the machine's file."""
        ...

    @property
    def channel_names(self) -> Sequence[str]:
        """(M,) of the sensors."""
        ...

    @property
    def command_names(self) -> Sequence[str]:
        """(C,) in messages of commands."""
        ...

    @property
    def joint_names(self) -> Sequence[str]:
        """Of the joints whose positions are known."""
        ...

    @property
    def largest_command(self) -> float:
        """Commands are within ± this."""
        ...

    @property
    def rate_hz(self) -> float:
        """Of readings."""
        ...

    @property
    def joint_states_hz(self) -> float:
        """Positions of joints are sent no faster than this."""
        ...

    @property
    def urdf(self) -> str | None:
        """Its description for others; None where there is none."""
        ...

    @property
    def target(self) -> Array:
        """(C,) the last command."""
        ...

    @property
    def loads(self) -> Sequence[Load]:
        """Those that act."""
        ...

    def frames(self, prefix: str) -> Frames:
        """The frames in which loads are stated."""
        ...

    def go_to(self, command: Array) -> None:
        """Begin to move to a command (C,).

        Raises:
            CableSenseError: it cannot take such a command; it keeps the one it has.
        """
        ...

    def offset(self, lengths_m: Array) -> None:
        """Begin to add lengths (M,) to those of the cables.

        Raises:
            CableSenseError: its cables have no lengths of their own.
        """
        ...

    def read_load(self, message: Any, frames: Frames) -> Load:
        """The load of a message, at the present pose.

        Raises:
            CableSenseError: see `messages.read_load`.
        """
        ...

    def push(self, load: Load, now_s: float) -> None:
        """Replace the load on a link; a zero force removes it.

        Raises:
            LoadError: no such link or place.
        """
        ...

    def advance_to(self, now_s: float) -> None:
        """Move on to a time."""
        ...

    def reading(self, rng: np.random.Generator | None) -> Array:
        """(M,) what the sensors read; without noise and step without `rng`."""
        ...

    @property
    def joint_positions(self) -> Array:
        """Of the joints, as they are."""
        ...

    def health(self, now_s: float) -> SimulationHealth:
        """How it does since it was asked last."""
        ...
