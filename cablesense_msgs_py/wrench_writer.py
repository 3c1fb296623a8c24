"""A writer of serialized `geometry_msgs/WrenchStamped` (CDR), faster than filling a message."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from cablesense_msgs_py.frames import Frames

_LITTLE_ENDIAN = b"\0\1\0\0"


class WrenchWriter:
    """Writes wrenches in one frame."""

    def __init__(self, frame_id: str) -> None:
        text = frame_id.encode() + b"\0"
        before = 4 + 8 + 4 + len(text)
        padding = (4 - before) % 8  # numbers of eight bytes align from after the encapsulation
        self._layout = struct.Struct(f"<4siII{len(text)}s{padding}x6d")
        self._length = len(text)
        self._text = text

    def write(self, stamp_ns: int, wrench: Sequence[float]) -> bytes:
        """A stamped message of a force, N, and a torque, N·m: (6,) together."""
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        return self._layout.pack(
            _LITTLE_ENDIAN,
            seconds,
            nanoseconds,
            self._length,
            self._text,
            *wrench,
        )


def wrench_writers(frames: Frames) -> list[WrenchWriter]:
    """Writers in the base frame, for no contact, and in the frames of segments 1 … N."""
    names = (frames.base, *(frames.segment(n + 1) for n in range(frames.segment_count)))
    return [WrenchWriter(name) for name in names]
