"""What an answer of the estimator rests on beside the sample itself, and its way into a message.

An entry is published whenever something changes: a command, a tare or its undo, a setting. It is
whole: with the latest entry and a sample, the sample's answer is known, whatever came before. As a
`diagnostic_msgs/DiagnosticArray` it has one status for each event and one for each part of the
state; numbers are text with all their digits, so that they read back as the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import Any

from cablesense_msgs_py.topics import ContractError

MOST_NUMBERS = 4096

_EVENT, _SETTINGS, _MOTION, _TARE = "event: ", "settings", "motion", "tare"


class EventKind(Enum):
    """What has changed."""

    START = "start"
    COMMAND = "command"
    AUTO_TARE = "tare by itself"
    TARE = "tare on request"
    TARE_UNDO = "tare undone"
    SETTINGS = "settings"
    CLOCK = "stamps stepped back"


@dataclass(frozen=True)
class Event:
    """One change; `command_rad` (2N,) with a command, and at a start the one that then counts."""

    kind: EventKind
    command_rad: tuple[float, ...] = ()


@dataclass(frozen=True)
class JournalEntry:
    """The state from one sample on.

    Attributes:
        before_ns: stamp of the first sample that it holds for.
        events: what has happened since the sample before, in order.
        arm: identity of the arm.
        settings: model and parameters, as text.
        command_rad: (2N,) the command that counts.
        lowest_rad, highest_rad: (2N,) between which the joints may be until the arm rests.
        rest_from_ns: samples stamped earlier are from an arm in motion.
        unloaded_n: (M,) unloaded tensions at this command; empty without a tare.
        tared_n: (M,) as they were measured at the tare.
        tare_command_rad: (2N,) the command at which it was taken.
    """

    before_ns: int
    events: tuple[Event, ...]
    arm: str
    settings: Mapping[str, str]
    command_rad: tuple[float, ...]
    lowest_rad: tuple[float, ...]
    highest_rad: tuple[float, ...]
    rest_from_ns: int
    unloaded_n: tuple[float, ...] = field(default=())
    tared_n: tuple[float, ...] = field(default=())
    tare_command_rad: tuple[float, ...] = field(default=())


def put_journal_entry(
    message: Any,
    entry: JournalEntry,
    make_status: Callable[..., Any],
    make_value: Callable[..., Any],
) -> None:
    """Put an entry into a `DiagnosticArray`.

    Args:
        message: to fill.
        entry: to put.
        make_status: the class `diagnostic_msgs.msg.DiagnosticStatus`.
        make_value: the class `diagnostic_msgs.msg.KeyValue`.
    """

    def status(name: str, values: Mapping[str, str]) -> Any:
        return make_status(
            level=b"\0",
            name=name,
            hardware_id=entry.arm,
            values=[make_value(key=key, value=value) for key, value in values.items()],
        )

    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(entry.before_ns, 1_000_000_000)
    message.status = [
        *(
            status(_EVENT + event.kind.value, {"command (rad)": _text(event.command_rad)})
            for event in entry.events
        ),
        status(_SETTINGS, entry.settings),
        status(
            _MOTION,
            {
                "command (rad)": _text(entry.command_rad),
                "lowest (rad)": _text(entry.lowest_rad),
                "highest (rad)": _text(entry.highest_rad),
                "at rest from stamp (ns)": str(entry.rest_from_ns),
            },
        ),
        status(
            _TARE,
            {
                "unloaded (N)": _text(entry.unloaded_n),
                "measured at the tare (N)": _text(entry.tared_n),
                "command at the tare (rad)": _text(entry.tare_command_rad),
            },
        ),
    ]


def journal_entry(message: Any) -> JournalEntry:
    """The entry in a `DiagnosticArray`.

    Raises:
        ContractError: a part is missing, or no number where one must be.
    """
    parts = {status.name: status for status in message.status}
    missing = [name for name in (_SETTINGS, _MOTION, _TARE) if name not in parts]
    if missing:
        raise ContractError(
            f"status: no {' and no '.join(missing)}; a journal entry of the estimator has "
            f"{_SETTINGS}, {_MOTION} and {_TARE}"
        )
    motion, tare = _values(parts[_MOTION]), _values(parts[_TARE])
    stamp = message.header.stamp
    return JournalEntry(
        before_ns=stamp.sec * 1_000_000_000 + stamp.nanosec,
        events=tuple(
            _event(status) for status in message.status if status.name.startswith(_EVENT)
        ),
        arm=str(parts[_SETTINGS].hardware_id),
        settings=_values(parts[_SETTINGS]),
        command_rad=_numbers(motion, "command (rad)"),
        lowest_rad=_numbers(motion, "lowest (rad)"),
        highest_rad=_numbers(motion, "highest (rad)"),
        rest_from_ns=_whole(motion, "at rest from stamp (ns)"),
        unloaded_n=_numbers(tare, "unloaded (N)"),
        tared_n=_numbers(tare, "measured at the tare (N)"),
        tare_command_rad=_numbers(tare, "command at the tare (rad)"),
    )


def _event(status: Any) -> Event:
    name = status.name.removeprefix(_EVENT)
    try:
        kind = EventKind(name)
    except ValueError as error:
        known = ", ".join(kind.value for kind in EventKind)
        raise ContractError(f"status: unknown event {name[:40]!r}; known are {known}") from error
    return Event(kind, _numbers(_values(status), "command (rad)"))


def _values(status: Any) -> dict[str, str]:
    return {str(value.key): str(value.value) for value in status.values}


def _text(numbers: Sequence[float]) -> str:
    return " ".join(map(repr, numbers))


def _numbers(values: Mapping[str, str], key: str) -> tuple[float, ...]:
    words = values.get(key, "").split()
    try:
        numbers = tuple(map(float, words[:MOST_NUMBERS]))
    except ValueError as error:
        raise ContractError(f"{key}: {values[key][:40]!r} is no list of numbers") from error
    if not all(map(isfinite, numbers)):
        raise ContractError(f"{key}: all numbers must be finite")
    return numbers


def _whole(values: Mapping[str, str], key: str) -> int:
    text = values.get(key, "")
    if not text.removeprefix("-").isdecimal() or len(text) > 20:
        raise ContractError(f"{key}: {text[:40]!r} is no whole number")
    return int(text)
