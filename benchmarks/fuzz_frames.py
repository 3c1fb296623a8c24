"""Sequences of edited CAN frames into the driver's reading path, with an independent oracle.

The oracle reads values off the frames' bytes by `struct`, as the amplifiers' manuals define them.
A sample is right if each of its tensions was carried, in the range, by a well-formed frame of that
channel in its cycle or the next, in which a reader gives it. Bytes that spell another plausible
value cannot be recognised as wrong.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator
from typing import Any

import can
from fuzz_edits import Check, Draw, FalseAnswerError, Outcome, edited, edited_bytes
from hypothesis import strategies as st

from cablesense_online.can.assembler import Sample
from cablesense_online.can.bus import CanInterface, FaultLedger
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.reader import SCATTER_OF_READING_S, TensionReader
from cablesense_online.can.slcan import frame_line, line_frame

CYCLES = 20
START_S = 1.7e9
_STAMPS_S = (0.0, -1.0, math.nan, math.inf, 1e300, 5.0, 1e-3, START_S)
_FD_SIZES = (0, 8, 12, 16, 20, 24, 32, 48, 64)


class _Amplifier:
    """One of the bundled maps with the oracle's own reading of its bytes."""

    def __init__(self, name: str) -> None:
        self.map, self.database = open_channel_map(name)
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
        self._before: list[list[float]] = []
        self._carried: list[list[float]] = []
        self._forget()
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
                raise FalseAnswerError(
                    f"channel {channel} reads {tension_n} N; the frames of its cycle carried "
                    f"{sent[:5]}"
                )
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


def frames_check() -> Check:
    """Examples are sequences of some hundred frames, each into a new reader.

    Frames make samples: `refused` counts those withheld, `taken` those given.
    """
    amplifiers = [_Amplifier("twelve_channel_amplifier"), _Amplifier("cia404_amplifier")]

    def check(draw: Draw) -> Outcome:
        amplifier = draw(st.sampled_from(amplifiers))
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

    return check


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
