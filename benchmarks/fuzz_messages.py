"""Edited serialized messages to an estimation, without ROS.

An oracle reads each message by rosbags, which the estimator does not use. A contact is right if
the bytes are a message with every cable's plausible tension and a present stamp, and if the model
estimates that contact from those tensions; from anything else there must be none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from estimation_settings import estimation_settings
from fuzz_edits import (
    Check,
    Draw,
    FalseAnswerError,
    Outcome,
    edited,
    edited_bytes,
    require_one_line,
)
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from cablesense_base import Array
from cablesense_online.answer import Answer
from cablesense_online.estimation import Estimation
from cablesense_online.samples import PLAUSIBLE_N
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

_KIND = "sensor_msgs/msg/JointState"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_DEFINITION = _STORE.get_msgdef(_KIND)

MESSAGES = 10
TARED_NS = 10**18
SETTINGS = estimation_settings()
ARM = open_arm("cdsm")
PUSHES = 40

_NUMBERS = [
    *([n] for n in (math.nan, math.inf, -math.inf, 1e308, 1e6, -21.0, 57.0, 1.0, -0.6, 5e-324)),
    [0.0] * 10_000,
]
_NAMES = [
    *(
        [name]
        for name in ("", "cable_1", "cable_13", "joint_1_pitch", "cable_1\0", "\0", "é" * 40)
    ),
    ["x"] * 5000,
]
_STAMPS_NS = (-(2**31) * 10**9, 2**31 * 10**9 - 1)


class Content(NamedTuple):
    """The parts of a message that the estimator reads."""

    stamp_ns: int
    tensions_n: dict[str, float]


def joint_state(
    stamp_ns: int,
    efforts: Sequence[float] | Array,
    names: Sequence[str] = ARM.cable_names,
    frame_id: str = "base_link",
    position: Sequence[float] = (),
    little: bool = True,
) -> bytes:
    """A serialized message."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    time_of = _STORE.types["builtin_interfaces/msg/Time"]
    stamp = time_of(min(max(seconds, -(2**31)), 2**31 - 1), nanoseconds)
    header = _STORE.types["std_msgs/msg/Header"](stamp, frame_id)
    numbers = (np.array(one, dtype=np.float64) for one in (position, (), efforts))
    message = _STORE.types[_KIND](header, list(names), *numbers)
    return bytes(_STORE.serialize_cdr(message, _KIND, little_endian=little))


def content_of(raw: bytes) -> Content | None:
    """The content of a joint state with a plausible tension of every cable; else None.

    More may stand behind it.
    """
    try:
        if raw[0] != 0 or raw[1] > 1:
            return None
        read = _DEFINITION.deserialize_cdr_le if raw[1] else _DEFINITION.deserialize_cdr_be
        message: Any = read(raw[4:], 0, _DEFINITION.cls, _STORE)[0]
        tensions_n = dict(zip(message.name, map(float, message.effort), strict=True))
    except Exception:  # whatever fails, it is no message
        return None
    stamp, (low_n, high_n) = message.header.stamp, PLAUSIBLE_N
    every = len(message.name) == len(tensions_n) and set(tensions_n) == set(ARM.cable_names)
    within = all(low_n < tension_n < high_n for tension_n in tensions_n.values())
    if not every or not within or stamp.nanosec >= 10**9:
        return None
    return Content(stamp.sec * 10**9 + stamp.nanosec, tensions_n)


def edited_joint_state(draw: Draw, stamp_ns: int, tensions_n: Array) -> bytes:
    """The message of a sample changed in its bytes, or written with other fields."""
    if draw(st.booleans()):
        return edited_bytes(draw, joint_state(stamp_ns, tensions_n), most=3)
    names, efforts = list(ARM.cable_names), tensions_n.tolist()
    more: dict[str, Any] = {}
    match draw(st.sampled_from(("stamp", "frame", "position", "names", "efforts", "both"))):
        case "stamp":
            near = st.sampled_from((0, 1, stamp_ns - 10**9, stamp_ns + 10**9, *_STAMPS_NS))
            stamp_ns = draw(near)
        case "frame":
            more["frame_id"] = draw(st.sampled_from(("", "x" * 3000, "\0")))
            more["little"] = draw(st.booleans())
        case "position":
            more["position"] = [math.nan] * draw(st.sampled_from((1, 12, 5000)))
        case "both":
            order = draw(st.permutations(range(len(names))))
            names, efforts = [names[at] for at in order], [efforts[at] for at in order]
        case "names":
            names = edited(draw, names, st.sampled_from(_NAMES), most=2)
        case _:
            efforts = edited(draw, efforts, st.sampled_from(_NUMBERS), most=2)
    return joint_state(stamp_ns, efforts, names, **more)


@cache
def rig() -> tuple[Estimator, Array, Array]:
    """The arm's model; tensions (M,) of the straight arm, and (P, M) pushed on segment 1, 2, …."""
    rng, rows = np.random.default_rng(0), np.arange(PUSHES)
    mechanism, straight = mechanism_of(ARM), np.zeros((PUSHES, ARM.joint_count))
    angles_deg, forces_n = rng.uniform(0.0, 360.0, PUSHES), rng.uniform(5.0, 150.0, PUSHES)
    segments = 1 + rows % ARM.segment_count
    forces = normal_force_n(mechanism, straight, segments, angles_deg, forces_n)
    unloaded_n = solve_equilibrium(mechanism, straight[0]).tensions_n
    pushed_n = solve_equilibrium(mechanism, straight, forces).tensions_n
    return Estimator.load(find_model("cdsm"), ARM), unloaded_n, pushed_n


class TaredEstimation:
    """A tared estimation with its clock, and the judge of its answers."""

    def __init__(self) -> None:
        self._model, unloaded_n, self.pushed_n = rig()
        self.estimation = Estimation(ARM, self._model, SETTINGS, 0.0)
        self.now_ns = TARED_NS
        for _ in range(SETTINGS.tare_samples):
            self.take(joint_state(self.next_ns, unloaded_n))

    @property
    def next_ns(self) -> int:
        """When the next message will be taken, 10 ms after the one before."""
        return self.now_ns + 10**7

    def take(self, raw: bytes) -> Answer:
        """The answer to a message.

        Raises:
            FalseAnswerError: a contact that does not follow from the message.
        """
        self.now_ns = self.next_ns
        answer = self.estimation.sample(raw, self.now_ns, (self.now_ns - TARED_NS) * 1e-9)
        if answer.problem is not None:
            require_one_line(answer.problem)
        contact = answer.contact
        if contact.segment == 0:
            return answer
        content = content_of(raw)
        if content is None:
            raise FalseAnswerError(f"a contact from no message of this arm: {raw.hex()[:400]}")
        tensions = [content.tensions_n[name] for name in ARM.cable_names]
        if content.stamp_ns and abs(content.stamp_ns - self.now_ns) > 0.2e9:
            raise FalseAnswerError(f"a contact from {content.stamp_ns - self.now_ns} ns ago")
        right = self._model.estimate(
            np.array(tensions) - self.estimation.tares.unloaded_n, np.zeros(ARM.joint_count)
        )
        if (right.angle_deg, right.magnitude_n) != (contact.angle_deg, contact.magnitude_n):
            raise FalseAnswerError(f"{contact} where the model estimates {right}")
        return answer

    def take_pushed(self) -> Answer:
        """The answer to a good message of a push on segment 1."""
        return self.take(joint_state(self.next_ns, self.pushed_n[0]))


def messages_check() -> Check:
    """Examples are some edited messages, with good ones between, to a tared estimation."""

    def check(draw: Draw) -> Outcome:
        tared = TaredEstimation()
        refused = 0
        for _ in range(MESSAGES):
            tensions_n = tared.pushed_n[draw(st.integers(0, PUSHES - 1))]
            if draw(st.booleans()):
                tared.take(joint_state(tared.next_ns, tensions_n))
            raw = edited_joint_state(draw, tared.next_ns, tensions_n)
            refused += tared.take(raw).problem is not None
        tared.now_ns += 10**9
        if tared.take_pushed().contact.segment != 1:
            raise FalseAnswerError("a good message after bad ones was not answered")
        return Outcome(inputs=MESSAGES, refused=refused, taken=MESSAGES - refused)

    return check
