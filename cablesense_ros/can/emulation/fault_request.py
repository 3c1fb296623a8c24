"""A fault asked of the emulated amplifier, as text: its kind, and a cable where it has one."""

from __future__ import annotations

from dataclasses import dataclass

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.can.channel_map import ChannelMap
from cablesense_ros.can.fault import FaultKind

OF_A_CABLE = frozenset(
    {
        FaultKind.MISSING_CHANNEL,
        FaultKind.LATE_CHANNEL,
        FaultKind.WRONG_LENGTH,
        FaultKind.UNREADABLE,
        FaultKind.OVER_RANGE,
        FaultKind.UNDER_RANGE,
        FaultKind.STUCK_VALUE,
        FaultKind.NOT_FINITE,
        FaultKind.INVALID_STATUS,
    }
)
"""Kinds that need a cable; the others concern the whole bus."""


class FaultRequestError(CableSenseError):
    """A fault that cannot be asked for: says what can."""


@dataclass(frozen=True)
class FaultRequest:
    """One fault; `cable` is empty for a fault of the whole bus."""

    kind: FaultKind
    cable: str = ""


def parse_fault(text: str, channel_map: ChannelMap) -> FaultRequest | None:
    """Read `missing_channel cable_5`, `bus_off` or the like; an empty text asks for none.

    Raises:
        FaultRequestError: an unknown fault or cable, or one that these amplifiers cannot show.
    """
    words = text.split()
    if not words:
        return None
    kinds = {kind.name.lower(): kind for kind in FaultKind}
    kind = kinds.get(words[0])
    if kind is None:
        raise FaultRequestError(f"unknown fault {words[0][:40]!r}; there are {', '.join(kinds)}")
    if kind not in OF_A_CABLE:
        if len(words) > 1:
            raise FaultRequestError(f"{words[0]} concerns the whole bus; leave the cable out")
        if kind is FaultKind.COUNTER_GAP and channel_map.counter is None:
            raise FaultRequestError(f"map {channel_map.name} has no cycle counter to leave a gap")
        return FaultRequest(kind)
    cable = words[1] if len(words) == 2 else ""
    if cable not in channel_map.channels:
        names = channel_map.cable_names
        raise FaultRequestError(
            f"{words[0]} needs one cable of {names[0]} … {names[-1]}, as in "
            f"'{words[0]} {names[0]}'"
        )
    if kind is FaultKind.INVALID_STATUS and channel_map.channels[cable].status is None:
        raise FaultRequestError(f"{cable} has no status in map {channel_map.name}")
    return FaultRequest(kind, cable)
