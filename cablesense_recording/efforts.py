"""What the efforts of a robot's joints are: torques, currents, or torques without gravity.

`sensor_msgs/JointState` calls an effort newton metres. Drivers put amperes there too, torques
without those that gravity makes, and units of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from cablesense_base import Array, some_of
from cablesense_recording.recording import RecordingError

EFFORT_OPTION: Final = "--effort"
"""The option of `cablesense gap` that states what efforts are."""


class Meaning(Enum):
    """What an effort is; the value is the word for it in a label and in a statement."""

    TORQUE = "torque"
    CURRENT = "current"
    WITHOUT_GRAVITY = "torque_without_gravity"


MEANINGS: Final = tuple(each.value for each in Meaning)
READ_FIRST: Final = (Meaning.TORQUE, Meaning.WITHOUT_GRAVITY, Meaning.CURRENT)
"""Of several columns of one joint the first of these is read."""


@dataclass(frozen=True)
class Effort:
    """What the effort of one joint is.

    Attributes:
        meaning: of its numbers.
        factor: N·m or N by one unit of them; None where nobody knows, as of a current's.
        stated: whether a user has said so, by a column or an option.
    """

    meaning: Meaning = Meaning.TORQUE
    factor: float | None = 1.0
    stated: bool = False


def of_meaning(meaning: Meaning) -> Effort:
    """An effort that a column's name states: a current has no factor yet."""
    factor = None if meaning is Meaning.CURRENT else 1.0
    return Effort(meaning, factor, stated=meaning is not Meaning.TORQUE)


def stated_efforts(
    statements: Sequence[str], joint_numbers: Mapping[str, int], joints: Sequence[str]
) -> dict[int, Effort]:
    """Efforts by the number of their joint, as `[JOINT=]MEANING[:FACTOR]` states them.

    A statement without a joint is of all joints; one with a joint counts more.

    Raises:
        RecordingError: no such joint or meaning, a joint twice, or a factor that is no number.
    """
    of_all: dict[int, Effort] = {}
    of_one: dict[int, Effort] = {}
    for statement in statements:
        name, _, said = statement.rpartition("=")
        word, _, factor = said.partition(":")
        if word not in MEANINGS:
            raise RecordingError(
                f"{EFFORT_OPTION} {statement}: {word[:40]!r} is none of {', '.join(MEANINGS)}"
            )
        effort = replace(of_meaning(Meaning(word)), stated=True)
        if factor:
            effort = replace(effort, factor=_number(statement, factor))
        if not name:
            of_all |= dict.fromkeys(range(len(joints)), effort)
        elif name not in joint_numbers:
            raise RecordingError(
                f"{EFFORT_OPTION} {statement}: no joint {name[:40]!r}; there are {some_of(joints)}"
            )
        elif joint_numbers[name] in of_one:
            raise RecordingError(f"{EFFORT_OPTION}: {name} is stated twice; once is right")
        else:
            of_one[joint_numbers[name]] = effort
    return of_all | of_one


def _number(statement: str, text: str) -> float:
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not 1e-9 < abs(factor) < 1e9:
        raise RecordingError(
            f"{EFFORT_OPTION} {statement}: {text[:40]!r} is no factor; it is how many N·m or N "
            "one unit of the effort is, as 0.001 of mN·m"
        )
    return factor


def chosen_efforts(
    present: Sequence[set[Meaning]], stated: Mapping[int, Effort]
) -> tuple[Effort, ...]:
    """Efforts (J,) by the kinds of columns that each joint has, and by what users state.

    Raises:
        RecordingError: a column says otherwise than a statement.
    """
    efforts = []
    for joint, meanings in enumerate(present):
        of_column = next((each for each in READ_FIRST if each in meanings), Meaning.TORQUE)
        effort = stated.get(joint, of_meaning(of_column))
        if of_column is not Meaning.TORQUE and effort.meaning is not of_column:
            raise RecordingError(
                f"a column {of_column.value} is stated to be {effort.meaning.value}; leave out "
                f"{EFFORT_OPTION}, or name the column torque"
            )
        efforts.append(effort)
    return tuple(efforts)


def in_known_units(torque: Array, efforts: Sequence[Effort]) -> Array:
    """Efforts (R, J) in N·m or N where their factor is known; the others as they are."""
    factors = [each.factor if each.factor is not None else 1.0 for each in efforts]
    return torque * factors


def effort_sentences(efforts: Sequence[Effort], joints: Sequence[str]) -> Iterator[str]:
    """What is done with efforts that are no torques in N·m or N."""
    for effort in dict.fromkeys(efforts):
        named = some_of([joints[j] for j, each in enumerate(efforts) if each == effort], 6)
        if effort.factor is None:
            yield (
                f"Efforts of {named} are currents whose torque constant is unknown: it is fitted."
            )
        elif effort.factor != 1.0:
            yield f"Efforts of {named} are taken times {effort.factor:g}."
        if effort.meaning is Meaning.WITHOUT_GRAVITY:
            yield f"Efforts of {named} lack gravity's torque: the model's is added."
