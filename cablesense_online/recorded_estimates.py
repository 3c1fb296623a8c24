"""Estimates of a recording of readings and commands: the running estimator, row by row.

No node, no trial and no known load is needed. The arm begins where the first row commands it, and
the first rows at rest that can be of the untouched arm are its tare.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_msgs_py.messages import ForceState
from cablesense_msgs_py.serialized import EffortWriter
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.models import Loaded
from cablesense_online.settings import EstimationSettings
from cablesense_recording.recording import Recording, RecordingError

_BEGIN_NS = 1_000_000_000
"""Stamp of the first row: 0 would be none."""


class RecordedAnswer(NamedTuple):
    """What is stated of one row, at its time since the recording began."""

    time_s: float
    answer: Answer


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
    estimation.begin_at(recording.command_rad[0])
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
        yield RecordedAnswer(time_s, estimation.sample(raw, stamp_ns, stamp_ns * 1e-9))


def require_tare(answers: list[RecordedAnswer], count: int) -> None:
    """Refuse a recording that never shows the untouched arm at rest.

    Raises:
        RecordingError: no answer rests on a tare of `count` rows, or on a calibration.
    """
    states = {each.answer.force for each in answers}
    if states <= {ForceState.UNTARED, ForceState.MOVING, ForceState.REFUSED}:
        raise RecordingError(
            f"nothing is known of the untouched arm: no {count} rows in one pose have readings "
            "of it that are steady; record it untouched first, take fewer rows (--tare-rows), or "
            "give a --calibration"
        )


def command_message(names: tuple[str, ...], angles_rad: Array, stamp_ns: int) -> SimpleNamespace:
    """A `JointState` of commands, or of measured positions, without ROS."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
    header = SimpleNamespace(frame_id="", stamp=stamp)
    return SimpleNamespace(header=header, name=names, position=angles_rad)
