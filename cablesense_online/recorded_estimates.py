"""Estimates of a recording of readings and commands: the running estimator, row by row.

No node, no trial and no known load is needed. The arm begins where the first row commands it, and
the first rows at rest that can be of the untouched arm are its tare. Where the first command was
given during the recording, nothing is answered until a move from anywhere must have ended.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_msgs_py.messages import MAX_JOINT_ANGLE_RAD, ForceState
from cablesense_msgs_py.serialized import EffortWriter
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.models import Loaded
from cablesense_online.settings import EstimationSettings
from cablesense_recording.recording import Recording, RecordingError

NO_TARE = "no tare yet"
"""Why a row is untared before enough rows at rest have been looked at."""
_BEGIN_NS = 1_000_000_000
"""Stamp of the first row: 0 would be none."""


class RecordedAnswer(NamedTuple):
    """What is stated of one row.

    Attributes:
        time_s: since the recording began.
        answer: to its readings.
        tare_problem: of an untared row, why there is no tare yet; else empty.
    """

    time_s: float
    answer: Answer
    tare_problem: str = ""


def recorded_answers(
    recording: Recording,
    loaded: Loaded,
    settings: EstimationSettings,
    calibration: Calibration | None = None,
) -> Iterator[RecordedAnswer]:
    """Answer the rows of a recording one after the other.

    Raises:
        TareError: a calibration is given with a network, which takes none.
    """
    machine = loaded.machine
    estimation = Estimation(machine, loaded.contacts(settings), settings, 0.0, calibration)
    begin_rad = recording.command_rad[0]
    if recording.commanded_inside and not machine.reads_joints:
        begin_rad = begin_rad + MAX_JOINT_ANGLE_RAD  # so the first command is a move of this size
    estimation.begin_at(begin_rad)
    writer = EffortWriter(machine.channels.names)
    last_rad: Array | None = None
    for time_s, command_rad, reading_n in zip(
        recording.time_s.tolist(), recording.command_rad, recording.tensions_n, strict=True
    ):
        stamp_ns = _BEGIN_NS + round(time_s * 1e9)
        if last_rad is None or not np.array_equal(command_rad, last_rad):
            estimation.command(command_message(machine.command_names, command_rad, stamp_ns))
            last_rad = command_rad
        raw = writer.write(stamp_ns, reading_n.tolist())
        answer = estimation.sample(raw, stamp_ns, stamp_ns * 1e-9)
        tare_problem = ""
        if answer.force is ForceState.UNTARED:
            tare_problem = estimation.state.tare_problem or NO_TARE
        yield RecordedAnswer(time_s, answer, tare_problem)


def require_tare(answers: list[RecordedAnswer], count: int) -> None:
    """Refuse a recording that never shows the untouched arm at rest.

    Raises:
        RecordingError: no answer rests on a tare of `count` rows, or on a calibration.
    """
    states = {each.answer.force for each in answers}
    if states <= {ForceState.UNTARED, ForceState.MOVING, ForceState.REFUSED}:
        refusals = [
            each.tare_problem for each in answers if each.tare_problem not in ("", NO_TARE)
        ]
        because = f" ({refusals[0]})" if refusals else ""
        raise RecordingError(
            f"nothing is known of the untouched arm: no {count} rows in one pose have readings "
            f"of it that are steady{because}; record it untouched first, take fewer rows "
            "(--tare-rows), or give a --calibration"
        )


def command_message(names: tuple[str, ...], angles_rad: Array, stamp_ns: int) -> SimpleNamespace:
    """A `JointState` of commands, or of measured positions, without ROS."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
    header = SimpleNamespace(frame_id="", stamp=stamp)
    return SimpleNamespace(header=header, name=names, position=angles_rad)
