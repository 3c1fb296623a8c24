"""Contacts through the estimation, healthy and faulty: which are stated, and which are wrong.

    python benchmarks/trust.py [--samples 2500] [--faulty 1250] [--healthy 0] [--built] [--write]

Arms are tared straight, then touched in random poses within 10 degrees, a quarter of them in the
straight one; one contact anywhere on the arm or two, of 2 N to what the arm bears, with an axial
part of up to 0.3 of the normal force; serialized messages with the sensors' noise and step, 100 a
second. A contact is judged after 20 samples. It is wrong if the normal force is off by more than 5
N and by more than a fifth of the true one, or if a segment is; next to a joint the neighbour's end
is the same place. Where the moment alone is stated it is judged, over the length of the segment.
With `--faulty`, one channel is scaled, shifted, stuck or zero, or a cable is broken, or two
channels are scaled, shifted or exchanged; a quarter of those arms is untouched. Two channels are
of one segment's cables in half of the cases. With `--healthy`, the states of samples under one
contact each, of up to the model's range, are counted.

Arms equal their files; with `--built`, each has errors of its own, of an independent plant
(`cablesense_plants.arm.built`), which no file states.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple, Protocol

import harness
import numpy as np
from estimated_arm import EstimatedArm
from rich.progress import track

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, ForceState
from cablesense_online.answer import Answer
from cablesense_online.models import load_model
from cablesense_plants.arm.body import Nominal, read_nominal
from cablesense_plants.arm.built import BuiltArm, Push, Workmanship
from cablesense_plants.cases import PlantError
from cablesense_sim import kinematics
from cablesense_sim.arm import find_arm
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.touch import touched_places

ARMS = {"cdsm": 150.0, "cdsm_lab": 45.0}
"""The strongest push, N, that an arm bears in nearly every pose within 10 degrees."""
WRONG_N = 5.0
WRONG_SHARE = 0.2
SAME_PLACE_M = 0.02
PERIOD_S = 0.01
JUDGED_AFTER = 20
RELEASED = 25
MOST_SAMPLES = 1000
"""An arm that is not tared, or does not rest, after so many samples is given up."""
CONTACTS_AT_A_POSE = 20
READINGS = 50
BEND_RAD = float(np.deg2rad(10.0))
AXIAL_SHARE = 0.3
UNTOUCHED = 0.25
BROKEN = "broken cable"
STUCK = "stuck at the tare"
EXCHANGED = "exchanged"
FAULTS = {
    1: (
        "scaled by 0.5",
        "scaled by 0.9",
        "scaled by 1.1",
        "scaled by 2",
        "5 N more",
        "20 N more",
        "20 N less",
        "100 N more",
        "zero",
        STUCK,
        BROKEN,
    ),
    2: (
        "scaled by 0.9",
        "scaled by 1.1",
        "10 N more",
        "20 N more",
        "10 N apart",
        "20 N apart",
        EXCHANGED,
    ),
}
"""By the number of faulty channels; apart is more on one and less on the other."""
SIGNS: dict[str, Any] = {"more": 1.0, "less": -1.0, "apart": np.array([1.0, -1.0])}
LOOSE_N = -1e5
"""Pretension of a broken cable: it would have to stretch by centimetres to be taut."""
HEADINGS = ("healthy", "one faulty channel", "two faulty channels")


class ArmGivenUpError(Exception):
    """An arm that cannot be tared, or not be held in a pose."""


class Truth(Protocol):
    """The arm itself."""

    def tensions_n(
        self, command_rad: Array, pushes: Sequence[Push], broken: Sequence[int] = ()
    ) -> Array | None:
        """(M,) at a command under pushes; None where the arm does not bear them."""
        ...

    def read(self, tensions_n: Array, rng: np.random.Generator) -> Array | None:
        """Readings of tensions (M,); None for those of the arm file's sensors."""
        ...


class AsDescribed:
    """The arm of the file."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism

    def tensions_n(
        self, command_rad: Array, pushes: Sequence[Push], broken: Sequence[int] = ()
    ) -> Array | None:
        """See `Truth`."""
        at_m = self._mechanism.contact_m.copy()
        forces = np.zeros((len(at_m), 3))
        for push in pushes:
            at_m[push.segment - 1] = push.place_m
            forces[push.segment - 1] = push.force_n
        pretension_n = self._mechanism.pretension_n.copy()
        pretension_n[list(broken)] = LOOSE_N
        touched = replace(self._mechanism, contact_m=at_m, pretension_n=pretension_n)
        try:
            return solve_equilibrium(touched, command_rad, forces).tensions_n
        except EquilibriumError:
            return None

    def read(self, tensions_n: Array, rng: np.random.Generator) -> Array | None:
        """See `Truth`."""
        return None


class AsBuilt:
    """An arm of the independent plant, with errors of its own."""

    def __init__(self, nominal: Nominal, rng: np.random.Generator) -> None:
        self._built = BuiltArm(nominal, Workmanship(), rng)

    def tensions_n(
        self, command_rad: Array, pushes: Sequence[Push], broken: Sequence[int] = ()
    ) -> Array | None:
        """See `Truth`."""
        built = self._built
        if broken:
            pretension_n = built.body.pretension_n.copy()
            pretension_n[list(broken)] = LOOSE_N
            built = built.altered(lambda body: replace(body, pretension_n=pretension_n))
        try:
            return built.tensions_n(command_rad, pushes)
        except PlantError:
            return None

    def read(self, tensions_n: Array, rng: np.random.Generator) -> Array | None:
        """See `Truth`."""
        return self._built.read(tensions_n, rng)


class Touch(NamedTuple):
    """A contact: segment from 1 on, place on it, force (3,) along its axes at the command."""

    segment: int
    place_m: float
    force_n: Array


class TestedArm(EstimatedArm):
    """An arm that is tared straight, and at rest at a command since."""

    def __init__(
        self, name: str, command_rad: Array, rng: np.random.Generator, *, built: bool
    ) -> None:
        super().__init__(name, rng)
        self.truth: Truth = AsDescribed(self.mechanism)
        if built:
            self.truth = AsBuilt(_nominal(name), rng)
        self.touched_m = touched_places(self.arm).touched_m
        self.joint_m = np.concatenate([[0.0], np.cumsum(self.mechanism.segment_length_m)[:-1]])
        self._now_s = 0.0
        self._go_to(np.zeros(len(command_rad)))
        self._until(lambda: self.estimation.state.unloaded.known)
        self.tared_n = self.unloaded_n
        if command_rad.any():
            self._go_to(command_rad)
        self.release()
        self._until(lambda: self.next(self.read(self.unloaded_n)).force is not ForceState.MOVING)
        self.axes = kinematics.segment_rotations(self.mechanism, command_rad)

    def _go_to(self, command_rad: Array) -> None:
        self.command_rad = command_rad
        self.command(command_rad)
        unloaded_n = self.truth.tensions_n(command_rad, [])
        if unloaded_n is None:
            raise ArmGivenUpError
        self.unloaded_n = unloaded_n
        self.next(self.read(unloaded_n))

    def _until(self, true: Any) -> None:
        for _ in range(MOST_SAMPLES):
            if true():
                return
            self.next(self.read(self.unloaded_n))
        raise ArmGivenUpError

    def read(self, tensions_n: Array) -> Array:
        """Readings of tensions (M,) by this arm's sensors, never below zero."""
        read = self.truth.read(tensions_n, self.rng)
        return super().read(tensions_n) if read is None else np.maximum(read, 0.0)

    def next(self, reading_n: Array) -> Answer:
        """The answer to the next readings."""
        self._now_s += PERIOD_S
        return self.sample(reading_n, self._now_s)

    def tensions_n(self, touches: Sequence[Touch], broken: Sequence[int] = ()) -> Array | None:
        """(M,) under contacts; None where the arm does not bear them."""
        pushes = [
            Push(touch.segment, touch.place_m, self.axes[touch.segment - 1] @ touch.force_n)
            for touch in touches
        ]
        return self.truth.tensions_n(self.command_rad, pushes, broken)

    def drawn(self, largest_n: float) -> list[Touch]:
        """One contact, or two in a quarter of the cases."""
        rng = self.rng
        count = 2 if rng.random() < 0.25 else 1
        touches = []
        for n in sorted(rng.permutation(self.arm.segment_count)[:count].tolist()):
            size_n = rng.uniform(2.0, largest_n / count)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            along = rng.uniform(-AXIAL_SHARE, AXIAL_SHARE)
            force_n = size_n * np.array([along, np.sin(angle), np.cos(angle)])
            touches.append(Touch(n + 1, rng.uniform(*self.touched_m[n]), force_n))
        return touches

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
        elif fault == EXCHANGED:
            reading_n[of] = reading_n[of[::-1]]
        elif fault == STUCK:
            reading_n[of] = self.tared_n[of]
        return np.maximum(reading_n, 0.0)

    def answer(self, tensions_n: Array, fault: str, cables: Sequence[int]) -> Answer:
        """The judged answer; the arm is free again afterwards."""
        for _ in range(JUDGED_AFTER):
            answer = self.next(self.faulty(self.read(tensions_n), fault, cables))
        self.release()
        return answer

    def release(self) -> None:
        """The arm is untouched for long enough to be judged afresh."""
        for _ in range(RELEASED):
            self.next(self.read(self.unloaded_n))

    def wrong_n(self, touches: Sequence[Touch], contacts: Sequence[Contact]) -> float:
        """The largest error of a normal force, N; a share of the force does not count."""
        worst = 0.0
        unmatched = {contact.segment: contact for contact in contacts}
        for touch in touches:
            contact = unmatched.pop(self._stated_on(touch, unmatched), None)
            normal_n = float(np.hypot(*touch.force_n[1:]))
            off_n = normal_n if contact is None else self._off_n(touch, contact)
            if contact is None or off_n > WRONG_SHARE * normal_n:
                worst = max(worst, off_n)
        for segment, contact in unmatched.items():
            moment_n_m = contact.moment_n_m or 0.0
            length_m = float(self.mechanism.segment_length_m[segment - 1])
            worst = max(worst, contact.magnitude_n or moment_n_m / length_m)
        return worst

    def _stated_on(self, touch: Touch, contacts: dict[int, Contact]) -> int:
        """The segment whose stated contact is at the place of this one; 0 for none."""
        along_m = float(self.joint_m[touch.segment - 1]) + touch.place_m
        for segment in (touch.segment, touch.segment + 1, touch.segment - 1):
            if segment not in contacts:
                continue
            stated_m = float(self.joint_m[segment - 1]) + contacts[segment].contact_m
            if segment == touch.segment or abs(stated_m - along_m) < SAME_PLACE_M:
                return segment
        return 0

    def _off_n(self, touch: Touch, contact: Contact) -> float:
        """By how much a stated contact is off, along the axes of its segment."""
        n = contact.segment - 1
        force_n = (self.axes[n].T @ self.axes[touch.segment - 1] @ touch.force_n)[1:]
        direction = np.array(contact.direction)
        if contact.magnitude_n:
            return float(np.hypot(*(contact.magnitude_n * direction - force_n)))
        lever_m = float(self.joint_m[touch.segment - 1] - self.joint_m[n]) + touch.place_m
        moment_n_m = (contact.moment_n_m or 0.0) * direction
        off_n_m = float(np.hypot(*(moment_n_m - lever_m * force_n)))
        return off_n_m / float(self.mechanism.segment_length_m[n])


@cache
def _nominal(name: str) -> Nominal:
    return read_nominal(find_arm(name))


def tested_arm(
    name: str, bend_rad: float, rng: np.random.Generator, *, built: bool
) -> TestedArm | None:
    """An arm in a random pose; None where it cannot be tared, or does not hold itself there."""
    joints = _loaded(name).arm.joint_count
    try:
        return TestedArm(name, rng.uniform(-bend_rad, bend_rad, joints), rng, built=built)
    except ArmGivenUpError:
        return None


_loaded = cache(lambda name: load_model(name, ""))


def trial(
    name: str, given: argparse.Namespace, seed: int, channels: int, largest_n: float
) -> dict[str, Any]:
    """Counts of the states and of wrong contacts, of one arm with some faulty channels."""
    rng = np.random.default_rng([given.seed, seed, channels])
    states: Counter[str] = Counter()
    unconfirmed = 0
    given_up = 0
    wrong: list[dict[str, Any]] = []
    count = given.faulty if channels else given.samples
    title = f"{name}, {HEADINGS[channels]}"
    for number in track(range(-(-count // CONTACTS_AT_A_POSE)), title):
        bend_rad = 0.0 if number % 4 == 0 else BEND_RAD
        arm = tested_arm(name, bend_rad, rng, built=given.built)
        if arm is None:
            given_up += 1
            continue
        for _ in range(min(CONTACTS_AT_A_POSE, count - number * CONTACTS_AT_A_POSE)):
            untouched = channels and rng.random() < UNTOUCHED
            touches = [] if untouched else arm.drawn(largest_n)
            fault = str(rng.choice(FAULTS[channels])) if channels else ""
            cables = arm.cables(channels) if channels else []
            tensions_n = arm.tensions_n(touches, cables if fault == BROKEN else ())
            if tensions_n is None:
                continue
            answer = arm.answer(tensions_n, fault, cables)
            states[f"{_where(touches)}: {answer.force.value}"] += 1
            off_n = arm.wrong_n(touches, answer.contacts)
            unconfirmed += off_n > WRONG_N and answer.force is ForceState.UNCONFIRMED
            if answer.force.known and off_n > WRONG_N:
                faulty = fault and f"{fault}, cables {[n + 1 for n in cables]}"
                described = _described(touches, answer.contacts)
                wrong.append({"fault": faulty, **described, "off_n": round(off_n, 2)})
    return {
        "states": dict(sorted(states.items())),
        "contacts": states.total(),
        "arms_given_up": given_up,
        "wrong_and_unconfirmed": unconfirmed,
        "wrong_and_vouched": len(wrong),
        "wrong": wrong[:20],
    }


def _where(touches: Sequence[Touch]) -> str:
    if len(touches) > 1:
        return "two contacts"
    return f"segment {touches[0].segment}" if touches else "untouched"


def _described(touches: Sequence[Touch], contacts: Sequence[Contact]) -> dict[str, Any]:
    """What acts and what is stated."""
    acting = [
        (touch.segment, round(touch.place_m, 4), touch.force_n.round(2).tolist())
        for touch in touches
    ]
    stated = [
        (contact.segment, round(contact.contact_m, 4), round(contact.magnitude_n, 2))
        for contact in contacts
    ]
    return {"touches": acting, "contacts": stated}


def healthy_samples(name: str, given: argparse.Namespace, largest_n: float) -> dict[str, Any]:
    """States of samples of a healthy arm under one normal contact each, and of how many contacts.

    Those that are implausible get no force.
    """
    rng = np.random.default_rng(given.seed)
    states: Counter[str] = Counter()
    withheld = []  # of each contact
    arms = -(-given.healthy // (CONTACTS_AT_A_POSE * READINGS))
    contacts = -(-given.healthy // READINGS)
    for number in track(range(arms), f"{name}, healthy samples"):
        arm = tested_arm(name, BEND_RAD, rng, built=given.built)
        if arm is None:
            continue
        for _ in range(min(CONTACTS_AT_A_POSE, contacts - number * CONTACTS_AT_A_POSE)):
            n = int(rng.integers(arm.arm.segment_count))
            angle = rng.uniform(0.0, 2.0 * np.pi)
            force_n = rng.uniform(0.0, largest_n) * np.array([0.0, np.sin(angle), np.cos(angle)])
            tensions_n = arm.tensions_n([Touch(n + 1, rng.uniform(*arm.touched_m[n]), force_n)])
            if tensions_n is None:
                continue
            force_states = [arm.next(arm.read(tensions_n)).force for _ in range(READINGS)]
            states.update(f"segment {n + 1}: {force.value}" for force in force_states)
            withheld.append(force_states.count(ForceState.IMPLAUSIBLE))
            arm.release()
    return {
        "states": dict(sorted(states.items())),
        "samples": states.total(),
        "withheld": sum(withheld),
        "contacts": len(withheld),
        "contacts_with_withheld": sum(count > 0 for count in withheld),
    }


def main() -> int:
    """Tries healthy arms and faulty ones, prints, and keeps the figures with `--write`."""
    options = harness.parser(__doc__, "trust.json, or trust_built.json")
    options.add_argument("--samples", type=int, default=2500, help="contacts of each healthy arm")
    options.add_argument(
        "--faulty", type=int, default=1250, help="of each arm with one faulty channel or two"
    )
    options.add_argument("--healthy", type=int, default=0, help="samples whose states are counted")
    options.add_argument("--built", action="store_true", help="arms with errors of their own")
    options.add_argument("--seed", type=int, default=7101, help="of poses, contacts and noise")
    given = options.parse_args()
    result: dict[str, Any] = {}
    for seed, (name, borne_n) in enumerate(ARMS.items()):
        counts = (given.samples, given.faulty, given.faulty)
        result[name] = {
            HEADINGS[channels]: trial(name, given, seed, channels, borne_n)
            for channels, count in enumerate(counts)
            if count
        }
        if given.healthy:
            largest_n = _loaded(name).metadata.force_range_n
            result[name]["healthy samples"] = healthy_samples(name, given, largest_n)
    written = "trust_built.json" if given.built else "trust.json"
    return harness.publish(written, result, given, "numpy", "onnxruntime")


if __name__ == "__main__":
    sys.exit(main())
