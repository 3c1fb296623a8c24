"""Edited CAN frames to the driver's reading path, and edited messages to an estimation.

An oracle reads the frames' bytes by `struct`, as the amplifiers' manuals define them. A sample is
right if each of its tensions was carried, in the range, by a well-formed frame of that channel in
its cycle or the next, in which a reader gives it. Bytes that spell another plausible value cannot
be recognised as wrong.

Another reads each message by rclpy, which the estimator does not use. A contact, or that nothing
touches, is right if the bytes are a message with every cable's plausible tension and a present
stamp, and if the law finds the same in those tensions; from anything else there must be none.
"""

from __future__ import annotations

import math
import random
import struct
from collections import deque
from functools import cache
from typing import Any

import can
import numpy as np
from can.util import dlc2len, len2dlc
from estimation_settings import estimation_settings
from fuzz_edits import Draw, Tally, Target, edited, edited_bytes, require, require_one_line
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from cablesense_base import Array
from cablesense_contact.felt_arm import FeltArm
from cablesense_online.answer import Answer
from cablesense_online.can.assembler import AssembledSample
from cablesense_online.can.bus import CanInterface, FaultLedger
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import Emulator, frame_line, line_frame
from cablesense_online.can.reader import SCATTER_OF_READING_S, TensionReader
from cablesense_online.contacts import LawContacts, Situation
from cablesense_online.estimation import Estimation
from cablesense_online.models import LoadedModel, load_model
from cablesense_online.samples import PLAUSIBLE_N
from cablesense_online.tare import with_reading
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n

MAPS = ("twelve_channel_amplifier", "cia404_amplifier")
CYCLES = 20
START_S = 1.7e9
_STAMPS_S = (0.0, -1.0, math.nan, math.inf, 1e300, 5.0, 1e-3, START_S)

_opened = cache(open_channel_map)


class _Amplifier:
    """Amplifiers of a bundled map by their manual: the frames they send, and what frames carry.

    It gets every frame that the reader gets, and judges each sample.
    """

    def __init__(self, name: str) -> None:
        self.map, self.database = _opened(name)
        self.packed = self.map.counter is not None
        started = self.map.model_copy(update={"nmt_start_nodes": ()})
        self._emulator = Emulator(started, self.database, lambda: can.Bus("fuzz", "virtual"))
        self._emulator.close()
        self._carried: deque[set[tuple[int, float]]] = deque([set()], maxlen=2)

    def cycle(self, rng: random.Random, number: int) -> list[can.Message]:
        """Frames of a cycle with random tensions."""
        frames = self._emulator.frames([rng.uniform(-40.0, 3_000.0) for _ in self.map.channels])
        for place, frame in enumerate(frames):
            frame.timestamp = START_S + number * self.map.cycle_time_s + place * 1e-4
        return frames

    def take(self, frame: can.Message) -> None:
        """Note the readings of a well-formed frame, (channel, N), those in range alone."""
        id_ = frame.arbitration_id
        data = frame.data
        kinds = (frame.is_error_frame, frame.is_remote_frame, frame.is_fd, frame.is_extended_id)
        if any(kinds):
            return
        readings = []
        if self.packed and id_ == 0x120 and len(data) == 1:
            self._end_cycle()
        elif self.packed and 0x121 <= id_ <= 0x123 and len(data) == 8:
            raws = enumerate(struct.unpack("<4h", data), 4 * (id_ - 0x121))
            readings = [(channel, 0.1 * raw) for channel, raw in raws]
        elif not self.packed and 0x181 <= id_ <= 0x18C and len(data) == 5:
            raw, status = struct.unpack("<iB", data)
            readings = [] if status & 0x07 else [(id_ - 0x181, 1e-3 * raw)]
        low, high = self.map.range_n
        self._carried[-1].update((k, round(n, 6)) for k, n in readings if low < n < high)

    def judge(self, sample: AssembledSample, now_s: float, skew_limit_s: float) -> None:
        """Raise a `FalseAnswerError` for a sample that no frames of its cycle or the last make."""
        for reading in enumerate(sample.tensions_n.round(6).tolist()):
            carried = any(reading in cycle for cycle in self._carried)
            require(carried, f"no frame of its cycle carried (channel, N) {reading}")
        require(abs(sample.skew_s) <= skew_limit_s + 1e-6, f"a sample over {sample.skew_s} s")
        near = abs(sample.time_s - now_s) < 10.0
        require(near, f"a sample of {sample.time_s} s, taken at {now_s} s")
        if not self.packed:
            self._end_cycle()

    def _end_cycle(self) -> None:
        """A reader gives a cycle's sample during the next."""
        self._carried.append(set())


def check_frames(draw: Draw) -> Tally:
    """An example is a sequence of some hundred frames into a new reader.

    Frames make samples: `refused` counts those withheld, `taken` those given.
    """
    amplifier = _Amplifier(draw(st.sampled_from(MAPS)))
    interface = draw(st.sampled_from(("virtual", "slcan")))
    reader = TensionReader(
        amplifier.map, amplifier.database, CanInterface(interface, "fuzz"), FaultLedger()
    )
    skew_s = SCATTER_OF_READING_S if interface == "slcan" else 0.0
    skew_limit_s = max(amplifier.map.skew_limit_s, skew_s)
    rng = draw(st.randoms(use_true_random=True))
    frames = [message for n in range(CYCLES) for message in amplifier.cycle(rng, n)]
    taken = 0
    arrival_s = START_S
    gap_s = CYCLES * amplifier.map.cycle_time_s / len(frames)
    odd = rng.choice((0.0, 0.0, 0.3))
    reopened = draw(st.integers(0, 20 * len(frames)))
    sent = _changed(draw, edited(draw, frames, most=20))
    for number, frame in enumerate(sent):
        arrival_s += rng.choice((1e-6, 0.01)) if rng.random() < odd else gap_s
        amplifier.take(frame)
        sample = reader.take(frame, arrival_s)
        if sample is not None:
            amplifier.judge(sample, arrival_s, skew_limit_s)
            taken += 1
        if number == reopened:
            reader.reopened()
    return Tally(inputs=len(sent), taken=taken, refused=reader.withheld)


def _changed(draw: Draw, frames: list[can.Message]) -> list[can.Message]:
    """Frames, a few or all in a row of which are changed in their bytes, ids or kinds."""
    rows = st.sampled_from((1, 1, 4, 30))
    for _ in range(draw(st.integers(0, 6)) if frames else 0):
        first = draw(st.integers(0, len(frames) - 1))
        for index in range(first, min(len(frames), first + draw(rows))):
            frames[index] = _changed_frame(draw, frames[index])
    return frames


def _changed_frame(draw: Draw, frame: can.Message) -> can.Message:
    data = bytes(frame.data)
    number = frame.arbitration_id
    changed: dict[str, Any] = {"is_extended_id": False, "timestamp": frame.timestamp}
    match draw(st.sampled_from(("data", "data", "line", "id", "extended", "kind", "stamp"))):
        case "data":
            data = (edited_bytes(draw, data, most=2) or data)[: draw(st.sampled_from((8, 8, 64)))]
        case "line":
            return _through_a_line(draw, frame)
        case "id":
            number = draw(st.integers(0, 2**11 - 1) | st.integers(0x11F, 0x18D))
        case "extended":
            changed["is_extended_id"] = True
            number = draw(st.just(number) | st.integers(0, 2**29 - 1))
        case "kind":
            changed[draw(st.sampled_from(("is_remote_frame", "is_error_frame", "is_fd")))] = True
        case _:
            near_s = st.floats(-0.01, 0.01).map(lambda off_s: frame.timestamp + off_s)
            changed["timestamp"] = draw(st.sampled_from(_STAMPS_S) | near_s)
    if len(data) > 8 or "is_fd" in changed:
        changed["is_fd"] = True
        data = data.ljust(dlc2len(len2dlc(len(data))), b"\x00")
    if "is_remote_frame" in changed:
        data = b""
    return can.Message(arbitration_id=number, data=data, **changed)


def _through_a_line(draw: Draw, frame: can.Message) -> can.Message:
    """Through a line of a serial adapter, which loses and changes characters."""
    line = edited_bytes(draw, frame_line(frame) or b"", most=2)
    try:
        received = line_frame(line)
    except ValueError:
        return frame
    again = frame_line(received) or b""
    require(line.upper().startswith(again.upper()), f"the line {line!r} was read as {again!r}")
    received.timestamp = frame.timestamp
    return received


MESSAGES = 10
TARED_NS = 10**18
SETTINGS = estimation_settings()
ARM = open_arm("cdsm")
STRAIGHT = np.zeros(ARM.joint_count)

_NUMBERS = [math.nan, math.inf, -math.inf, 1e308, 1e6, -21.0, 57.0, 1.0, -0.6, 5e-324]
_NAMES = ["", "cable_1", "cable_13", "joint_1_pitch", "cable_1\0", "\0", "é" * 40]
_OTHER_NUMBERS = st.sampled_from([*([number] for number in _NUMBERS), [0.0] * 10_000])
_OTHER_NAMES = st.sampled_from([*([name] for name in _NAMES), ["x"] * 5000])
_STAMPS_NS = (-(2**31) * 10**9, 2**31 * 10**9 - 1)


def joint_state(stamp_ns: int, tensions_n: Array) -> JointState:
    """The message of a sample."""
    message = JointState(name=list(ARM.cable_names), effort=tensions_n.tolist())
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


def content_of(raw: bytes) -> tuple[int, Array]:
    """Stamp, ns, and tensions (M,) in a message with a plausible one of every cable.

    Raises:
        FalseAnswerError: the bytes begin with no such message. More may stand behind it.
    """
    message = deserialize_message(raw, JointState)
    by_name = dict(zip(message.name, message.effort, strict=True))
    complete = len(message.name) == len(by_name) and set(by_name) == set(ARM.cable_names)
    low_n, high_n = PLAUSIBLE_N
    plausible = all(low_n < tension_n < high_n for tension_n in by_name.values())
    stamp = message.header.stamp
    require(complete and plausible and stamp.nanosec < 10**9, f"no message of this arm: {message}")
    tensions_n = np.array([by_name[name] for name in ARM.cable_names])
    return stamp.sec * 10**9 + stamp.nanosec, tensions_n


def edited_joint_state(draw: Draw, stamp_ns: int, tensions_n: Array) -> bytes:
    """The message of a sample changed in its bytes, or written with other fields."""
    message = joint_state(stamp_ns, tensions_n)
    match draw(st.sampled_from(("bytes", "stamp", "frame", "position", "names", "efforts"))):
        case "bytes":
            return edited_bytes(draw, serialize_message(message), most=3)
        case "stamp":
            near = (0, 1, stamp_ns - 10**9, stamp_ns + 10**9)
            message = joint_state(draw(st.sampled_from((*near, *_STAMPS_NS))), tensions_n)
        case "frame":
            message.header.frame_id = draw(st.sampled_from(("", "x" * 3000, "\0")))
        case "position":
            message.position = [math.nan] * draw(st.sampled_from((1, 12, 5000)))
        case "names":
            message.name = edited(draw, message.name, _OTHER_NAMES, most=2)
        case _:
            message.effort = edited(draw, message.effort, _OTHER_NUMBERS, most=2)
    return bytes(serialize_message(message))


@cache
def rig() -> tuple[LoadedModel, Array, Array]:
    """The model; tensions (M,) of the straight arm, and (N, M) of a push on each segment."""
    mechanism = mechanism_of(ARM)
    straight = np.zeros((ARM.segment_count, ARM.joint_count))
    segments = np.arange(1, ARM.segment_count + 1)
    forces = normal_force_n(mechanism, straight, segments, 70.0 * segments, 40.0)
    unloaded_n = solve_equilibrium(mechanism, straight[0]).tensions_n
    pushed_n = solve_equilibrium(mechanism, straight, forces).tensions_n
    return load_model("cdsm", ""), unloaded_n, pushed_n


class TaredEstimation:
    """A tared estimation with its clock, and the judge of its answers."""

    def __init__(self) -> None:
        loaded, unloaded_n, self.pushed_n = rig()
        self.estimation = Estimation(FeltArm(ARM), loaded.contacts(SETTINGS), SETTINGS, 0.0)
        contacts = loaded.contacts(SETTINGS)
        assert isinstance(contacts, LawContacts)
        self._judge = contacts
        self._known = contacts.unloaded.at(contacts.unloaded.begin(), STRAIGHT)
        self.now_ns = TARED_NS
        for _ in range(SETTINGS.tare_samples):
            self._known = with_reading(self._known, unloaded_n.tolist(), SETTINGS.tare_samples)
            self.take_tensions(unloaded_n)
        self._known = contacts.unloaded.taken(self._known, self.now_ns)

    @property
    def next_ns(self) -> int:
        """When the next message will be taken, 10 ms after the one before."""
        return self.now_ns + 10**7

    def take(self, raw: bytes) -> Answer:
        """The answer to a message.

        Raises:
            FalseAnswerError: a contact, or its absence, that does not follow from the message.
        """
        self.now_ns = self.next_ns
        answer = self.estimation.sample(raw, self.now_ns, (self.now_ns - TARED_NS) * 1e-9)
        if answer.problem is not None:
            require_one_line(answer.problem)
        if answer.estimate is None:
            require(not answer.contacts, f"{answer.contacts} without an estimate")
            return answer
        stamp_ns, tensions_n = content_of(raw)
        age_ns = abs(self.now_ns - stamp_ns) if stamp_ns else 0
        require(age_ns <= 0.2e9, f"a contact from a message {age_ns} ns away")
        situation = Situation(STRAIGHT, stamp_ns or self.now_ns)
        self._known, right = self._judge.find(self._known, tensions_n, situation)
        assert right is not None
        same = tuple(answer.contacts) == right.contacts
        require(same, f"{answer.contacts} where the law finds {right}")
        return answer

    def take_tensions(self, tensions_n: Array) -> Answer:
        """The answer to a good message."""
        return self.take(bytes(serialize_message(joint_state(self.next_ns, tensions_n))))


def check_messages(draw: Draw) -> Tally:
    """An example is some edited messages, with good ones between, to a tared estimation."""
    tared = TaredEstimation()
    refused = 0
    for _ in range(MESSAGES):
        tensions_n = tared.pushed_n[draw(st.integers(0, len(tared.pushed_n) - 1))]
        if draw(st.booleans()):
            tared.take_tensions(tensions_n)
        raw = edited_joint_state(draw, tared.next_ns, tensions_n)
        refused += tared.take(raw).problem is not None
    tared.now_ns += 10**9
    contact = tared.take_tensions(tared.pushed_n[0]).contact
    require(contact.segment == 1, f"a good message after bad ones gives {contact}")
    return Tally(inputs=MESSAGES, refused=refused, taken=MESSAGES - refused)


LIVE_TARGETS = {
    "frames": Target("CAN frames", check_frames, 8_000),
    "messages": Target("messages", check_messages, 10_500),
}
