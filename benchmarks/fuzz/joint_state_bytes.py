"""Serialized `JointState` messages, written and read by rosbags: the estimator uses it not."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_typestore

from fuzz.byte_mutation import mutated_bytes

_KIND = "sensor_msgs/msg/JointState"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_DEFINITION = _STORE.get_msgdef(_KIND)
_HEAD_BYTES = 12


class Said(NamedTuple):
    """What a message says."""

    stamp_ns: int
    names: tuple[str, ...]
    efforts: tuple[float, ...]


def joint_state_bytes(
    stamp_ns: int, names: Sequence[str], efforts: Sequence[float], **more: Any
) -> bytes:
    """A message; `more` are other fields: `frame_id`, `position`, `velocity`, `little`."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    seconds = min(max(seconds, -(2**31)), 2**31 - 1)
    header = _STORE.types["std_msgs/msg/Header"](
        stamp=_STORE.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds),
        frame_id=more.get("frame_id", "base_link"),
    )
    message = _STORE.types[_KIND](
        header=header,
        name=list(names),
        position=np.array(more.get("position", ()), dtype=np.float64),
        velocity=np.array(more.get("velocity", ()), dtype=np.float64),
        effort=np.array(efforts, dtype=np.float64),
    )
    little = more.get("little", True)
    return bytes(_STORE.serialize_cdr(message, _KIND, little_endian=little))


def read_joint_state(raw: bytes) -> Said | None:
    """What the bytes say, or None where they are no such message; more may stand behind it."""
    try:
        if raw[0] != 0 or raw[1] > 1:
            return None
        read = _DEFINITION.deserialize_cdr_le if raw[1] else _DEFINITION.deserialize_cdr_be
        message: Any = read(raw[4:], 0, _DEFINITION.cls, _STORE)[0]
        stamp = message.header.stamp
        said = Said(
            stamp.sec * 10**9 + stamp.nanosec,
            tuple(message.name),
            tuple(float(value) for value in message.effort),
        )
    except Exception:  # whatever it stumbles over, it is no message
        return None
    return said if stamp.nanosec < 10**9 else None


def mutated_joint_state(
    rng: random.Random, raw: bytes, names: Sequence[str], efforts: Sequence[float], stamp_ns: int
) -> bytes:
    """The message changed in its bytes, or written anew with other fields."""
    if rng.random() < 0.5:
        return mutated_bytes(rng, raw, most=3)
    names, efforts, more = list(names), list(efforts), {}
    for _ in range(rng.randint(1, 2)):
        action = rng.randrange(9)
        at = rng.randrange(len(efforts)) if efforts else 0
        if action == 0 and efforts:
            efforts[at] = rng.choice(
                (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e6, -21.0, 5e-324)
            )
        elif action == 1:
            del efforts[at : at + rng.randint(1, 12)]
        elif action == 2 and names:
            names[rng.randrange(len(names))] = rng.choice(
                ("", "cable_1", "cable_13", "rope", "cable_1\0", "é" * 40, "x" * 5000)
            )
        elif action == 3:
            names += rng.choice((["cable_1"], ["x"] * 5000, list(names)))
        elif action == 4:
            efforts += [0.0] * rng.choice((1, 12, 10_000))
        elif action == 5:
            stamp_ns = rng.choice(
                (0, 1, stamp_ns - 10**9, stamp_ns + 10**9, -(2**31) * 10**9, 2**31 * 10**9 - 1)
            )
        elif action == 6:
            more |= {"frame_id": rng.choice(("", "x" * 3000, "\0")), "little": rng.random() < 0.5}
        elif action == 7:
            more |= {"position": [math.nan] * rng.choice((1, 12, 5000)), "velocity": [1.0] * 12}
        else:
            order = list(range(min(len(names), len(efforts))))
            rng.shuffle(order)
            names = [names[i] for i in order]
    written = joint_state_bytes(stamp_ns, names, efforts, **more)
    if rng.random() < 0.2 and len(written) > _HEAD_BYTES:
        at = 4 * rng.randrange(1, len(written) // 4)
        written = written[:at] + struct.pack("<I", rng.getrandbits(32)) + written[at + 4 :]
    return written
