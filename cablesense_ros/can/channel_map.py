"""The channel map: which signal of a DBC file is which cable, and what may be believed of it.

Bounds on the numbers are those of any plausible amplifier; their purpose is to catch a wrong unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from cablesense_msgs_py.errors import CableSenseError

MAX_CHANNELS = 256


class ChannelMapError(CableSenseError):
    """A channel map, DBC or calibration file that does not fit: says which, where, what would."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _not_a_boolean(value: Any) -> Any:
    """Python counts `true` as 1; a person who writes it has put it under the wrong key."""
    if isinstance(value, bool):
        raise ValueError(f"= {value}: must be a number")
    return value


Number = Annotated[float, BeforeValidator(_not_a_boolean)]
Count = Annotated[int, BeforeValidator(_not_a_boolean)]
Mask = Annotated[Count, Field(ge=0, le=0xFFFF)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,127}$")]
"""A DBC identifier."""
Scale = Annotated[Number, Field(ge=-1e9, le=1e9)]
Zero = Annotated[Number, Field(ge=-1e12, le=1e12)]


class Channel(_Part):
    """One cable's signal: `tension_n = scale_n_per_unit * (value - zero)`.

    `value` and `zero` are in the unit that the DBC file gives the signal. `status` names a signal
    of the same message, which `status_masks` of the map read.
    """

    message: Name
    signal: Name
    status: Name | None = None
    scale_n_per_unit: Scale = 1.0
    zero: Zero = 0.0

    @model_validator(mode="after")
    def _scale_is_not_zero(self) -> Channel:
        if self.scale_n_per_unit == 0.0:
            raise ValueError(
                "gives scale_n_per_unit = 0, so that every reading is 0 N; it must be the newtons "
                "of one unit of the signal (negative if it falls under tension)"
            )
        return self

    def tension_n(self, value: float) -> float:
        """The tension in N of a signal's value."""
        return self.scale_n_per_unit * (value - self.zero)

    def value(self, tension_n: float) -> float:
        """The signal's value of a tension in N."""
        return tension_n / self.scale_n_per_unit + self.zero


class CounterSignal(_Part):
    """The signal that counts cycles, in a message that opens each cycle."""

    message: Name
    signal: Name


class StatusMasks(_Part):
    """Bits of the status signals; a reading whose status has one of them set is not believed."""

    invalid: Mask = 0
    over_range: Mask = 0
    under_range: Mask = 0


class StuckLimits(_Part):
    """When a reading that stays the same to the last bit counts as stuck.

    Attributes:
        after_s: for so long it must have stayed the same,
        others_moved_n: while half of the other channels moved by more than this.
    """

    after_s: Annotated[Number, Field(ge=0.01, le=3600.0)]
    others_moved_n: Annotated[Number, Field(gt=0.0, le=1e5)]


class ChannelMap(_Part):
    """The whole map; `channels` go by cable name.

    Attributes:
        dbc: file name, beside the map.
        cycle_time_s: from one sample to the next.
        skew_limit_s: from the first to the last frame of one sample.
        flood_frames_s: rate of frames, of any id, from which on the bus counts as flooded.
        range_n: lowest and highest tension; at or beyond either a reading is not believed.
        counter: the message that opens a cycle and counts it, if the amplifier sends one.
        nmt_start_nodes: CANopen nodes that send only after an NMT start (CiA 301).
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]
    dbc: Annotated[str, Field(max_length=128)]
    cycle_time_s: Annotated[Number, Field(ge=1e-4, le=1.0)]
    skew_limit_s: Annotated[Number, Field(gt=0.0, le=1.0)]
    flood_frames_s: Annotated[Number, Field(ge=1.0, le=1e6)]
    range_n: tuple[Number, Number]
    stuck: StuckLimits
    status_masks: StatusMasks = StatusMasks()
    counter: CounterSignal | None = None
    nmt_start_nodes: Annotated[
        list[Annotated[Count, Field(ge=1, le=127)]], Field(max_length=127)
    ] = []
    channels: Annotated[dict[Name, Channel], Field(min_length=1, max_length=MAX_CHANNELS)]

    @property
    def cable_names(self) -> tuple[str, ...]:
        """In the order of the map."""
        return tuple(self.channels)

    def arranged(self, cable_names: Sequence[str]) -> ChannelMap:
        """The map with its channels in an arm's order.

        Raises:
            ChannelMapError: a cable has no channel, or a channel no cable.
        """
        missing = [name for name in cable_names if name not in self.channels]
        unknown = [name for name in self.channels if name not in cable_names]
        if missing or unknown:
            said = [f"lacks {', '.join(missing)}"] if missing else []
            said += [f"has {', '.join(unknown)}, which the arm has not"] if unknown else []
            raise ChannelMapError(
                f"map {self.name} {' and '.join(said)}; the cables of this arm are "
                f"{cable_names[0]} … {cable_names[-1]}, each with one channel"
            )
        channels = {name: self.channels[name] for name in cable_names}
        return self.model_copy(update={"channels": channels})

    @model_validator(mode="after")
    def _is_possible(self) -> ChannelMap:
        if not self.dbc.endswith(".dbc") or "/" in self.dbc or "\\" in self.dbc:
            raise ValueError(
                f"gives dbc = {self.dbc!r}; it must be the name of a .dbc file beside the map"
            )
        if self.skew_limit_s > self.cycle_time_s:
            raise ValueError(
                f"gives skew_limit_s = {self.skew_limit_s:g}; it must be at most cycle_time_s = "
                f"{self.cycle_time_s:g}, or frames of two cycles would make one sample"
            )
        if self.range_n[0] >= self.range_n[1]:
            raise ValueError(
                f"gives range_n = {list(self.range_n)}; it must be [lowest, highest] in N"
            )
        by_signal: dict[tuple[str, str], str] = {}
        for cable, channel in self.channels.items():
            other = by_signal.setdefault((channel.message, channel.signal), cable)
            if other != cable:
                raise ValueError(
                    f"gives {other} and {cable} the same signal {channel.message}."
                    f"{channel.signal}; every cable has a sensor of its own"
                )
        return self
