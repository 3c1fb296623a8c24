"""Contacts through the estimation, healthy and faulty: which are stated, and which are wrong.

    python benchmarks/trust.py [--samples 2500] [--faulty 1250] [--healthy 0] [--write]

Random poses within 10 degrees and straight ones; one contact anywhere on the arm or two, of 2 N
to what the arm bears, with an axial part of up to 0.3 of the normal force; serialized messages
with the sensors' noise and step, 100 a second. A contact is judged after 12 samples. It is wrong
if the normal force is off by more than 5 N and by more than a fifth of the true one, or if a
segment is; next to a joint the neighbour's end is the same place. On segment 1 the moment is
judged, over the length of the segment. With `--faulty`, one channel is scaled, shifted or zero,
or two are, or are exchanged; a quarter of those arms is untouched. Two channels are of one
segment's cables in half of the cases. With `--healthy`, samples under one contact each, of up to
the model's range, are counted that get no force.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import harness
import numpy as np
from estimated_arm import EstimatedArm
from rich.progress import track

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, ForceState
from cablesense_online.answer import Answer
from cablesense_online.models import load_model
from cablesense_sim import kinematics
from cablesense_sim.contact_location import touched_at
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium

ARMS = {"cdsm": 150.0, "cdsm_lab": 45.0}
"""The strongest push, N, that an arm bears in nearly every pose within 10 degrees."""
WRONG_N, WRONG_SHARE = 5.0, 0.2
PERIOD_S, JUDGED_AFTER, RELEASED = 0.01, 12, 25
CONTACTS_AT_A_POSE, READINGS = 20, 50
BEND_RAD = float(np.deg2rad(10.0))
UNTOUCHED = 0.25
FAULTS = {
    1: ("scaled by 0.5", "scaled by 0.9", "scaled by 1.1", "5 N more", "20 N more", "zero"),
    2: ("scaled by 0.9", "scaled by 1.1", "10 N more", "20 N more", "10 N apart", "20 N apart",
        "exchanged"),
}  # fmt: skip
"""By the number of faulty channels; apart is more on one and less on the other."""
HEADINGS = ("healthy", "one faulty channel", "two faulty channels")


class Push(NamedTuple):
    """A contact: segment from 1 on, place on it, force (3,) along its axes at the command."""

    segment: int
    place_m: float
    force_n: Array


class TestedArm(EstimatedArm):
    """An arm at rest at a command, tared."""

    def __init__(self, name: str, command_rad: Array, rng: np.random.Generator) -> None:
        super().__init__(name, rng)
        self.command_rad = command_rad
        self.command(command_rad)
        self._now_s = 0.0
        self.unloaded_n = self.tensions_n([])
        while self.estimation.tares.present is None:
            self.next(self.read(self.unloaded_n))

    def next(self, reading_n: Array) -> Answer:
        """The answer to the next readings."""
        self._now_s += PERIOD_S
        return self.sample(reading_n, self._now_s)

    def tensions_n(self, pushes: Sequence[Push]) -> Array:
        """(M,) under pushes; raises EquilibriumError where the arm does not bear them."""
        at_m, forces = self.mechanism.contact_m.copy(), np.zeros((self.arm.segment_count, 3))
        axes = kinematics.segment_rotations(self.mechanism, self.command_rad)
        for push in pushes:
            at_m[push.segment - 1] = push.place_m
            forces[push.segment - 1] = axes[push.segment - 1] @ push.force_n
        touched = replace(self.mechanism, contact_m=at_m)
        return solve_equilibrium(touched, self.command_rad, forces).tensions_n

    def drawn(self, largest_n: float) -> list[Push]:
        """One contact, or two in a quarter of the cases."""
        rng = self.rng
        count = 2 if rng.random() < 0.25 else 1
        reach, _ = touched_at(self.arm)
        pushes = []
        for n in sorted(rng.permutation(self.arm.segment_count)[:count]):
            size_n, angle = rng.uniform(2.0, largest_n / count), rng.uniform(0.0, 2.0 * np.pi)
            force_n = size_n * np.array([rng.uniform(-0.3, 0.3), np.sin(angle), np.cos(angle)])
            pushes.append(Push(int(n) + 1, rng.uniform(*reach[n]), force_n))
        return pushes

    def cables(self, count: int) -> list[int]:
        """Some cables, of one segment in half of the cases."""
        ends_on = self.mechanism.cable_segment
        among = np.arange(len(ends_on))
        if self.rng.random() < 0.5:
            among = np.flatnonzero(ends_on == self.rng.choice(ends_on))
        chosen: list[int] = self.rng.choice(among, count, replace=False).tolist()
        return chosen

    def answer(self, tensions_n: Array, fault: str = "", cables: Sequence[int] = ()) -> Answer:
        """The answer after `JUDGED_AFTER` samples; the arm is free again afterwards."""
        found = Answer()
        for _ in range(JUDGED_AFTER):
            found = self.next(faulty(self.read(tensions_n), fault, cables))
        self.release()
        return found

    def release(self) -> None:
        """The arm is untouched for long enough to be judged afresh."""
        for _ in range(RELEASED):
            self.next(self.read(self.unloaded_n))


def faulty(reading_n: Array, fault: str, cables: Sequence[int]) -> Array:
    """Readings (M,) with a fault of `FAULTS` on some cables."""
    size, _, kind = fault.partition(" N ")
    of = list(cables)
    if fault.startswith("scaled"):
        reading_n[of] *= float(fault.rpartition(" ")[2])
    elif fault == "zero":
        reading_n[of] = 0.0
    elif fault == "exchanged":
        reading_n[of] = reading_n[of[::-1]]
    elif fault:
        reading_n[of] += float(size)
        if kind == "apart":
            reading_n[of[1]] -= 2.0 * float(size)
    return np.maximum(reading_n, 0.0)


def wrong_n(pushes: Sequence[Push], contacts: Sequence[Contact], length_m: Array) -> float:
    """The largest error of a normal force, N; errors of up to a fifth of a force count as 0."""
    worst = 0.0
    left = {contact.segment: contact for contact in contacts}
    for push in pushes:
        segment, place_m = push.segment, push.place_m
        if segment not in left:  # the end of one segment and the beginning of the next
            at_end = length_m[segment - 1] - place_m < 0.02
            segment = segment + 1 if at_end and segment + 1 in left else segment - 1
            near = at_end or place_m < 0.035
            if not near or segment not in left:
                worst = max(worst, float(np.hypot(*push.force_n[1:])))
                continue
        contact = left.pop(segment)
        size_n = float(np.hypot(*push.force_n[1:]))
        if contact.magnitude_n:
            off = contact.magnitude_n * np.array(contact.direction) - push.force_n[1:]
        else:
            moment = (contact.moment_n_m or 0.0) * np.array(contact.direction)
            off = (moment - place_m * push.force_n[1:]) / length_m[segment - 1]
        off_n = float(np.hypot(*off))
        if off_n > WRONG_SHARE * size_n:
            worst = max(worst, off_n)
    for segment, contact in left.items():
        moment_n_m = contact.moment_n_m or 0.0
        worst = max(worst, contact.magnitude_n or moment_n_m / length_m[segment - 1])
    return worst


def trial(name: str, given: argparse.Namespace, seed: int, channels: int) -> dict[str, Any]:
    """Counts of the states and of wrong contacts, of one arm with some faulty channels."""
    rng = np.random.default_rng([given.seed, seed, channels])
    states: Counter[str] = Counter()
    wrong: list[dict[str, Any]] = []
    count, judged = given.faulty if channels else given.samples, 0
    title = f"{name}, {HEADINGS[channels]}"
    for number in track(range(count // CONTACTS_AT_A_POSE), title):
        bend = 0.0 if number % 4 == 0 else BEND_RAD
        command = rng.uniform(-bend, bend, 8)
        arm = TestedArm(name, command, rng)
        for _ in range(CONTACTS_AT_A_POSE):
            untouched = channels and rng.random() < UNTOUCHED
            pushes = [] if untouched else arm.drawn(ARMS[name])
            try:
                tensions_n = arm.tensions_n(pushes)
            except EquilibriumError:
                continue
            fault = str(rng.choice(FAULTS[channels])) if channels else ""
            cables = arm.cables(channels) if channels else []
            answer = arm.answer(tensions_n, fault, cables)
            judged += 1
            of = f"segment {pushes[0].segment}" if pushes else "untouched"
            of = "two contacts" if len(pushes) > 1 else of
            states[f"{of}: {answer.force.value}"] += 1
            off_n = wrong_n(pushes, answer.contacts, arm.mechanism.segment_length_m)
            vouched = answer.force in (ForceState.CONTACT, ForceState.MOMENT, ForceState.FREE)
            if vouched and off_n > WRONG_N:
                wrong.append(
                    {
                        "pushes": [(p.segment, round(p.place_m, 4), p.force_n.round(2).tolist())
                                   for p in pushes],
                        "fault": fault and f"{fault}, cables {[n + 1 for n in cables]}",
                        "contacts": [(c.segment, round(c.contact_m, 4), round(c.magnitude_n, 2))
                                     for c in answer.contacts],
                        "off_n": round(off_n, 2),
                        "straight": not bend,
                    }
                )  # fmt: skip
    return {"contacts": judged, "states": dict(sorted(states.items())),
            "wrong_and_vouched": len(wrong), "wrong": wrong[:20]}  # fmt: skip


def withheld(name: str, samples: int, seed: int) -> dict[str, int]:
    """How many samples of a healthy arm under one contact get no force, and of how many contacts.

    Contacts are normal to the segment, of up to the model's range.
    """
    rng, loaded = np.random.default_rng(seed), load_model(name, "")
    largest_n = loaded.estimator.metadata.force_range_n
    beyond = []
    for _ in track(range(samples // (CONTACTS_AT_A_POSE * READINGS)), f"{name}, limit"):
        arm = TestedArm(name, rng.uniform(-BEND_RAD, BEND_RAD, 8), rng)
        reach, _ = touched_at(arm.arm)
        for _ in range(CONTACTS_AT_A_POSE):
            n, angle = int(rng.integers(arm.arm.segment_count)), rng.uniform(0.0, 2.0 * np.pi)
            force_n = rng.uniform(0.0, largest_n) * np.array([0.0, np.sin(angle), np.cos(angle)])
            try:
                tensions_n = arm.tensions_n([Push(n + 1, rng.uniform(*reach[n]), force_n)])
            except EquilibriumError:
                continue
            answers = [arm.next(arm.read(tensions_n)) for _ in range(READINGS)]
            beyond.append(sum(answer.force is ForceState.IMPLAUSIBLE for answer in answers))
            arm.release()
    counts = {"samples": READINGS * len(beyond), "withheld": sum(beyond), "contacts": len(beyond)}
    return counts | {"contacts_with_withheld": sum(count > 0 for count in beyond)}


def main() -> None:
    """Tries healthy arms and faulty ones, prints, and keeps the figures with `--write`."""
    options = harness.parser(__doc__, "trust.json")
    options.add_argument("--samples", type=int, default=2500, help="contacts of each healthy arm")
    options.add_argument(
        "--faulty", type=int, default=1250, help="of each arm with one faulty channel or two"
    )
    options.add_argument("--healthy", type=int, default=0, help="samples for the limit, by arm")
    options.add_argument("--seed", type=int, default=7101, help="of poses, contacts and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    for seed, name in enumerate(ARMS):
        result[name] = {
            HEADINGS[channels]: trial(name, given, seed, channels)
            for channels in range(3 if given.faulty else 1)
        }
        if given.healthy:
            result[name]["limit of the misfit"] = withheld(name, given.healthy, given.seed)
    harness.publish("trust.json", result, given, "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
