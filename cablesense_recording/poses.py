"""Poses of frames that were tracked from outside, which make the positions of joints.

A camera or a tracker gives places of markers, or poses, of a machine whose joints have no
sensors. Whoever knows the machine's kinematics makes joint positions of them, from which on the
recording is like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from cablesense_base import Array, some_of
from cablesense_recording.channels import (
    POSE_PLACE,
    POSE_QUATERNION,
    TRIAL,
    Kind,
    RobotChannels,
    pose_labels,
)
from cablesense_recording.recording import RecordingError

_UNIT = 0.05
"""A quaternion is one whose length is 1 but for this."""


class Kinematics(Protocol):
    """What makes joint positions of poses."""

    def positions(
        self, poses: Mapping[str, Array], known: Array, restarts: Sequence[int] = ()
    ) -> tuple[Array, list[str]]:
        """Joint positions (R, J) and sentences, by poses (R, 3) or (R, 7) of frames.

        `known` is (R, J), NaN for joints that were not measured. In the rows `restarts` the
        machine may be anywhere.

        Raises:
            RecordingError: the poses do not determine the joints.
        """
        ...


def with_positions(
    path: Path, table: dict[str, Array], channels: RobotChannels, kinematics: Kinematics | None
) -> tuple[dict[str, Array], list[str]]:
    """The table with the positions of all joints in place of its poses, and sentences.

    Poses are left out where all joints were measured.

    Raises:
        RecordingError: poses of unknown frames, with parts missing, with gaps, without a unit
            quaternion, or that do not determine the joints.
    """
    named = [column for column in table if column.startswith(f"{Kind.POSE.value}.")]
    without_poses = {column: values for column, values in table.items() if column not in named}
    labels = channels.labels(Kind.POSITION)
    missing = [label for label in labels if label not in table]
    if not named:
        return table, []
    if not missing or kinematics is None:
        return without_poses, ["Poses are not used: all joints have positions."]
    poses = _poses(path, table, named, channels)
    rows = len(table[named[0]])
    known = np.full((rows, len(labels)), np.nan)
    for joint, label in enumerate(labels):
        if label in table:
            known[:, joint] = table[label]
    try:
        positions, sentences = kinematics.positions(poses, known, _restarts(table))
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    return without_poses | dict(zip(labels, positions.T, strict=True)), sentences


def _poses(
    path: Path, table: Mapping[str, Array], named: Sequence[str], channels: RobotChannels
) -> dict[str, Array]:
    """Places (R, 3) or poses (R, 7) by frame."""
    frames = dict.fromkeys(
        column.removeprefix(f"{Kind.POSE.value}.").rpartition(".")[0] for column in named
    )
    unknown = [frame for frame in frames if frame not in channels.frames]
    if unknown:
        raise RecordingError(
            f"{path}: has poses of {some_of(unknown)}, which the model has not; {channels.model} "
            f"has the bodies and sites {some_of(channels.frames, 12) or 'none with a name'}"
        )
    poses = {}
    for frame in frames:
        labels = pose_labels(frame)
        present = [label for label in labels if label in table]
        places = labels[: len(POSE_PLACE)]
        lacking = [label for label in labels if label not in table]
        if lacking and present != places:
            raise RecordingError(
                f"{path}: misses {some_of(lacking, 7)}; a pose has {', '.join(POSE_PLACE)} in m, "
                f"and {', '.join(POSE_QUATERNION)} or none of these"
            )
        pose = np.column_stack([table[label] for label in present])
        _refuse_gaps(path, frame, pose)
        if len(present) == len(labels):
            _refuse_other_quaternions(path, frame, pose[:, 3:])
        poses[frame] = pose
    return poses


def _refuse_gaps(path: Path, frame: str, pose: Array) -> None:
    complete = np.asarray(np.isfinite(pose).all(axis=1))
    rows = np.flatnonzero(complete)
    if not rows.size:
        raise RecordingError(f"{path}: pose.{frame} is empty in every row")
    gaps = np.flatnonzero(~complete[rows[0] : rows[-1]]) + rows[0]
    if gaps.size:
        more = f" and {len(gaps) - 1} more" if len(gaps) > 1 else ""
        raise RecordingError(
            f"{path}: row {gaps[0] + 1}{more}, pose.{frame}: empty or not finite, as when a "
            "tracker loses it; leave these rows out"
        )


def _refuse_other_quaternions(path: Path, frame: str, quaternion: Array) -> None:
    length = np.linalg.norm(np.nan_to_num(quaternion, nan=0.5), axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > _UNIT)
    if wrong.size:
        raise RecordingError(
            f"{path}: row {wrong[0] + 1}, pose.{frame}: its quaternion has the length "
            f"{length[wrong[0]]:.3g}; it must be 1"
        )


def _restarts(table: Mapping[str, Array]) -> list[int]:
    """Rows in which another trial begins."""
    if TRIAL not in table:
        return []
    return (np.flatnonzero(np.diff(table[TRIAL]) != 0.0) + 1).tolist()
