"""The film of a robot's report: its measured motion beside that which its models predict.

Each model starts in a measured state and is given the measured torques or commands. The part of
the recording is shown in which the nominal model leaves the measured motion farthest, but does not
lose it. A process of its own renders it with MuJoCo, so that no driver of a graphics card can stop
a report.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_gap.report import rendering
from cablesense_gap.report.style import AFTER, BEFORE, image_uri
from cablesense_gap.robot.amending import changed
from cablesense_gap.robot.forward import Rollouts
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.robot.motion import Motion, inner_rows
from cablesense_gap.robot.system import RobotDiagnosis
from cablesense_recording.robot_recording import TrialLabel

_SHOWN_S = 4.0
"""How long a film runs, over and over."""
_CLIP_S = 1.0
"""Of the motion in it, at most: models that are off have left the measured motion by then."""
_SHARE_OF_TRIAL = 0.8
"""Of the longest trial that a clip takes at most."""
_MOST_WINDOWS = 24
"""That are rolled out to choose from."""
_MOST_STEPS = 60_000
"""Of MuJoCo, in all windows together: a second or two."""
_FEWEST_SAMPLES = 8
_FOLLOWED = 1.0
"""By how much a model that still follows leaves a joint at the end, by half the joint's span."""
_LEAST_SPAN = 0.05
"""Of a joint that hardly moves, by the largest span."""
_COLOURS = {"nominal model": BEFORE, "amended model": AFTER}
"""By labels."""
_DRIVERS = ("egl", "osmesa")
"""Of MuJoCo that need no display, in the order in which they are tried."""
_RENDERED_S = 60.0
"""How long a driver may take that hangs; one that works takes some two seconds of a free core."""


class FilmError(CableSenseError):
    """A film that cannot be made: names the reason."""


@dataclass(frozen=True)
class Prediction:
    """What a model makes of a clip.

    Attributes:
        label, colour: of the model in the film.
        position: (F, J) of its joints, as encoders read them.
    """

    label: str
    colour: str
    position: Array


@dataclass(frozen=True)
class Clip:
    """A part of a recording in F frames.

    Attributes:
        trial: what the recording's user knows its trial by.
        begin_s, span_s: when it begins, as the recording counts time, and how long it is.
        measured: (F, J) positions of the joints.
        predictions: of the nominal model, and of an amended one that differs.
    """

    trial: TrialLabel
    begin_s: float
    span_s: float
    measured: Array
    predictions: tuple[Prediction, ...]

    @property
    def slower(self) -> float:
        """By how many times a film of it is slower than the motion was."""
        return _SHOWN_S / self.span_s


@dataclass(frozen=True)
class Film:
    """A clip as pictures.

    Attributes:
        animation, poster: sources of an image that moves and of one that stands: its last frame.
    """

    clip: Clip
    animation: str
    poster: str


def robot_film(diagnosis: RobotDiagnosis) -> Film:
    """The film of a diagnosis.

    Raises:
        FilmError: the motion cannot be predicted, or no driver renders here.
    """
    clip = chosen_clip(diagnosis)
    animation, poster = rendered_film(diagnosis.system.robot.model, clip)
    return Film(clip, image_uri(animation, "webp"), image_uri(poster, "webp"))


def chosen_clip(diagnosis: RobotDiagnosis) -> Clip:
    """The clip in which the nominal model leaves the measured motion farthest and follows it yet.

    Raises:
        FilmError: positions were measured outside the drives, no trial is long enough, or the
            nominal model's motion has no end.
        RobotError: the amended model is none.
    """
    robot = diagnosis.system.robot
    motion = diagnosis.system.motion
    if motion.external:
        raise FilmError("positions measured outside the drives differ by too little to be seen")
    nominal = changed(robot, [diagnosis.system.listed])
    begins, span = _windows(robot, motion)
    rollouts = Rollouts(robot, motion, begins, span)
    measured, _speed = rollouts.measured(begins + span)
    predicted, _speed = rollouts.predicted(nominal)
    half_span = np.maximum(motion.scale.position, _LEAST_SPAN * motion.scale.position.max())
    departure = (np.abs(predicted[:, -1] - measured) / half_span).max(axis=1)
    if not np.isfinite(departure).any():
        raise FilmError("the nominal model's motion has no end")
    followed = departure <= max(_FOLLOWED, float(np.nanmin(departure)))
    chosen = np.where(followed, departure, -np.inf).argmax()
    changes = {"nominal model": nominal}
    if not np.allclose(diagnosis.before, diagnosis.after):
        changes["amended model"] = changed(robot, [diagnosis.beside, diagnosis.amended])
    return _clip(robot, motion, int(begins[chosen]), span, changes)


def _windows(robot: Robot, motion: Motion) -> tuple[NDArray[np.int64], int]:
    """First rows (Q,) of windows among those of all trials, and how many samples they have.

    Raises:
        FilmError: no trial is long enough.
    """
    counts = [len(path) for path in motion.paths]
    span = int(min(_CLIP_S * motion.rate_hz, _SHARE_OF_TRIAL * max(counts)))
    begins = []
    first = 0
    for count in counts:
        inner = inner_rows(count, motion.rate_hz, motion.smoothed_hz)
        begins.append(first + np.arange(inner.start, inner.stop - span, span))
        first += count
    begin = np.concatenate(begins)
    if span < _FEWEST_SAMPLES or not len(begin):
        raise FilmError("the trials are too short")
    steps = np.ceil(span / motion.rate_hz / robot.model.opt.timestep)
    most = int(np.clip(_MOST_STEPS / steps, 1, _MOST_WINDOWS))
    return begin[:: -(-len(begin) // most)], span


def _clip(
    robot: Robot, motion: Motion, begin: int, span: int, changes: Mapping[str, Change]
) -> Clip:
    """The window from one row on, with the motion of each variant by its label."""
    rollouts = Rollouts(robot, motion, np.array([begin]), span)
    measured, _speed = rollouts.measured(begin + np.arange(span + 1))
    predictions = []
    for label, change in changes.items():
        position, _speed = rollouts.predicted(change)
        from_measured = np.concatenate([measured[:1], position[0]])
        predictions.append(Prediction(label, _COLOURS[label], _in_frames(from_measured)))
    lengths = np.cumsum([0, *map(len, motion.paths)])
    number = int(np.searchsorted(lengths, begin, side="right")) - 1
    trial = motion.trials[number]
    return Clip(
        trial=trial.label,
        begin_s=float(trial.time_s[begin - lengths[number]]),
        span_s=span / motion.rate_hz,
        measured=_in_frames(measured),
        predictions=tuple(predictions),
    )


def _in_frames(position: Array) -> Array:
    """(F, J) of evenly spaced positions (T, J), straight on between them."""
    frame_rows = np.linspace(0.0, len(position) - 1.0, round(_SHOWN_S * rendering.FRAMES_HZ))
    rows = np.arange(len(position))
    return np.column_stack([np.interp(frame_rows, rows, joint) for joint in position.T])


def rendered_film(model: mujoco.MjModel, clip: Clip) -> tuple[bytes, bytes]:
    """An animation and its last frame as WebP files: a panel for each prediction, side by side.

    Raises:
        FilmError: no driver renders here.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / rendering.MODEL))
        np.savez(
            folder / rendering.POSITIONS,
            measured=clip.measured,
            predicted=np.array([prediction.position for prediction in clip.predictions]),
            colours=np.array([_rgb(prediction.colour) for prediction in clip.predictions]),
        )
        chosen = os.environ.get("MUJOCO_GL")
        refusals = []
        for driver in [chosen] if chosen else _DRIVERS:
            refusal = _refusal_of(driver, folder)
            if not refusal:
                animation = (folder / rendering.ANIMATION).read_bytes()
                return animation, (folder / rendering.POSTER).read_bytes()
            refusals.append(f"{driver}: {refusal}")
    reasons = "; ".join(refusals)
    raise FilmError(f"no driver for graphics (EGL or OSMesa) renders here ({reasons})")


def _refusal_of(driver: str, folder: Path) -> str:
    """Render the film of a folder by a driver; why that failed, empty if it did not."""
    command = [sys.executable, "-m", rendering.__name__, str(folder)]
    environment = {**os.environ, "MUJOCO_GL": driver}
    try:
        ended = subprocess.run(
            command,
            env=environment,
            capture_output=True,
            timeout=_RENDERED_S,
            check=False,
            text=True,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        return f"not done within {_RENDERED_S:g} s"
    except OSError as error:
        return str(error)
    if ended.returncode == 0:
        return ""
    lines = ended.stderr.split("\n")
    last_lines = [line.strip() for line in lines if line.strip()]
    return last_lines[-1] if last_lines else f"it ended with {ended.returncode}"


def _rgb(colour: str) -> list[float]:
    """Red, green and blue from 0 to 1 of a colour as pages write it, `#RRGGBB`."""
    return [channel / 255.0 for channel in bytes.fromhex(colour.removeprefix("#"))]
