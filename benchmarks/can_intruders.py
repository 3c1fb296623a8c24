"""A second sender on the CAN bus: false samples of the reader, and what healthy traffic loses.

    python benchmarks/can_intruders.py [--runs 100] [--write]

Real python-can frames, stamped as on a bus of 1 Mbit/s, go to a new reader in each run: 8 to 29
healthy cycles, five attacked ones and three more. A sample is false if a reading in it is none
that the amplifiers sent in the last one and a half cycles. In every other attacked run CiA 404
nodes send by their own timers, not on SYNC. Healthy runs have 30 cycles each.
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
from cablesense_online.can.assembler import AssembledSample
from cablesense_online.can.bus import CanInterface, FaultLedger
from cablesense_online.can.channel_map import open_channel_map
from cablesense_online.can.emulator import Emulator
from cablesense_online.can.reader import TensionReader

PACKED = "twelve_channel_amplifier"
CIA404 = "cia404_amplifier"
SEED = 404
START_S = 1.7e9
FRAME_S = 1.05e-4
"""A frame of five bytes takes about as long at 1 Mbit/s."""
LATENCY_S = 1e-4
HEALTHY_CYCLES = 30
ATTACKED_CYCLES = 5
CYCLES_AFTER = 3
RISE_N = 0.3
HALF_STEP_N = 0.051
"""Tensions rise in each cycle by more than a converter's step: no reading is like another."""

Frames = list[can.Message]


class Line:
    """Amplifiers, and a reader of their frames and others'."""

    def __init__(self, map_name: str, rng: random.Random, own_timers: bool) -> None:
        self.rng = rng
        self.map, database = open_channel_map(map_name)
        started = self.map.model_copy(update={"nmt_start_nodes": ()})
        self._amplifiers = Emulator(started, database, lambda: can.Bus("none", "virtual"))
        self._amplifiers.close()
        interface = CanInterface("virtual", "intruders")
        self.reader = TensionReader(self.map, database, interface, FaultLedger())
        self._lowest_n = np.array([rng.uniform(20.0, 60.0) for _ in self.map.channels])
        self._timers = [
            (rng.uniform(0.05, 0.95), rng.uniform(-1e-4, 1e-4)) if own_timers else (0.0, 0.0)
            for _ in self.map.channels
        ]
        self.sent: list[tuple[float, Array]] = []
        self.samples: list[AssembledSample] = []

    def cycle(self) -> Frames:
        """The frames of the next cycle, stamped one after another."""
        number = len(self.sent)
        cycle_s = self.map.cycle_time_s
        tensions_n = self._lowest_n + RISE_N * number
        begin_s = START_S + number * cycle_s
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
        """Read frames in the order of their stamps, until the bus falls silent."""
        frames = [frame for cycle in cycles for frame in cycle]
        frames.sort(key=lambda frame: frame.timestamp)
        samples = [self.reader.take(frame, frame.timestamp + LATENCY_S) for frame in frames]
        samples.append(self.reader.lapse())
        self.samples += [sample for sample in samples if sample is not None]

    def false_samples(self) -> int:
        """How many samples hold a reading that the amplifiers did not send a moment before."""
        return sum(not self._genuine(sample) for sample in self.samples)

    def _genuine(self, sample: AssembledSample) -> bool:
        first_s = sample.time_s - 1.5 * self.map.cycle_time_s
        last_s = sample.time_s + sample.skew_s + 1e-6
        sent_n = [tensions_n for at_s, tensions_n in self.sent if first_s <= at_s <= last_s]
        if not sent_n:
            return False
        away_n = np.abs(sample.tensions_n - np.array(sent_n))
        return bool((away_n.min(axis=0) < HALF_STEP_N).all())


def _again(frame: can.Message, later_s: float) -> can.Message:
    return can.Message(
        arbitration_id=frame.arbitration_id,
        is_extended_id=False,
        data=bytes(frame.data),
        timestamp=frame.timestamp + later_s,
    )


def _forged(line: Line, frame: can.Message, later_s: float) -> can.Message:
    """Other readings, by newtons from the packed amplifier, by 0.1 N and more from the others."""
    forged = _again(frame, later_s)
    forged.data[1] ^= line.rng.randrange(1, 8)
    return forged


def spoofed_last_frame(line: Line) -> list[Frames]:
    """The last frame of each cycle is sent before the genuine one."""
    cycles = line.cycles(ATTACKED_CYCLES)
    for frames in cycles:
        last = max(frames, key=lambda one: one.timestamp)
        frames.append(_forged(line, last, -line.rng.uniform(0.05, 0.95) * FRAME_S))
    return cycles


def duplicate_id(line: Line, forged_cycles: int = ATTACKED_CYCLES) -> list[Frames]:
    """A second device sends one id once in each cycle, at any time of it."""
    cycles = line.cycles(ATTACKED_CYCLES)
    index = line.rng.randrange(-3 if line.map.counter else -12, 0)
    later_s = line.rng.random() * line.map.cycle_time_s
    for frames in cycles[:forged_cycles]:
        frames.append(_forged(line, frames[index], later_s + line.rng.uniform(0.0, 2e-5)))
    return cycles


def one_forged_frame(line: Line) -> list[Frames]:
    """One frame alone, of any id and at any time, is forged."""
    return duplicate_id(line, forged_cycles=1)


def forged_cycle(line: Line) -> list[Frames]:
    """Each cycle is sent, with its counter and other readings, before the amplifiers send it."""
    cycles = line.cycles(ATTACKED_CYCLES)
    earlier_s = -line.rng.uniform(0.05, 0.95) * line.map.cycle_time_s
    for frames in cycles:
        early = [_again(frame, earlier_s) for frame in frames if len(frame.data) == 1]
        early += [_forged(line, frame, earlier_s) for frame in frames if len(frame.data) > 1]
        frames += early
    return cycles


def replay(line: Line) -> list[Frames]:
    """Cycles of before are sent again among the present ones."""
    recorded = line.cycles(line.rng.randrange(5, HEALTHY_CYCLES))
    later_s = (len(recorded) + line.rng.random()) * line.map.cycle_time_s
    again = [[_again(frame, later_s) for frame in old] for old in recorded[:ATTACKED_CYCLES]]
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
        ready_s = {frame.arbitration_id: free_s + line.rng.uniform(0.0, 3e-4) for frame in waiting}
        while waiting:
            free_s = max(free_s, min(ready_s[frame.arbitration_id] for frame in waiting))
            ready = [frame for frame in waiting if ready_s[frame.arbitration_id] <= free_s]
            sent = min(ready, key=lambda frame: frame.arbitration_id)
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


def run(map_name: str, scenario: Scenario, number: int) -> Line:
    """One run, from a new reader to silence."""
    rng = random.Random(f"{SEED} {map_name} {scenario.__name__} {number}")
    attacked = scenario in ATTACKS
    line = Line(map_name, rng, own_timers=attacked and map_name == CIA404 and number % 2 == 1)
    before = line.cycles(rng.randrange(8, HEALTHY_CYCLES) if attacked else 0)
    during = scenario(line)
    after = line.cycles(CYCLES_AFTER if attacked else 0)
    line.play([*before, *during, *after])
    return line


def measure(map_name: str, scenario: Scenario, runs: int) -> dict[str, Any]:
    """All runs of one kind."""
    lines = [run(map_name, scenario, number) for number in range(runs)]
    made: dict[str, Any] = {"map": map_name, "traffic": scenario.__name__.replace("_", " ")}
    if scenario in ATTACKS:
        made["attacked cycles"] = ATTACKED_CYCLES * runs
    else:
        made["cycles"] = sum(len(line.sent) for line in lines)
        made["samples lost"] = made["cycles"] - sum(len(line.samples) for line in lines)
    return made | {"false samples": sum(line.false_samples() for line in lines)}


def main() -> int:
    """Measure."""
    parser = harness.parser(__doc__, "results/can_intruders.json")
    parser.add_argument("--runs", type=int, default=100, help="of each kind and amplifier")
    given = parser.parse_args()
    figures = [
        measure(name, scenario, given.runs)
        for name in (PACKED, CIA404)
        for scenario in (*ATTACKS, *HEALTHY)
    ]
    bars = {"no false sample": not any(run_figures["false samples"] for run_figures in figures)}
    result = {"figures": figures, "bars": bars}
    return harness.publish("can_intruders.json", result, given, "python-can")


if __name__ == "__main__":
    sys.exit(main())
