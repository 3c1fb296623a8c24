"""Contacts through the estimation, healthy and faulty: which are stated, and which are wrong.

    python benchmarks/trust.py [--samples 2500] [--faulty 1250] [--healthy 0] [--built]
        [--tared-there] [--write]

Arms are tared straight, then touched in random poses within 10 degrees, a quarter of them in the
straight one; with `--tared-there` they are tared in that pose, too. One contact acts anywhere on
the arm, or two, of 2 N to what the arm bears, with an axial part of up to 0.3 of the normal force.
Messages are serialized, with the sensors' noise and step, 100 a second.

An answer is judged after 20 samples; `judging.py` says which are wrong. `free` is wrong if
contacts have a moment about some joint of more than 5 N over the length of its segment. Larger
forces next to a joint, with a smaller moment, are counted by themselves, and so are two contacts
that are answered as one.

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
from estimated_arm import START_NS, EstimatedArm
from judging import WRONG_N, Acting, Stated, error_n, is_one, is_wrong, share
from rich.progress import track

from cablesense_base import Array
from cablesense_msgs_py.messages import ForceState
from cablesense_online.answer import Answer
from cablesense_online.models import load_model
from cablesense_online.tare import TareError
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
HOW_MANY = ("untouched", "one contact", "two contacts")


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
        self,
        name: str,
        command_rad: Array,
        rng: np.random.Generator,
        *,
        built: bool,
        tared_there: bool = False,
    ) -> None:
        """`tared_there` takes another tare at the command."""
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
        if tared_there:
            self._tare()
        self.axes = kinematics.segment_rotations(self.mechanism, command_rad)

    def _go_to(self, command_rad: Array) -> None:
        self.command_rad = command_rad
        self.command(command_rad)
        unloaded_n = self.truth.tensions_n(command_rad, [])
        if unloaded_n is None:
            raise ArmGivenUpError
        self.unloaded_n = unloaded_n
        self.next(self.read(unloaded_n))

    def _tare(self) -> None:
        for _ in range(self.settings.tare_samples):
            self.next(self.read(self.unloaded_n))
        try:
            self.estimation.take_tare(START_NS + round(self._now_s * 1e9))
        except TareError as error:
            raise ArmGivenUpError from error
        self.release()

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

    def under(self, touches: Sequence[Touch]) -> Acting:
        """The arm under contacts."""
        pushes = tuple(
            Push(touch.segment, touch.place_m, self.axes[touch.segment - 1] @ touch.force_n)
            for touch in touches
        )
        return Acting(pushes, self.axes, self.mechanism.segment_length_m)

    def tensions_n(self, acting: Acting, broken: Sequence[int] = ()) -> Array | None:
        """(M,) under contacts; None where the arm does not bear them."""
        return self.truth.tensions_n(self.command_rad, acting.pushes, broken)

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


class Answered(NamedTuple):
    """An arm under contacts, and what it is answered.

    Attributes:
        touches: of the arm.
        acting: the same, as they are judged.
        answer: of the estimator.
        fault: of some channels; empty of a healthy arm.
    """

    touches: Sequence[Touch]
    acting: Acting
    answer: Answer
    fault: str

    @property
    def stated(self) -> Stated | None:
        """The contact that is stated, to be judged; None of none."""
        answer = self.answer
        contact = answer.contact
        estimate = answer.estimate
        region_m = answer.region_m
        if estimate is None or region_m is None:
            return None
        return Stated(
            segment=contact.segment,
            only_moment=answer.force is ForceState.MOMENT,
            place_m=contact.contact_m,
            lateral_n=np.array(contact.wrench[1:3]),
            moment_n_m=np.array(contact.wrench[4:]),
            region_m=self.acting.joint_m[contact.segment - 1] + np.array(region_m),
            interval_n=np.array([estimate.low_n, estimate.high_n]),
        )

    @property
    def is_wrong(self) -> bool:
        """Whether what is stated is wrong, be it vouched for or not."""
        if self.stated is not None:
            return is_wrong(self.acting, self.stated)
        return self.answer.force is ForceState.FREE and self.largest_moment_as_force_n > WRONG_N

    @property
    def error_n(self) -> float:
        """By how much it is off."""
        if self.stated is not None:
            return error_n(self.acting, self.stated)
        return self.largest_moment_as_force_n

    @property
    def largest_n(self) -> float:
        """The largest lateral force on the arm."""
        return max(map(self.acting.lateral_size_n, self.acting.pushes), default=0.0)

    @property
    def largest_moment_as_force_n(self) -> float:
        """The largest moment about a joint, over the length of its segment."""
        segments = range(1, len(self.acting.length_m) + 1)
        return max(map(self.acting.moment_as_force_n, segments))

    @property
    def most_unseen_n(self) -> float:
        """Up to which force a contact may act that is not stated."""
        bounds = self.answer.bounds
        return 0.0 if bounds is None else bounds[1].magnitude_n

    @property
    def unmentioned_n(self) -> float:
        """The largest lateral force of a contact that is not the stated one."""
        stated = self.stated
        acting = self.acting
        others = acting.pushes
        if stated is not None:
            others = tuple(push for push in others if not is_one(acting, push, stated))
        return max(map(acting.lateral_size_n, others), default=0.0)


@cache
def _nominal(name: str) -> Nominal:
    return read_nominal(find_arm(name))


def tested_arm(
    name: str, bend_rad: float, rng: np.random.Generator, given: argparse.Namespace
) -> TestedArm | None:
    """An arm in a random pose; None where it cannot be tared, or does not hold itself there."""
    joints = _loaded(name).arm.joint_count
    command_rad = rng.uniform(-bend_rad, bend_rad, joints)
    try:
        return TestedArm(name, command_rad, rng, built=given.built, tared_there=given.tared_there)
    except ArmGivenUpError:
        return None


_loaded = cache(lambda name: load_model(name, ""))


def trial(
    name: str, given: argparse.Namespace, seed: int, channels: int, largest_n: float
) -> dict[str, Any]:
    """Counts of the states and of wrong contacts, of one arm with some faulty channels."""
    rng = np.random.default_rng([given.seed, seed, channels])
    answered: list[Answered] = []
    given_up = 0
    count = given.faulty if channels else given.samples
    title = f"{name}, {HEADINGS[channels]}"
    for number in track(range(-(-count // CONTACTS_AT_A_POSE)), title):
        bend_rad = 0.0 if number % 4 == 0 else BEND_RAD
        arm = tested_arm(name, bend_rad, rng, given)
        if arm is None:
            given_up += 1
            continue
        for _ in range(min(CONTACTS_AT_A_POSE, count - number * CONTACTS_AT_A_POSE)):
            untouched = channels and rng.random() < UNTOUCHED
            touches = [] if untouched else arm.drawn(largest_n)
            fault = str(rng.choice(FAULTS[channels])) if channels else ""
            cables = arm.cables(channels) if channels else []
            acting = arm.under(touches)
            tensions_n = arm.tensions_n(acting, cables if fault == BROKEN else ())
            if tensions_n is None:
                continue
            answer = arm.answer(tensions_n, fault, cables)
            faulty = fault and f"{fault}, cables {[n + 1 for n in cables]}"
            answered.append(Answered(touches, acting, answer, faulty))
    return {**figures(answered), "arms_given_up": given_up}


def figures(answered: Sequence[Answered]) -> dict[str, Any]:
    """What the answers come to."""
    states = Counter(f"{_where(one.touches)}: {one.answer.force.value}" for one in answered)
    known = [one for one in answered if one.answer.force.known]
    wrong = [one for one in known if one.is_wrong]
    unconfirmed = [one for one in answered if one.answer.force is ForceState.UNCONFIRMED]
    free = [one for one in known if one.answer.force is ForceState.FREE]
    near_joints = [one for one in free if one.largest_n > WRONG_N and not one.is_wrong]
    of_contacts = Counter(HOW_MANY[len(one.touches)] for one in wrong)
    as_one = [
        one for one in known if len(one.touches) > 1 and one.answer.force is ForceState.CONTACT
    ]
    right = [one for one in as_one if not one.is_wrong]
    return {
        "states": dict(sorted(states.items())),
        "contacts": states.total(),
        "wrong_and_unconfirmed": sum(one.is_wrong for one in unconfirmed),
        "vouched": len(known) - len(free),
        "wrong_and_vouched": len(wrong),
        "wrong_and_vouched_of": {number: of_contacts[number] for number in HOW_MANY},
        "wrong_and_vouched_by_more_than_5_n": sum(one.error_n > WRONG_N for one in wrong),
        "two_answered_as_one": {
            "contacts": len(as_one),
            "wrong": len(as_one) - len(right),
            "share_wrong": share([one.is_wrong for one in as_one]),
            "right_about_one_and_the_other_above_5_n": sum(
                one.unmentioned_n > WRONG_N for one in right
            ),
        },
        "free_under_more_than_5_n_next_to_a_joint": {
            "contacts": len(near_joints),
            "above_the_stated_bound": sum(
                one.largest_n > one.most_unseen_n for one in near_joints
            ),
        },
        "wrong": [_described(one) for one in wrong[:20]],
    }


def _where(touches: Sequence[Touch]) -> str:
    if len(touches) > 1:
        return "two contacts"
    return f"segment {touches[0].segment}" if touches else "untouched"


def _described(one: Answered) -> dict[str, Any]:
    """What acts and what is stated."""
    acting = [
        (touch.segment, round(touch.place_m, 4), touch.force_n.round(2).tolist())
        for touch in one.touches
    ]
    stated = [
        (contact.segment, round(contact.contact_m, 4), round(contact.magnitude_n, 2))
        for contact in one.answer.contacts
    ]
    return {
        "fault": one.fault,
        "touches": acting,
        "state": one.answer.force.value,
        "contacts": stated,
        "off_n": round(one.error_n, 2),
    }


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
        arm = tested_arm(name, BEND_RAD, rng, given)
        if arm is None:
            continue
        for _ in range(min(CONTACTS_AT_A_POSE, contacts - number * CONTACTS_AT_A_POSE)):
            n = int(rng.integers(arm.arm.segment_count))
            angle = rng.uniform(0.0, 2.0 * np.pi)
            force_n = rng.uniform(0.0, largest_n) * np.array([0.0, np.sin(angle), np.cos(angle)])
            touch = Touch(n + 1, rng.uniform(*arm.touched_m[n]), force_n)
            tensions_n = arm.tensions_n(arm.under([touch]))
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
    options = harness.parser(__doc__, "trust.json, or trust_built.json, …_tared_there.json")
    options.add_argument("--samples", type=int, default=2500, help="contacts of each healthy arm")
    options.add_argument(
        "--faulty", type=int, default=1250, help="of each arm with one faulty channel or two"
    )
    options.add_argument("--healthy", type=int, default=0, help="samples whose states are counted")
    options.add_argument("--built", action="store_true", help="arms with errors of their own")
    options.add_argument("--tared-there", action="store_true", help="another tare in each pose")
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
    built = "_built" if given.built else ""
    tared_there = "_tared_there" if given.tared_there else ""
    return harness.publish(
        f"trust{built}{tared_there}.json", result, given, "numpy", "onnxruntime"
    )


if __name__ == "__main__":
    sys.exit(main())
