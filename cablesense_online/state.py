"""The estimator's state: all that its answers rest on beside the samples, in its one form.

With a state and the samples from there on every answer is determined, whatever came before.
`EstimatorState` is validated wherever it comes from, and has two serialisations: the file of
`state_file.py`, and here a message of `~/journal`, published whenever the state changes. That is a
`diagnostic_msgs/DiagnosticArray` with one status for each event since the state before and one for
each part of the state, numbers as text with all their digits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import tau
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cablesense_base import Array
from cablesense_base.plain_yaml import Count, Number, describe_problem
from cablesense_msgs_py.messages import BREATH_END
from cablesense_msgs_py.topics import ContractError
from cablesense_sim.arm import Arm

MAX_NUMBERS: Final = 4096
MAX_ABSOLUTE: Final = 1e9
"""No angle in rad and no tension in N is so large."""


_Bounded = Annotated[Number, Field(gt=-MAX_ABSOLUTE, lt=MAX_ABSOLUTE, allow_inf_nan=False)]
Numbers = Annotated[tuple[_Bounded, ...], Field(max_length=MAX_NUMBERS)]
WholeNumber = Annotated[Count, Field(ge=-(2**63), lt=2**63)]
_NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class EstimationSettings(BaseModel):
    """The estimator's settings, as the node's parameters of these names, angles in rad.

    Recordings from before there was a `largest_misfit` were answered without a check.
    """

    model_config = ConfigDict(frozen=True)

    contact_threshold: _NotNegative
    stale_after_s: _NotNegative
    slack_below_n: _NotNegative
    tare_samples: Annotated[int, Field(ge=1, le=10_000)]
    tare_steady_n: _NotNegative
    auto_tare: bool
    await_breath: bool = False
    joint_speed_rad_s: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    settle_s: _NotNegative
    still_rad: _NotNegative = 0.0
    follow_rad_s: _NotNegative = 0.0
    tare_deviation_n: _NotNegative = 0.0
    tare_drift_n: _NotNegative = 0.0
    largest_misfit: _NotNegative = 0.0
    unknown_force: Literal["zero", "nan", "none"] = "zero"
    hidden_above_n: _NotNegative = 1.0


LIVE_SETTINGS: Final = ("contact_threshold", "stale_after_s", "slack_below_n")
"""Those that may change while an estimator runs."""


MOST_EVENTS: Final = 256
"""Between two samples; of more, the oldest that has a later one of its kind is left out."""


class EventKind(Enum):
    """What has changed."""

    START = "start"
    COMMAND = "command"
    POSE_CONFIRMED = "command to the assumed pose"
    AUTO_TARE = "tare by itself"
    TARE = "tare on request"
    TARE_UNDO = "tare undone"
    SETTINGS = "settings"
    CLOCK = "stamps stepped back"
    CLOCK_AHEAD = "stamps stepped forward"
    PUBLISHER = "another publisher"
    MISFIT = "readings do not fit"
    BREATH = "turn of a breath"


@dataclass(frozen=True)
class Event:
    """One change; `command_rad` (2N,) with a command, and at a start the one in force."""

    kind: EventKind
    command_rad: Numbers = ()


class EventLog:
    """What has changed since the last state."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def __bool__(self) -> bool:
        return bool(self._events)

    def note(self, kind: EventKind, command_rad: Array | None = None) -> None:
        """For the next state; a start once, however often it is started before a sample."""
        event = Event(kind, () if command_rad is None else tuple(command_rad.tolist()))
        if kind is EventKind.START and event in self._events:
            return
        self._events.append(event)
        if len(self._events) > MOST_EVENTS:
            later = {other.kind: i for i, other in enumerate(self._events)}
            del self._events[next(i for i, x in enumerate(self._events) if later[x.kind] > i)]

    def taken(self) -> tuple[Event, ...]:
        """Those so far, in order; none of them is given again."""
        events, self._events = tuple(self._events), []
        return events


class BreathState(BaseModel):
    """How far a breath has got, and what it has shown (`breath_readings`).

    Attributes:
        turn: in which the last reading was taken, see `messages.breath_turn`.
        from_ns, last_ns: stamps of the turn's beginning, 0 where it does not count, and of the
            last reading.
        count, gap_ns: of the turn's readings, and the longest time between two.
        sum_log_n_s: (M,) of their logarithms, each by its time.
        lowest_n, highest_n: (M,) of them.
        mark_turn, mark_ns: turn and stamp of the mark that the next reading passes; 0 for none.
        reading_n: (M,) mean of the last whole turn; empty where none counts.
        ended_ns: stamp of the breath's end; 0 where none is waited for.
        rest_n, rest_count: (M,) readings at rest since, summed up.
        offset_n: (M,) what friction has left on the cables, as it is added to readings.
    """

    model_config = ConfigDict(frozen=True)

    turn: WholeNumber = BREATH_END
    from_ns: WholeNumber = 0
    last_ns: WholeNumber = 0
    count: WholeNumber = 0
    gap_ns: WholeNumber = 0
    sum_log_n_s: Numbers = ()
    lowest_n: Numbers = ()
    highest_n: Numbers = ()
    mark_turn: WholeNumber = BREATH_END
    mark_ns: WholeNumber = 0
    reading_n: Numbers = ()
    ended_ns: WholeNumber = 0
    rest_n: Numbers = ()
    rest_count: WholeNumber = 0
    offset_n: Numbers = ()


class EstimatorState(BaseModel):
    """The state from one sample on.

    Attributes:
        before_ns: stamp of the first sample that it holds for.
        events: what has happened since the sample before, in order.
        arm: identity of the arm.
        settings: of the estimator.
        origin: model file, its SHA-256, frame prefix and joint names, as text.
        command_rad: (2N,) the command in force.
        lowest_rad, highest_rad: (2N,) between which the joints may be until the arm rests.
        rest_from_ns: samples stamped earlier are from an arm in motion.
        course: pose (2N,) and set-points of a motion that is followed; empty where the arm is at
            the command.
        linear_at_rad: (2N,) angles about which unloaded tensions are taken as linear; or empty.
        unloaded_n: (M,) unloaded tensions at this command; empty without a tare.
        tared_n: (M,) as they were measured at the tare.
        tare_command_rad: (2N,) the command at which it was taken.
        pose_assumed: whether it was taken by itself, and no command has come yet.
        withheld_until_ns: samples stamped earlier give no force, as readings did not fit.
        misfit_since_ns: stamp from which on they did not.
        breath: how far a breath has got, and what it has shown.
    """

    model_config = ConfigDict(frozen=True)

    before_ns: WholeNumber
    events: tuple[Event, ...] = ()
    arm: str
    settings: EstimationSettings
    origin: dict[str, str] = Field(default_factory=dict)
    command_rad: Numbers
    lowest_rad: Numbers
    highest_rad: Numbers
    rest_from_ns: WholeNumber
    course: Numbers = ()
    linear_at_rad: Numbers = ()
    unloaded_n: Numbers = ()
    tared_n: Numbers = ()
    tare_command_rad: Numbers = ()
    pose_assumed: bool = False
    withheld_until_ns: WholeNumber = 0
    misfit_since_ns: WholeNumber = 0
    breath: BreathState = BreathState()

    def require_fitting(self, arm: Arm) -> None:
        """Refuse to continue from this state with an arm of other joints or cables.

        Raises:
            ContractError: a number of angles or tensions is not that of the arm, or an angle is
                more than a turn.
        """
        joints, cables = arm.joint_count, arm.cable_count
        lengths = (
            ("joint angles", self.command_rad, joints),
            ("lowest joint angles", self.lowest_rad, joints),
            ("highest joint angles", self.highest_rad, joints),
            ("joint angles at the tare", self.tare_command_rad, joints),
            ("tared tensions", self.tared_n, cables),
            ("unloaded tensions", self.unloaded_n, cables),
        )
        given = [
            (f"of {name} of the breath", numbers, cables)
            for name, numbers in self.breath
            if isinstance(numbers, tuple) and numbers
        ]
        if self.course:
            given.append(("numbers of the course", self.course, 8 * joints + 2))
        if self.linear_at_rad:
            given.append(("angles of the linear tensions", self.linear_at_rad, joints))
        for what, numbers, wanted in (*(lengths if self.tared_n else lengths[:3]), *given):
            if len(numbers) != wanted:
                raise ContractError(
                    f"journal: {len(numbers)} {what}; the arm {arm.identity} has {wanted}"
                )
        poses = (self.lowest_rad, self.highest_rad, self.course[:joints], self.linear_at_rad)
        widest_rad = max(abs(angle) for pose in poses for angle in pose)
        if widest_rad > tau:
            raise ContractError(
                f"journal: a joint at {widest_rad:g} rad; none turns by more than {tau:.3f}"
            )

    def settings_text(self) -> dict[str, str]:
        """Origin and settings as one mapping, as both serialisations have them."""
        return {**self.origin, **{name: _text(value) for name, value in self.settings}}


def validated_state(values: Mapping[str, Any]) -> EstimatorState:
    """A state from the values of a serialisation, whose settings and origin are one mapping.

    Raises:
        ContractError: one line on the first value that is missing or cannot be.
    """
    texts = values.get("settings")
    names = EstimationSettings.model_fields
    origin = {k: v for k, v in texts.items() if k not in names} if isinstance(texts, dict) else {}
    try:
        return EstimatorState.model_validate({**values, "origin": origin})
    except ValidationError as error:
        raise ContractError(describe_problem(error, EstimatorState)) from error


_EVENT, _SETTINGS, _COMMAND, _MISFIT = "event: ", "settings", "command (rad)", "misfit"
_BREATH = "breath"
_PARTS: Final = {
    "motion": {
        _COMMAND: "command_rad",
        "lowest (rad)": "lowest_rad",
        "highest (rad)": "highest_rad",
        "at rest from stamp (ns)": "rest_from_ns",
        "course": "course",
        "tensions linear about (rad)": "linear_at_rad",
    },
    "tare": {
        "unloaded (N)": "unloaded_n",
        "measured at the tare (N)": "tared_n",
        "command at the tare (rad)": "tare_command_rad",
        "pose assumed": "pose_assumed",
    },
    _MISFIT: {
        "no force before stamp (ns)": "withheld_until_ns",
        "not fitting since stamp (ns)": "misfit_since_ns",
    },
}
"""Statuses of a journal message, with the state's field for each of their keys."""
_LATER: Final = (
    "pose_assumed",
    "withheld_until_ns",
    "misfit_since_ns",
    "course",
    "linear_at_rad",
)
"""Fields that journals of earlier versions lack."""
_SEVERAL: Final = ("_rad", "_n", "course")
"""Names of fields with several numbers end so."""


def put_state(
    message: Any,
    state: EstimatorState,
    make_status: Callable[..., Any],
    make_value: Callable[..., Any],
) -> None:
    """Put a state into a `DiagnosticArray`, made of its `DiagnosticStatus` and `KeyValue`."""
    parts = [
        (_EVENT + event.kind.value, {_COMMAND: _text(event.command_rad)}) for event in state.events
    ]
    parts.append((_SETTINGS, state.settings_text()))
    for name, keys in _PARTS.items():
        parts.append((name, {key: _text(getattr(state, field)) for key, field in keys.items()}))
    parts.append((_BREATH, {field: _text(value) for field, value in state.breath}))
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(state.before_ns, 1_000_000_000)
    message.status = [
        make_status(
            level=b"\0",
            name=name,
            hardware_id=state.arm,
            values=[make_value(key=key, value=value) for key, value in values.items()],
        )
        for name, values in parts
    ]


def state_of(message: Any) -> EstimatorState:
    """The state in a `DiagnosticArray`.

    Raises:
        ContractError: a part is missing, or a value is none that a state can have.
    """
    statuses = {status.name: status for status in message.status}
    wanted = [_SETTINGS, *_PARTS]
    wanted.remove(_MISFIT)
    missing = [name for name in wanted if name not in statuses]
    if missing:
        raise ContractError(
            f"status: no {' and no '.join(missing)}; a journal message of the estimator has "
            f"{', '.join(wanted)}"
        )
    stamp, settings = message.header.stamp, statuses[_SETTINGS]
    values: dict[str, Any] = {
        "before_ns": stamp.sec * 1_000_000_000 + stamp.nanosec,
        "events": [
            {
                "kind": status.name.removeprefix(_EVENT),
                "command_rad": _values(status).get(_COMMAND, "").split(),
            }
            for status in message.status
            if status.name.startswith(_EVENT)
        ],
        "arm": str(settings.hardware_id),
        "settings": _values(settings),
    }
    for name, keys in _PARTS.items():
        given = _values(statuses[name]) if name in statuses else {}
        for key, field in keys.items():
            if key in given or field not in _LATER:
                text = given.get(key, "")
                values[field] = text.split() if field.endswith(_SEVERAL) else text
    breath = _values(statuses[_BREATH]) if _BREATH in statuses else {}
    values["breath"] = {
        field: breath[field].split() if isinstance(of.default, tuple) else breath[field]
        for field, of in BreathState.model_fields.items()
        if field in breath
    }
    return validated_state(values)


def _values(status: Any) -> dict[str, str]:
    return {str(value.key): str(value.value) for value in status.values}


def _text(value: float | str | tuple[float, ...]) -> str:
    return " ".join(map(repr, value)) if isinstance(value, tuple) else str(value)
