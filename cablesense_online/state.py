"""The estimator's state as data, with settings and events, and its journal messages.

Every answer follows from a state and the samples after it, whatever came before. The estimation's
components change its parts in place, and to restore it is to assign them. Its JSON is the only
serialized form.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from math import tau
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetPydanticSchema,
    PlainSerializer,
    ValidationError,
)

from cablesense_base import Array
from cablesense_base.plain_yaml import Count, Number, describe_problem
from cablesense_msgs_py.messages import BREATH_END
from cablesense_msgs_py.topics import ContractError
from cablesense_sim.arm import Arm

MAX_NUMBERS: Final = 4096
MAX_ABSOLUTE: Final = 1e9
"""No angle in rad and no tension in N is this large."""


def _as_list(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


_Bounded = Annotated[Number, Field(gt=-MAX_ABSOLUTE, lt=MAX_ABSOLUTE, allow_inf_nan=False)]
Numbers = Annotated[tuple[_Bounded, ...], Field(max_length=MAX_NUMBERS)]
_NumbersAsArray = Annotated[
    Numbers, BeforeValidator(_as_list), AfterValidator(np.array), PlainSerializer(_as_list)
]
Vector = Annotated[Array, GetPydanticSchema(lambda _, handler: handler(_NumbersAsArray))]
"""An array of one axis in memory, a bounded list of numbers in JSON; never changed in place."""
WholeNumber = Annotated[Count, Field(ge=-(2**63), lt=2**63)]
_NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
_EMPTY = Field(default_factory=lambda: np.zeros(0))


class EstimationSettings(BaseModel):
    """The estimator's settings: the node's parameters of these names, with angles in rad."""

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
"""These may change while an estimator runs."""


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
    FOLLOWED = "pose of a followed motion"


@dataclass(frozen=True)
class Event:
    """One change; `command_rad` (2N,) with a command, and at a start the one in force."""

    kind: EventKind
    command_rad: Numbers = ()


MOST_EVENTS: Final = 256
"""Kept between two samples. The oldest with a later one of its kind is then dropped."""


class EventLog:
    """The changes since the last state."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def __bool__(self) -> bool:
        return bool(self._events)

    def note(self, kind: EventKind, command_rad: Array | None = None) -> None:
        """Add an event for the next state; repeated starts before a sample count once."""
        event = Event(kind, () if command_rad is None else tuple(command_rad.tolist()))
        if kind is EventKind.START and event in self._events:
            return
        self._events.append(event)
        if len(self._events) > MOST_EVENTS:
            later = {other.kind: i for i, other in enumerate(self._events)}
            del self._events[next(i for i, x in enumerate(self._events) if later[x.kind] > i)]

    def taken(self) -> tuple[Event, ...]:
        """The events in order; the log is empty afterwards."""
        events, self._events = tuple(self._events), []
        return events


LONG_AGO_NS: Final = -(2**62)
"""A stamp before all others."""


class GateState(BaseModel):
    """Where the arm may be on its way to the command in force.

    Attributes:
        command_rad: (2N,) the command in force.
        pose_rad: (2N,) pose of the estimates: the command, or a set-point of a followed motion.
        rest_from_ns: stamp from which on the arm rests.
        course, course_from_ns: set-points of a motion (`JointMotion.course`) and the stamp at
            which it began; empty where they are at the command.
        turned_ns: stamp at which the last turn beyond `still_rad` arrives.
        swing_rad_s2, swung_ns: (2N,) accelerations with which the arm swung at a stamp; empty
            where it has not moved.
        net_turn_rad, turns_rad: averages of the latest changes of the command (2N,), and of their
            sizes.
    """

    command_rad: Vector
    pose_rad: Vector
    rest_from_ns: WholeNumber
    course: Vector = _EMPTY
    course_from_ns: WholeNumber = 0
    turned_ns: WholeNumber = LONG_AGO_NS
    swing_rad_s2: Vector = _EMPTY
    swung_ns: WholeNumber = LONG_AGO_NS
    net_turn_rad: Vector = _EMPTY
    turns_rad: _NotNegative = 0.0


def utc_text(time_ns: int) -> str:
    """A time since the epoch to the second, as diagnostics show it."""
    return f"{datetime.fromtimestamp(time_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S UTC}"


class Tare(BaseModel):
    """Tensions of the unloaded arm at one command.

    Attributes:
        measured_n: (M,) mean of `sample_count` readings.
        predicted_n: (M,) unloaded tensions by the arm file at the same command.
        command_rad: (2N,) that command.
        taken_ns: time since the epoch.
        by_itself: whether the estimator took it by itself (`auto_tare`).
    """

    model_config = ConfigDict(frozen=True)

    measured_n: Vector
    predicted_n: Vector
    command_rad: Vector
    sample_count: WholeNumber
    taken_ns: Annotated[Count, Field(ge=0, lt=2**63)]
    by_itself: bool = False

    @property
    def offset_n(self) -> float:
        """Largest deviation of a cable from the arm file, N."""
        return float(np.abs(self.measured_n - self.predicted_n).max())

    @property
    def since(self) -> str:
        """When it was taken, as text."""
        return utc_text(self.taken_ns)

    def unloaded_n(self, predicted_n: Array) -> Array:
        """(M,) unloaded tensions where the arm file predicts `predicted_n`."""
        return self.measured_n + (predicted_n - self.predicted_n)

    def described(self, cable_names: Sequence[str]) -> str:
        """Time and values, as text for a log; `cable_names` (M,)."""
        off_n = self.measured_n - self.predicted_n
        rows = zip(cable_names, self.measured_n, off_n, strict=True)
        cables = ", ".join(f"{name} {tension:.2f} ({off:+.2f})" for name, tension, off in rows)
        return (
            f"at {self.since}: average of {self.sample_count} readings, at most "
            f"{self.offset_n:.2f} N from the arm file's unloaded tensions; in N, with the "
            f"deviation: {cables}"
        )


class TareState(BaseModel):
    """The tare in use, and (M,) unloaded tensions by the arm file at the present angles.

    `linear_at_rad` (2N,) are the angles about which these are linearised; empty where they are
    predicted directly.
    """

    tare: Tare | None = None
    predicted_n: Vector
    linear_at_rad: Vector = _EMPTY


class MisfitState(BaseModel):
    """Readings did not fit from one stamp on; no force is given before the other."""

    withheld_until_ns: WholeNumber = 0
    misfit_since_ns: WholeNumber = 0


class BreathState(BaseModel):
    """Progress and results of a breath (`breathing.BreathReadings`).

    Attributes:
        turn: turn of the last reading, as `messages.breath_turn` numbers them.
        from_ns, last_ns: stamps of the turn's beginning, 0 where the turn does not count, and of
            the last reading.
        count, gap_ns: number of readings in the turn, and the longest time between two.
        sum_log_n: (M,) sum of their logarithms, weighted by time in s.
        lowest_n, highest_n: (M,) range of the readings.
        mark_turn, mark_ns: turn and stamp of the mark that the next reading passes; 0 for none.
        reading_n: (M,) mean of the last whole turn; empty where none counts.
        ended_ns: stamp of the breath's end; 0 where no rest is awaited.
        rest_n, rest_count: (M,) sum of the readings at rest since, and their number.
        offset_n: (M,) correction of the readings for friction; empty where it is not known.
    """

    turn: WholeNumber = BREATH_END
    from_ns: WholeNumber = 0
    last_ns: WholeNumber = 0
    count: WholeNumber = 0
    gap_ns: WholeNumber = 0
    sum_log_n: Vector = _EMPTY
    lowest_n: Vector = _EMPTY
    highest_n: Vector = _EMPTY
    mark_turn: WholeNumber = BREATH_END
    mark_ns: WholeNumber = 0
    reading_n: Vector = _EMPTY
    ended_ns: WholeNumber = 0
    rest_n: Vector = _EMPTY
    rest_count: WholeNumber = 0
    offset_n: Vector = _EMPTY


class EstimatorState(BaseModel):
    """The state from one sample on.

    Attributes:
        before_ns: stamp of the first sample that it holds for.
        events: changes since the previous sample, in order.
        arm: identity of the arm.
        origin: model file, its SHA-256, frame prefix and joint names, as text.
        command_received: whether any joint command has come; until then the arm is assumed to be
            straight.
    """

    model_config = ConfigDict(frozen=True)

    before_ns: WholeNumber
    events: tuple[Event, ...] = ()
    arm: str
    settings: EstimationSettings
    origin: dict[str, str] = Field(default_factory=dict)
    command_received: bool = False
    gate: GateState
    tare: TareState
    misfit: MisfitState = Field(default_factory=MisfitState)
    breath: BreathState = Field(default_factory=BreathState)

    def require_fitting(self, arm: Arm) -> None:
        """Refuse to continue from this state with an arm of other joints or cables.

        Raises:
            ContractError: a vector has not the arm's number of angles or tensions, or an angle is
                more than a turn.
        """
        joints = arm.joint_count
        lengths = {"rad": joints, "s2": joints, "n": arm.cable_count, "course": 7 * joints + 2}
        commands = [("event.command_rad", np.array(e.command_rad), False) for e in self.events]
        for name, vector, required in (*_vectors(self), *commands):
            wanted = lengths[name.rpartition(".")[2].rpartition("_")[2]]
            if len(vector) != wanted and (required or len(vector)):
                raise ContractError(
                    f"state: {name} has {len(vector)} numbers; the arm {arm.identity} has {wanted}"
                )
            if name.endswith("_rad") and np.abs(vector).max(initial=0.0) > tau:
                raise ContractError(
                    f"state: {name} has a joint at {np.abs(vector).max():g} rad; no joint turns "
                    f"by more than {tau:.3f}"
                )


def _vectors(part: BaseModel, where: str = "") -> Iterator[tuple[str, Array, bool]]:
    """Name, value and whether it must be there of each vector in a state, its parts included."""
    for name, field in type(part).model_fields.items():
        value = getattr(part, name)
        if isinstance(value, np.ndarray):
            yield where + name, value, field.is_required()
        elif isinstance(value, BaseModel):
            yield from _vectors(value, f"{where}{name}.")


def validated_state(values: Any) -> EstimatorState:
    """A state from the values of its JSON.

    Raises:
        ContractError: one line on the first value that is missing or cannot be.
    """
    try:
        return EstimatorState.model_validate(values)
    except ValidationError as error:
        raise ContractError(describe_problem(error, EstimatorState)) from error


def put_state(
    message: Any,
    state: EstimatorState,
    make_status: Callable[..., Any],
    make_value: Callable[..., Any],
) -> None:
    """Put a state into a `DiagnosticArray`: one `DiagnosticStatus` with the events' names.

    Its `KeyValue`s are the state's fields as JSON.
    """
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(state.before_ns, 1_000_000_000)
    fields = state.model_dump(mode="json").items()
    message.status = [
        make_status(
            level=b"\0",
            name="state",
            message=", ".join(event.kind.value for event in state.events),
            hardware_id=state.arm,
            values=[make_value(key=key, value=json.dumps(value)) for key, value in fields],
        )
    ]


def state_of(message: Any) -> EstimatorState:
    """The state in a `DiagnosticArray`.

    Raises:
        ContractError: it holds no state, or a value that no state can have.
    """
    values = {}
    for status in message.status:
        for item in status.values if status.name == "state" else ():
            try:
                values[str(item.key)] = json.loads(str(item.value))
            except (ValueError, RecursionError) as error:
                raise ContractError(f"{str(item.key)[:40]}: is no JSON ({error})") from error
    return validated_state(values)
