"""States of the motion gate and of a breath, as data."""

from __future__ import annotations

from typing import Annotated, Any, Final

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    GetPydanticSchema,
    PlainSerializer,
)

from cablesense_base import Array
from cablesense_base.plain_yaml import Count, Number
from cablesense_msgs_py.messages import BREATH_END

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
