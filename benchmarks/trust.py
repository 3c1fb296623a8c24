"""Contacts through the estimation, healthy and faulty: which are stated, and which are wrong.

    python benchmarks/trust.py [--samples 2500] [--faulty 1250] [--healthy 0] [--write]
    python benchmarks/trust.py --points --samples 0 --faulty 8000 --healthy 500000 [--write]

Random poses within 10 degrees and straight ones; one contact anywhere on the arm or two, of 2 N
to what the arm bears, with an axial part of up to 0.3 of the normal force; serialized messages
with the sensors' noise and step, 100 a second. A contact is judged after 12 samples. It is wrong
if the normal force is off by more than 5 N and by more than a fifth of the true one, or if a
segment is; next to a joint the neighbour's end is the same place. On segment 1 the moment is
judged, over the length of the segment. With `--faulty`, one channel is scaled, shifted or zero,
or two are, or are exchanged; a quarter of those arms is untouched. Two channels are of one
segment's cables in half of the cases. With `--healthy`, the states of samples under one contact
each, of up to the model's range, are counted.

With `--points`, the models of contacts at the points of the arm file are judged, by single normal
forces of up to their range at these points. The first sample of a contact is judged, and every
error above 5 N counts.
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
FAULTS_AT_POINTS = {
    1: (*FAULTS[1], "scaled by 2", "20 N less", "100 N more", "stuck at the tare", "broken cable"),
    2: ("exchanged",),
}
SIGNS: dict[str, Any] = {"more": 1.0, "less": -1.0, "apart": np.array([1.0, -1.0])}
LOOSE_N = -1e5
"""Pretension of a broken cable: it would have to stretch by centimetres to be taut."""
HEADINGS = ("healthy", "one faulty channel", "two faulty channels")


class Push(NamedTuple):
    """A contact: segment from 1 on, place on it, force (3,) along its axes at the command."""

    segment: int
    place_m: float
    force_n: Array

    @property
    def normal_n(self) -> float:
        """Size of the force across the segment."""
        return float(np.hypot(*self.force_n[1:]))


class TestedArm(EstimatedArm):
    """An arm at rest at a command, tared; with `points` it is touched at those of its file."""

    def __init__(
        self, name: str, command_rad: Array, rng: np.random.Generator, *, points: bool
    ) -> None:
        super().__init__(name, rng, name if points else "")
        self.points, self.command_rad = points, command_rad
        place_m = self.mechanism.contact_m
        self.reach_m = np.column_stack([place_m] * 2) if points else touched_at(self.arm)[0]
        self.command(command_rad)
        self._now_s = 0.0
        self.unloaded_n = self.tensions_n([])
        while self.estimation.tares.present is None:
            self.next(self.read(self.unloaded_n))

    def next(self, reading_n: Array) -> Answer:
        """The answer to the next readings."""
        self._now_s += PERIOD_S
        return self.sample(reading_n, self._now_s)

    def tensions_n(self, pushes: Sequence[Push], broken: Sequence[int] = ()) -> Array:
        """(M,) under pushes; raises EquilibriumError where the arm does not bear them."""
        at_m, forces = self.mechanism.contact_m.copy(), np.zeros((self.arm.segment_count, 3))
        axes = kinematics.segment_rotations(self.mechanism, self.command_rad)
        for push in pushes:
            at_m[push.segment - 1] = push.place_m
            forces[push.segment - 1] = axes[push.segment - 1] @ push.force_n
        pretension_n = self.mechanism.pretension_n.copy()
        pretension_n[list(broken)] = LOOSE_N
        touched = replace(self.mechanism, contact_m=at_m, pretension_n=pretension_n)
        return solve_equilibrium(touched, self.command_rad, forces).tensions_n

    def drawn(self, largest_n: float) -> list[Push]:
        """One contact, or two in a quarter of the cases; at points always one."""
        rng, axial = self.rng, 0.0 if self.points else 0.3
        count = 2 if not self.points and rng.random() < 0.25 else 1
        pushes = []
        for n in sorted(rng.permutation(self.arm.segment_count)[:count]):
            size_n, angle = rng.uniform(2.0, largest_n / count), rng.uniform(0.0, 2.0 * np.pi)
            force_n = size_n * np.array([rng.uniform(-axial, axial), np.sin(angle), np.cos(angle)])
            pushes.append(Push(int(n) + 1, rng.uniform(*self.reach_m[n]), force_n))
        return pushes

    def cables(self, count: int) -> list[int]:
        """Some cables, of one segment in half of the cases."""
        ends_on = self.mechanism.cable_segment
        among = np.arange(len(ends_on))
        if self.rng.random() < 0.5:
            among = np.flatnonzero(ends_on == self.rng.choice(ends_on))
        chosen: list[int] = self.rng.choice(among, count, replace=False).tolist()
        return chosen

    def faulty(self, reading_n: Array, fault: str, cables: Sequence[int]) -> Array:
        """Readings (M,) with a fault on the channels of some cables."""
        of = list(cables)
        size, _, sign = fault.partition(" N ")
        if fault.startswith("scaled"):
            reading_n[of] *= float(fault.rpartition(" ")[2])
        elif sign:
            reading_n[of] += float(size) * SIGNS[sign]
        elif fault == "zero":
            reading_n[of] = 0.0
        elif fault == "exchanged":
            reading_n[of] = reading_n[of[::-1]]
        elif fault == "stuck at the tare":
            reading_n[of] = self.unloaded_n[of]
        return np.maximum(reading_n, 0.0)

    def answer(
        self, tensions_n: Array, fault: str, cables: Sequence[int]
    ) -> tuple[Answer, Sequence[Contact]]:
        """The judged answer, and the contacts that would be stated if readings were not checked.

        The arm is free again afterwards.
        """
        for _ in range(1 if self.points else JUDGED_AFTER):
            reading_n = self.faulty(self.read(tensions_n), fault, cables)
            answer = self.next(reading_n)
        found = self.estimation.model.find(reading_n, 0, self.settings.contact_threshold)
        self.release()
        return answer, found.contacts if found else ()

    def release(self) -> None:
        """The arm is untouched for long enough to be judged afresh."""
        for _ in range(RELEASED):
            self.next(self.read(self.unloaded_n))

    def wrong_n(self, pushes: Sequence[Push], contacts: Sequence[Contact]) -> float:
        """The largest error of a normal force, N; a share of the force does not count."""
        length_m, share = self.mechanism.segment_length_m, 0.0 if self.points else WRONG_SHARE
        worst = 0.0
        left = {contact.segment: contact for contact in contacts}
        for push in pushes:
            segment, place_m = push.segment, push.place_m
            if segment not in left:  # the end of one segment and the beginning of the next
                at_end = length_m[segment - 1] - place_m < 0.02
                segment = segment + 1 if at_end and segment + 1 in left else segment - 1
                near = at_end or place_m < 0.035
                if not near or segment not in left:
                    worst = max(worst, push.normal_n)
                    continue
            contact = left.pop(segment)
            if contact.magnitude_n:
                off = contact.magnitude_n * np.array(contact.direction) - push.force_n[1:]
            else:
                moment = (contact.moment_n_m or 0.0) * np.array(contact.direction)
                off = (moment - place_m * push.force_n[1:]) / length_m[segment - 1]
            off_n = float(np.hypot(*off))
            if off_n > share * push.normal_n:
                worst = max(worst, off_n)
        for segment, contact in left.items():
            moment_n_m = contact.moment_n_m or 0.0
            worst = max(worst, contact.magnitude_n or moment_n_m / length_m[segment - 1])
        return float(worst)


def trial(
    name: str, given: argparse.Namespace, seed: int, channels: int, largest_n: float
) -> dict[str, Any]:
    """Counts of the states and of wrong contacts, of one arm with some faulty channels."""
    rng = np.random.default_rng([given.seed, seed, channels])
    faults = FAULTS_AT_POINTS if given.points else FAULTS
    states: Counter[str] = Counter()
    unchecked = unconfirmed = 0
    wrong: list[dict[str, Any]] = []
    count = given.faulty if channels else given.samples
    title = f"{name}, {HEADINGS[channels]}"
    for number in track(range(count // CONTACTS_AT_A_POSE), title):
        bend = 0.0 if number % 4 == 0 else BEND_RAD
        arm = TestedArm(name, rng.uniform(-bend, bend, 8), rng, points=given.points)
        for _ in range(CONTACTS_AT_A_POSE):
            untouched = channels and rng.random() < UNTOUCHED
            pushes = [] if untouched else arm.drawn(largest_n)
            fault = str(rng.choice(faults[channels])) if channels else ""
            cables = arm.cables(channels) if channels else []
            try:
                tensions_n = arm.tensions_n(pushes, cables if fault == "broken cable" else ())
            except EquilibriumError:
                continue
            answer, contacts = arm.answer(tensions_n, fault, cables)
            of = f"segment {pushes[0].segment}" if pushes else "untouched"
            of = "two contacts" if len(pushes) > 1 else of
            states[f"{of}: {answer.force.value}"] += 1
            unchecked += arm.wrong_n(pushes, contacts) > WRONG_N
            off_n = arm.wrong_n(pushes, answer.contacts)
            unconfirmed += off_n > WRONG_N and answer.force is ForceState.UNCONFIRMED
            if answer.force.known and off_n > WRONG_N:
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
    return {
        "states": dict(sorted(states.items())),
        "contacts": states.total(),
        "wrong_without_the_check": unchecked,
        "wrong_and_unconfirmed": unconfirmed,
        "wrong_and_vouched": len(wrong),
        "wrong": wrong[:20],
    }


def healthy_samples(name: str, given: argparse.Namespace, largest_n: float) -> dict[str, Any]:
    """States of samples of a healthy arm under one normal contact each, and of how many contacts.

    Those that are implausible get no force.
    """
    rng = np.random.default_rng(given.seed)
    states: Counter[str] = Counter()
    withheld = []  # of each contact
    for _ in track(range(given.healthy // (CONTACTS_AT_A_POSE * READINGS)), f"{name}, limit"):
        arm = TestedArm(name, rng.uniform(-BEND_RAD, BEND_RAD, 8), rng, points=given.points)
        for _ in range(CONTACTS_AT_A_POSE):
            n, angle = int(rng.integers(arm.arm.segment_count)), rng.uniform(0.0, 2.0 * np.pi)
            force_n = rng.uniform(0.0, largest_n) * np.array([0.0, np.sin(angle), np.cos(angle)])
            try:
                tensions_n = arm.tensions_n([Push(n + 1, rng.uniform(*arm.reach_m[n]), force_n)])
            except EquilibriumError:
                continue
            found = [arm.next(arm.read(tensions_n)).force for _ in range(READINGS)]
            states.update(f"segment {n + 1}: {force.value}" for force in found)
            withheld.append(found.count(ForceState.IMPLAUSIBLE))
            arm.release()
    return {
        "states": dict(sorted(states.items())),
        "samples": states.total(),
        "withheld": sum(withheld),
        "contacts": len(withheld),
        "contacts_with_withheld": sum(count > 0 for count in withheld),
    }


def main() -> None:
    """Tries healthy arms and faulty ones, prints, and keeps the figures with `--write`."""
    options = harness.parser(__doc__, "trust.json, or plausibility.json of --points")
    options.add_argument("--samples", type=int, default=2500, help="contacts of each healthy arm")
    options.add_argument(
        "--faulty", type=int, default=1250, help="of each arm with one faulty channel or two"
    )
    options.add_argument("--healthy", type=int, default=0, help="samples for the limit, by arm")
    options.add_argument("--points", action="store_true", help="models of contacts at points")
    options.add_argument("--seed", type=int, default=7101, help="of poses, contacts and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    for seed, (name, borne_n) in enumerate(ARMS.items()):
        model = load_model(name, name if given.points else "").estimator.metadata
        largest_n = model.force_range_n if given.points else borne_n
        counts = (given.samples, given.faulty, given.faulty)
        result[name] = {
            HEADINGS[channels]: trial(name, given, seed, channels, largest_n)
            for channels, count in enumerate(counts)
            if count
        }
        if given.healthy:
            result[name]["limit of the misfit"] = healthy_samples(name, given, model.force_range_n)
    written = "plausibility.json" if given.points else "trust.json"
    harness.publish(written, result, given, "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
