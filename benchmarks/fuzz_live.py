"""Edited CAN frames to the driver's reading path, and edited messages to an estimation.

An oracle reads the frames' bytes by `struct`, as the amplifiers' manuals define them. A sample is
right if each of its tensions was carried, in the range, by a well-formed frame of that channel in
its cycle or the next, in which a reader gives it. Bytes that spell another plausible value cannot
be recognised as wrong.

Another reads each message by rosbags, which the estimator does not use. A contact is right if the
bytes are a message with every cable's plausible tension and a present stamp, and if the model
estimates that contact from those tensions; from anything else there must be none.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import can
import numpy as np
from estimation_settings import estimation_settings
from fuzz_edits import Draw, FalseAnswerError, Outcome, edited, edited_bytes, require_one_line
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from cablesense_base import Array
from cablesense_online.answer import Answer
from cablesense_online.can.assembler import Sample
from cablesense_online.can.bus import CanInterface, FaultLedger
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import frame_line, line_frame
from cablesense_online.can.reader import SCATTER_OF_READING_S, TensionReader
from cablesense_online.estimation import Estimation
from cablesense_online.samples import PLAUSIBLE_N
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

CYCLES = 20
START_S = 1.7e9
_STAMPS_S = (0.0, -1.0, math.nan, math.inf, 1e300, 5.0, 1e-3, START_S)
_FD_SIZES = (0, 8, 12, 16, 20, 24, 32, 48, 64)


_opened = cache(open_channel_map)


class _Amplifier:
    """One of the bundled maps with the oracle's own reading of its bytes."""

    def __init__(self, name: str) -> None:
        self.map, self.database = _opened(name)
        self.packed = self.map.counter is not None

    def cycle(self, rng: random.Random, number: int) -> list[can.Message]:
        """Frames of a cycle of the real amplifier with random tensions."""
        if self.packed:
            contents = [(0x120, bytes([number % 256]))]
            for id_ in range(0x121, 0x124):
                raws = [rng.randint(-400, 30_000) for _ in range(4)]
                contents.append((id_, struct.pack("<4h", *raws)))
        else:
            raws = [rng.randint(-40_000, 4_900_000) for _ in range(12)]
            contents = [(0x181 + k, struct.pack("<iB", raw, 0)) for k, raw in enumerate(raws)]
        start_s = START_S + number * self.map.cycle_time_s
        return [
            can.Message(
                arbitration_id=id_, is_extended_id=False, data=data, timestamp=start_s + k * 1e-4
            )
            for k, (id_, data) in enumerate(contents)
        ]

    def opens(self, frame: can.Message) -> bool:
        """Whether it is a counter frame as the manual has it."""
        counter = self.packed and frame.arbitration_id == 0x120 and len(frame.data) == 1
        return counter and _plain(frame)

    def values(self, frame: can.Message) -> Iterator[tuple[int, float]]:
        """(channel, N) of a well-formed frame, those in range alone."""
        if not _plain(frame):
            return
        found = []
        if self.packed and 0x121 <= frame.arbitration_id <= 0x123 and len(frame.data) == 8:
            first = 4 * (frame.arbitration_id - 0x121)
            raws = struct.unpack("<4h", frame.data)
            found = [(first + k, 0.1 * raw) for k, raw in enumerate(raws)]
        elif not self.packed and 0x181 <= frame.arbitration_id <= 0x18C and len(frame.data) == 5:
            raw, status = struct.unpack("<iB", frame.data)
            if not status & 0x07:
                found = [(frame.arbitration_id - 0x181, 1e-3 * raw)]
        low, high = self.map.range_n
        yield from (value for value in found if low < value[1] < high)


def _plain(frame: can.Message) -> bool:
    return not (
        frame.is_error_frame or frame.is_remote_frame or frame.is_fd or frame.is_extended_id
    )


class _Witness:
    """Gets every frame that the reader gets, and judges each sample."""

    def __init__(self, amplifier: _Amplifier, skew_limit_s: float) -> None:
        self._amplifier = amplifier
        self._skew_limit_s = skew_limit_s
        self._before: list[list[float]] = [[] for _ in amplifier.map.channels]
        self._carried = self._before
        self._forget()

    def take(self, frame: can.Message) -> None:
        if self._amplifier.opens(frame):
            self._forget()
        for channel, tension_n in self._amplifier.values(frame):
            self._carried[channel].append(tension_n)

    def judge(self, sample: Sample, now_s: float) -> None:
        low, high = self._amplifier.map.range_n
        for channel, tension_n in enumerate(sample.tensions_n.tolist()):
            sent = self._before[channel] + self._carried[channel]
            carried = any(abs(tension_n - sent_n) < 1e-9 for sent_n in sent)
            if not (low < tension_n < high and carried):
                carried_n = f"the frames of its cycle carried {sent[:5]}"
                raise FalseAnswerError(f"channel {channel} reads {tension_n} N; {carried_n}")
        if not abs(sample.skew_s) <= self._skew_limit_s + 1e-6:
            raise FalseAnswerError(f"a sample over {sample.skew_s} s")
        if not abs(sample.time_s - now_s) < 10.0:
            raise FalseAnswerError(f"a sample of {sample.time_s} s, taken at {now_s} s")
        if not self._amplifier.packed:
            self._forget()

    def _forget(self) -> None:
        """The cycle is over; a reader gives its sample during the next."""
        self._before = self._carried
        self._carried = [[] for _ in self._amplifier.map.channels]


def check_frames(draw: Draw) -> Outcome:
    """An example is a sequence of some hundred frames into a new reader.

    Frames make samples: `refused` counts those withheld, `taken` those given.
    """
    amplifier = _Amplifier(draw(st.sampled_from(("twelve_channel_amplifier", "cia404_amplifier"))))
    interface = draw(st.sampled_from(("virtual", "slcan")))
    reader = TensionReader(
        amplifier.map, amplifier.database, CanInterface(interface, "fuzz"), FaultLedger()
    )
    skew_s = SCATTER_OF_READING_S if interface == "slcan" else 0.0
    witness = _Witness(amplifier, max(amplifier.map.skew_limit_s, skew_s))
    rng = draw(st.randoms(use_true_random=True))
    frames = [one for n in range(CYCLES) for one in amplifier.cycle(rng, n)]
    taken, arrival_s = 0, START_S
    gap_s = amplifier.map.cycle_time_s / (4 if amplifier.packed else 12)
    odd = rng.choice((0.0, 0.0, 0.3))
    reopened = draw(st.integers(0, 20 * len(frames)))
    sent = _changed(draw, edited(draw, frames, most=20))
    for number, frame in enumerate(sent):
        arrival_s += rng.choice((1e-6, 0.01)) if rng.random() < odd else gap_s
        witness.take(frame)
        sample = reader.take(frame, arrival_s)
        if sample is not None:
            witness.judge(sample, arrival_s)
            taken += 1
        if number == reopened:
            reader.reopened()
    return Outcome(inputs=len(sent), taken=taken, refused=reader.withheld)


def _changed(draw: Draw, frames: list[can.Message]) -> list[can.Message]:
    """Frames, a few or all in a row of which are changed in their bytes, ids or kinds."""
    rows = st.sampled_from((1, 1, 4, 30))
    for _ in range(draw(st.integers(0, 6)) if frames else 0):
        first = draw(st.integers(0, len(frames) - 1))
        for at in range(first, min(len(frames), first + draw(rows))):
            frames[at] = _changed_frame(draw, frames[at])
    return frames


def _changed_frame(draw: Draw, frame: can.Message) -> can.Message:
    data, number = bytes(frame.data), frame.arbitration_id
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
        data = data.ljust(next(size for size in _FD_SIZES if size >= len(data)), b"\x00")
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
    if not line.upper().startswith(again.upper()):
        raise FalseAnswerError(f"the line {line!r} was read as {again!r}")
    received.timestamp = frame.timestamp
    return received


_KIND = "sensor_msgs/msg/JointState"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_DEFINITION = _STORE.get_msgdef(_KIND)

MESSAGES = 10
TARED_NS = 10**18
SETTINGS = estimation_settings()
ARM = open_arm("cdsm")
PUSHES = 40

_NUMBERS = [math.nan, math.inf, -math.inf, 1e308, 1e6, -21.0, 57.0, 1.0, -0.6, 5e-324]
_NAMES = ["", "cable_1", "cable_13", "joint_1_pitch", "cable_1\0", "\0", "é" * 40]
_OTHER_NUMBERS = st.sampled_from([*([number] for number in _NUMBERS), [0.0] * 10_000])
_OTHER_NAMES = st.sampled_from([*([name] for name in _NAMES), ["x"] * 5000])
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
            names = edited(draw, names, _OTHER_NAMES, most=2)
        case _:
            efforts = edited(draw, efforts, _OTHER_NUMBERS, most=2)
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


def check_messages(draw: Draw) -> Outcome:
    """An example is some edited messages, with good ones between, to a tared estimation."""
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
