"""A second sender on the CAN bus: false samples of the reader, and what healthy traffic loses.

    python benchmarks/can_intruders.py [--runs 100] [--write]

Real python-can frames go over a virtual bus, stamped as on a bus of 1 Mbit/s. Each attacked run
has a new reader, 8 to 29 healthy cycles, five attacked ones and three more. A sample is false if a
reading in it is none that the amplifiers sent in the last one and a half cycles. In every other
run CiA 404 nodes send by their own timers, not on SYNC. Healthy runs have 30 cycles each.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from typing import Any

import can
import harness
import numpy as np

from cablesense_base import Array
from cablesense_online.can.assembler import Sample
from cablesense_online.can.bus import CanInterface, FaultLedger, start_frames
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import Emulator
from cablesense_online.can.reader import TensionReader

PACKED, CIA404 = "twelve_channel_amplifier", "cia404_amplifier"
SEED = 404
START_S = 1.7e9
FRAME_S = 1.05e-4
"""A frame of five bytes takes about as long at 1 Mbit/s."""
LATENCY_S = 1e-4
HEALTHY_CYCLES, ATTACKED_CYCLES, CYCLES_AFTER = 30, 5, 3
RISE_N, HALF_STEP_N = 0.3, 0.051
"""Tensions rise in each cycle by more than a converter's step: no reading is like another."""

Frames = list[can.Message]


class Line:
    """Amplifiers and a reader, on two ends of a virtual bus that keeps the stamps of frames."""

    def __init__(self, map_name: str, rng: random.Random, own_timers: bool) -> None:
        self.rng = rng
        self.map, database = open_channel_map(map_name)
        self._sending, self._receiving = (
            can.Bus(f"intruders {id(self)}", "virtual", preserve_timestamps=True) for _ in "ab"
        )
        self._amplifiers = Emulator(self.map, database, lambda: self._sending)
        for frame in start_frames(self.map.nmt_start_nodes):
            self._receiving.send(frame)
        self._amplifiers.listen()
        interface = CanInterface("virtual", "intruders")
        self.reader = TensionReader(self.map, database, interface, FaultLedger())
        self._lowest_n = np.array([rng.uniform(20.0, 60.0) for _ in self.map.channels])
        self._timers = [
            (rng.uniform(0.05, 0.95), rng.uniform(-1e-4, 1e-4)) if own_timers else (0.0, 0.0)
            for _ in self.map.channels
        ]
        self.sent: list[tuple[float, Array]] = []
        self.samples: list[Sample] = []

    def cycle(self) -> Frames:
        """The frames of the next cycle, stamped one after another."""
        number, cycle_s = len(self.sent), self.map.cycle_time_s
        tensions_n, begin_s = self._lowest_n + RISE_N * number, START_S + number * cycle_s
        self.sent.append((begin_s, tensions_n))
        frames = self._amplifiers.frames(tensions_n.tolist())
        for place, (frame, (phase, slow)) in enumerate(zip(frames, self._timers, strict=False)):
            frame.timestamp = begin_s + cycle_s * (phase + slow * number)
            frame.timestamp += 0.0 if phase else place * FRAME_S
        return frames

    def cycles(self, count: int) -> list[Frames]:
        """The frames of the next cycles."""
        return [self.cycle() for _ in range(count)]

    def play(self, cycles: list[Frames]) -> None:
        """Send frames in the order of their stamps and read them, until the bus falls silent."""
        frames = [frame for cycle in cycles for frame in cycle]
        for frame in sorted(frames, key=lambda one: one.timestamp):
            self._sending.send(frame)
        given = []
        while (received := self._receiving.recv(0.0)) is not None:
            given.append(self.reader.take(received, received.timestamp + LATENCY_S))
        given.append(self.reader.lapse())
        self.samples += [sample for sample in given if sample is not None]
        self._sending.shutdown()
        self._receiving.shutdown()

    def false_samples(self) -> int:
        """How many samples hold a reading that the amplifiers did not send a moment before."""
        return sum(not self._genuine(sample) for sample in self.samples)

    def _genuine(self, sample: Sample) -> bool:
        first_s = sample.time_s - 1.5 * self.map.cycle_time_s
        last_s = sample.time_s + sample.skew_s + 1e-6
        sent_n = [tensions_n for at_s, tensions_n in self.sent if first_s <= at_s <= last_s]
        if not sent_n:
            return False
        away_n = np.abs(sample.tensions_n - np.array(sent_n))
        return bool((away_n.min(axis=0) < HALF_STEP_N).all())


def _again(frame: can.Message, later_s: float, data: bytes | None = None) -> can.Message:
    return can.Message(
        arbitration_id=frame.arbitration_id,
        is_extended_id=False,
        data=frame.data if data is None else data,
        timestamp=frame.timestamp + later_s,
    )


def _forged(line: Line, frame: can.Message, later_s: float) -> can.Message:
    """Other readings, by newtons from the packed amplifier, by 0.1 N and more from the others."""
    data = bytearray(frame.data)
    data[1] ^= line.rng.randrange(1, 8)
    return _again(frame, later_s, bytes(data))


def spoofed_last_frame(line: Line) -> list[Frames]:
    """The last frame of each cycle is sent before the genuine one."""
    cycles = line.cycles(ATTACKED_CYCLES)
    for frames in cycles:
        last = max(frames, key=lambda one: one.timestamp)
        frames.append(_forged(line, last, -line.rng.uniform(0.05, 0.95) * FRAME_S))
    return cycles


def duplicate_id(line: Line) -> list[Frames]:
    """A second device sends one id once in each cycle, at any time of it."""
    cycles = line.cycles(ATTACKED_CYCLES)
    at = line.rng.randrange(-3 if line.map.counter else -12, 0)
    later_s = line.rng.random() * line.map.cycle_time_s
    for frames in cycles:
        frames.append(_forged(line, frames[at], later_s + line.rng.uniform(0.0, 2e-5)))
    return cycles


def one_forged_frame(line: Line) -> list[Frames]:
    """One frame alone, of any id and at any time, is forged."""
    cycles = line.cycles(ATTACKED_CYCLES)
    at = line.rng.randrange(-3 if line.map.counter else -12, 0)
    later_s = line.rng.random() * line.map.cycle_time_s
    cycles[0].append(_forged(line, cycles[0][at], later_s))
    return cycles


def forged_cycle(line: Line) -> list[Frames]:
    """Each cycle is sent, with its counter and other readings, before the amplifiers send it."""
    cycles = line.cycles(ATTACKED_CYCLES)
    earlier_s = -line.rng.uniform(0.05, 0.95) * line.map.cycle_time_s
    for frames in cycles:
        early = [_again(one, earlier_s) for one in frames if len(one.data) == 1]
        early += [_forged(line, one, earlier_s) for one in frames if len(one.data) > 1]
        frames += early
    return cycles


def replay(line: Line) -> list[Frames]:
    """Cycles of before are sent again among the present ones."""
    recorded = line.cycles(line.rng.randrange(5, HEALTHY_CYCLES))
    later_s = (len(recorded) + line.rng.random()) * line.map.cycle_time_s
    again = [[_again(one, later_s) for one in old] for old in recorded[:ATTACKED_CYCLES]]
    return [*recorded, *line.cycles(ATTACKED_CYCLES), *again]


def steady(line: Line) -> list[Frames]:
    """Nothing but the amplifiers."""
    return line.cycles(HEALTHY_CYCLES)


def jitter(line: Line) -> list[Frames]:
    """Cycles begin up to a fifth of a cycle late, and other traffic delays single frames."""
    cycles = line.cycles(HEALTHY_CYCLES)
    for frames in cycles:
        late_s = line.rng.uniform(0.0, 0.2) * line.map.cycle_time_s
        for frame in frames:
            late_s += line.rng.choice((0.0, 0.0, 0.0, 0.5)) * FRAME_S
            frame.timestamp += late_s
    return cycles


def one_lost_frame(line: Line) -> list[Frames]:
    """One frame in all is lost, the counter's or another."""
    cycles = line.cycles(HEALTHY_CYCLES)
    frames = line.rng.choice(cycles[5:-5])
    del frames[line.rng.randrange(len(frames))]
    return cycles


def another_order(line: Line) -> list[Frames]:
    """Frames are ready up to 0.3 ms late; the bus takes the lowest id of those that wait."""
    cycles = line.cycles(HEALTHY_CYCLES)
    for frames in cycles:
        waiting = frames[1:] if line.map.counter else frames[:]
        free_s = waiting[0].timestamp
        ready_s = {one.arbitration_id: free_s + line.rng.uniform(0.0, 3e-4) for one in waiting}
        while waiting:
            free_s = max(free_s, min(ready_s[one.arbitration_id] for one in waiting))
            ready = [one for one in waiting if ready_s[one.arbitration_id] <= free_s]
            sent = min(ready, key=lambda one: one.arbitration_id)
            sent.timestamp = free_s
            free_s += FRAME_S
            waiting.remove(sent)
    return cycles


Scenario = Callable[[Line], list[Frames]]
ATTACKS: tuple[Scenario, ...] = (
    *(spoofed_last_frame, duplicate_id, one_forged_frame),
    *(forged_cycle, replay),
)
HEALTHY: tuple[Scenario, ...] = (steady, jitter, one_lost_frame, another_order)


def run(map_name: str, scenario: Scenario, number: int, own_timers: bool = False) -> Line:
    """One run, from a new reader to silence."""
    name = scenario.__name__
    line = Line(map_name, random.Random(f"{SEED} {map_name} {name} {number}"), own_timers)
    attacked = scenario not in HEALTHY
    before = line.cycles(line.rng.randrange(8, HEALTHY_CYCLES) if attacked else 0)
    during = scenario(line)
    after = line.cycles(CYCLES_AFTER if scenario in ATTACKS else 0)
    line.play([*before, *during, *after])
    return line


def measure(map_name: str, scenario: Scenario, runs: int, timers: str) -> dict[str, Any]:
    """All runs of one kind; `timers` is `SYNC`, `own` or `both` in turn."""
    own = {"SYNC": (False,), "own": (True,), "both": (False, True)}[timers]
    lines = [run(map_name, scenario, n, own[n % len(own)]) for n in range(runs)]
    made: dict[str, Any] = {"map": map_name, "traffic": scenario.__name__.replace("_", " ")}
    if scenario in HEALTHY:
        cycles = sum(len(line.sent) for line in lines)
        lost = cycles - sum(len(line.samples) for line in lines)
        made |= {"timers": timers, "cycles": cycles, "samples lost": lost}
    else:
        made["attacked cycles"] = ATTACKED_CYCLES * runs
    return made | {"false samples": sum(line.false_samples() for line in lines)}


def main() -> int:
    """Measure."""
    parser = harness.parser(__doc__, "results/can_intruders.json")
    parser.add_argument("--runs", type=int, default=100, help="of each kind and amplifier")
    given = parser.parse_args()
    kinds = [(PACKED, one, "SYNC") for one in (*ATTACKS, *HEALTHY)]
    kinds += [(CIA404, one, "both") for one in ATTACKS]
    kinds += [(CIA404, one, "SYNC") for one in HEALTHY] + [(CIA404, steady, "own")]
    figures = [measure(name, one, given.runs, timers) for name, one, timers in kinds]
    harness.publish("can_intruders.json", {"figures": figures}, given, "python-can")
    return int(any(one["false samples"] for one in figures))


if __name__ == "__main__":
    sys.exit(main())
