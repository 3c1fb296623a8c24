"""Poses of frames in a bag: `PoseStamped`, `Odometry` and `TFMessage`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cablesense_base import Array
from cablesense_recording.mcap_file import TOPIC_OPTION, decoded
from cablesense_recording.mcap_messages import CountedMessages, RawMessage
from cablesense_recording.recording import MAX_NUMBERS, RecordingError

_POSE: Final = "geometry_msgs/msg/PoseStamped"
_ODOMETRY: Final = "nav_msgs/msg/Odometry"
_TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
POSE_TYPES: Final = (_POSE, _ODOMETRY, _TRANSFORMS)

_LATEST_NS = 2**63 - 1
_WIDTH = 7


@dataclass
class FramePoses(CountedMessages):
    """The poses of one frame from one topic, in the order they came.

    Attributes:
        topic: full name.
        frame: of the model.
        parent: the frame in whose axes the poses are, as the messages name it.
        numbers: by message the place, m, and the quaternion w x y z.
    """

    topic: str
    frame: str
    parent: str

    @property
    def poses(self) -> Array:
        """(R, 7) with quaternions of one sign, so that those between two lie between them."""
        poses = np.array(self.numbers).reshape(-1, _WIDTH)
        products = (poses[1:, 3:] * poses[:-1, 3:]).sum(axis=1)
        sign = np.cumprod(np.append(1.0, np.where(products < 0.0, -1.0, 1.0)))
        poses[:, 3:] *= sign[:, None]
        return poses


def frame_poses(
    path: Path, frames: Collection[str], topics: Sequence[str], counts: Sequence[int]
) -> list[FramePoses]:
    """Poses of the frames that a bag has; `topics` are those to read where several fit.

    `counts` are the numbers of its messages of `POSE_TYPES`, in their order.

    Raises:
        RecordingError: a frame's poses come on several topics or in several axes.
    """
    by_source: dict[tuple[str, str, str], FramePoses] = {}
    number_count = 0
    messages = decoded(path, lambda raw: raw.kind in POSE_TYPES)
    for count, (raw, message) in zip(counts, messages, strict=True):
        for frame, header, place, quaternion in _poses_of(raw, message, frames):
            key = raw.topic, frame, header.frame_id
            source = by_source.setdefault(key, FramePoses(*key))
            stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
            source.counts.extend((count, min(raw.log_ns, _LATEST_NS), stamp_ns))
            source.numbers.extend((place.x, place.y, place.z))
            source.numbers.extend((quaternion.w, quaternion.x, quaternion.y, quaternion.z))
            number_count += 3 + _WIDTH
        if number_count > MAX_NUMBERS:
            raise RecordingError(f"{path}: more than {MAX_NUMBERS} numbers; split it")
    asked = [each for each in by_source.values() if each.topic in topics]
    chosen = asked or list(by_source.values())
    by_frame: dict[str, FramePoses] = {}
    for source in chosen:
        first = by_frame.setdefault(source.frame, source)
        if first is source:
            continue
        if first.topic != source.topic:
            raise RecordingError(
                f"{path}: {first.topic} and {source.topic} both have poses of {source.frame}; "
                f"choose one, as with {TOPIC_OPTION} {first.topic}"
            )
        raise RecordingError(
            f"{path}: {source.topic} has poses of {source.frame} in the axes of "
            f"{first.parent or '(no name)'} and of {source.parent or '(no name)'}; record one, "
            "the model's base"
        )
    return list(by_frame.values())


def _poses_of(
    raw: RawMessage, message: Any, frames: Collection[str]
) -> Iterator[tuple[str, Any, Any, Any]]:
    """Frame, header, place and quaternion of the poses of known frames in a message.

    A transform from one link to the next is no pose in the axes of the base.
    """
    if raw.kind == _TRANSFORMS:
        for each in message.transforms:
            frame = each.child_frame_id.removeprefix("/")
            if frame in frames and each.header.frame_id.removeprefix("/") not in frames:
                transform = each.transform
                yield frame, each.header, transform.translation, transform.rotation
        return
    if raw.kind == _ODOMETRY:
        frame = message.child_frame_id.removeprefix("/")
        pose = message.pose.pose
    else:  # a pose names its axes alone: the topic says whose it is, as /tracker/tip/pose
        words = reversed(raw.topic.split("/"))
        frame = next((word for word in words if word in frames), "")
        pose = message.pose
    if frame in frames:
        yield frame, message.header, pose.position, pose.orientation
