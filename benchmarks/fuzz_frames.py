"""Sequences of mutated CAN frames into the driver's reading path, with an independent oracle.

The oracle reads values off the frames' bytes by `struct`, as the amplifiers' manuals define them,
and also by cantools. A sample is right if each of its tensions was carried, in the range, by
a well-formed frame of that channel in its cycle or the next, in which a reader gives it.
Bytes that spell another plausible value cannot be recognised as wrong.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import can
from fuzz_mutation import FalseAnswerError, ItemOutcome, Run, item_random, mutated_bytes

from cablesense_online.can.assembler import Sample
from cablesense_online.can.bus import CanInterface, FaultLedger
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.reader import SCATTER_OF_READING_S, TensionReader
from cablesense_online.can.slcan import frame_line, line_frame

CYCLES = 60
START_S = 1.7e9
_STAMPS = (0.0, -1.0, math.nan, math.inf, 1e300, 5.0, 1e-3)
_FD_SIZES = (0, 8, 12, 16, 20, 24, 32, 48, 64)


class _Amplifier:
    """One of the bundled maps with the oracle's own reading of its bytes."""

    def __init__(self, name: str) -> None:
        self.map, self.database = open_channel_map(name)
        self.packed = self.map.counter is not None
        self.ids = {m.frame_id: m for m in self.database.messages}

    def cycle(self, rng: random.Random, number: int, start_s: float) -> list[can.Message]:
        """Frames of a cycle of the real amplifier with random tensions."""
        if self.packed:
            contents = [(0x120, bytes([number % 256]))]
            for id_ in range(0x121, 0x124):
                raws = [rng.randint(-400, 30_000) for _ in range(4)]
                contents.append((id_, struct.pack("<4h", *raws)))
        else:
            raws = [rng.randint(-40_000, 4_900_000) for _ in range(12)]
            contents = [(0x181 + k, struct.pack("<iB", raw, 0)) for k, raw in enumerate(raws)]
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
        low, high = self.map.range_n
        found: Sequence[tuple[int, float]] = ()
        if self.packed and 0x121 <= frame.arbitration_id <= 0x123 and len(frame.data) == 8:
            first = 4 * (frame.arbitration_id - 0x121)
            raws = struct.unpack("<4h", frame.data)
            found = [(first + k, 0.1 * raw) for k, raw in enumerate(raws)]
        elif not self.packed and 0x181 <= frame.arbitration_id <= 0x18C and len(frame.data) == 5:
            raw, status = struct.unpack("<iB", frame.data)
            if not status & 0x07:
                found = [(frame.arbitration_id - 0x181, 1e-3 * raw)]
        for channel, tension_n in found:
            if low < tension_n < high:
                cable = self.map.channels[self.map.cable_names[channel]]
                message, data = self.ids[frame.arbitration_id], bytes(frame.data)
                decoded: Any = message.decode(data, decode_choices=False)
                value = float(decoded[cable.signal])
                if not math.isclose(cable.tension_n(value), tension_n, rel_tol=1e-9, abs_tol=1e-9):
                    raise FalseAnswerError(f"cantools reads {value} where {tension_n} N are sent")
                yield channel, tension_n


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


def make_frames(seed: int) -> Run:
    """Items are sequences of some hundred frames, each into a new reader.

    Frames make samples: `refused` counts those withheld, `taken` those given.
    """
    amplifiers = [_Amplifier("twelve_channel_amplifier"), _Amplifier("cia404_amplifier")]

    def run(item: int) -> ItemOutcome:
        rng = item_random("frames", seed, item)
        amplifier = amplifiers[item % 2]
        interface = rng.choice(("virtual", "slcan"))
        reader = TensionReader(
            amplifier.map, amplifier.database, CanInterface(interface, "fuzz"), FaultLedger()
        )
        skew_s = SCATTER_OF_READING_S if interface == "slcan" else 0.0
        witness = _Witness(amplifier, max(amplifier.map.skew_limit_s, skew_s))
        sent = taken = 0
        arrival_s = START_S
        for frame, gap_s in _SEQUENCES[rng.randrange(len(_SEQUENCES))](rng, amplifier):
            arrival_s += gap_s
            sent += 1
            witness.take(frame)
            sample = reader.take(frame, arrival_s)
            if sample is not None:
                witness.judge(sample, arrival_s)
                taken += 1
            if rng.random() < 0.0005:
                reader.reopened()
        return ItemOutcome(inputs=sent, taken=taken, refused=reader.withheld)

    return run


Timed = tuple[can.Message, float]


def _stream(rng: random.Random, amplifier: _Amplifier) -> list[can.Message]:
    period_s = amplifier.map.cycle_time_s
    cycles = (amplifier.cycle(rng, n, START_S + n * period_s) for n in range(CYCLES))
    return [frame for cycle in cycles for frame in cycle]


def _timed(
    rng: random.Random, frames: Sequence[can.Message], amplifier: _Amplifier
) -> Iterator[Timed]:
    """As they would arrive, a tenth of a millisecond after their stamps; some with odd gaps."""
    gap_s = amplifier.map.cycle_time_s / (4 if amplifier.packed else 12)
    odd = rng.choice((0.0, 0.0, 0.3))
    for frame in frames:
        yield frame, rng.choice((1e-6, 0.01)) if rng.random() < odd else gap_s


def _reordered(rng: random.Random, amplifier: _Amplifier) -> Iterator[Timed]:
    """Dropped, repeated, exchanged, moved far, and old ones again."""
    frames = _stream(rng, amplifier)
    for _ in range(rng.randint(1, 40)):
        at = rng.randrange(len(frames))
        match rng.randrange(4):
            case 0:
                del frames[at : at + rng.choice((1, 1, 2, 7))]
            case 1:
                frames.insert(at, frames[at])
            case 2:
                frames.insert(rng.randrange(len(frames)), frames[at])
            case _:
                block = frames[at : at + rng.choice((2, 2, 4, 12))]
                frames[at : at + len(block)] = rng.sample(block, len(block))
        if len(frames) < 20:
            break
    return _timed(rng, frames, amplifier)


def _changed(rng: random.Random, amplifier: _Amplifier) -> Iterator[Timed]:
    """Bits, lengths, ids and kinds of frames turned."""
    share = rng.choice((0.01, 0.1, 0.5, 1.0))
    frames = (
        _changed_frame(rng, frame) if rng.random() < share else frame
        for frame in _stream(rng, amplifier)
    )
    return _timed(rng, list(frames), amplifier)


def _changed_frame(rng: random.Random, frame: can.Message) -> can.Message:
    data, number = bytes(frame.data), frame.arbitration_id
    changed: dict[str, Any] = {"is_extended_id": False, "timestamp": frame.timestamp}
    match rng.randrange(8):
        case 0 | 1:
            data = mutated_bytes(rng, data)[: rng.choice((8, 8, 64))]
        case 2:
            data = data[: rng.randrange(len(data))]
        case 3:
            data = rng.randbytes(rng.choice((0, 1, 2, 5, 5, 8, 8, 8)))
        case 4:
            number = rng.choice((number ^ (1 << rng.randrange(11)), rng.randrange(2**11)))
        case 5:
            changed["is_extended_id"] = True
            number = rng.choice((number, rng.randrange(2**29)))
        case 6:
            changed[rng.choice(("is_remote_frame", "is_error_frame", "is_fd"))] = True
        case _:
            stamps_s = (*_STAMPS, frame.timestamp + rng.uniform(-0.01, 0.01))
            changed["timestamp"] = rng.choice(stamps_s)
    if len(data) > 8 or "is_fd" in changed:
        changed["is_fd"] = True
        data = data.ljust(next(size for size in _FD_SIZES if size >= len(data)), b"\x00")
    if "is_remote_frame" in changed:
        data = b""
    return can.Message(arbitration_id=number, data=data, **changed)


def _lines(rng: random.Random, amplifier: _Amplifier) -> Iterator[Timed]:
    """Through the lines of a serial adapter, which lose and change characters."""
    for frame in _stream(rng, amplifier):
        line = frame_line(frame) or b""
        if rng.random() < 0.2:
            line = mutated_bytes(rng, line, most=2)
        try:
            received = line_frame(line)
        except ValueError:
            continue
        again = frame_line(received) or b""
        if not line.upper().startswith(again.upper()):
            raise FalseAnswerError(f"the line {line!r} was read as {again!r}")
        yield received, 2.5e-4


_SEQUENCES = (_reordered, _reordered, _changed, _changed, _changed, _lines)
