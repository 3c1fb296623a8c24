"""Example machines after one tare, and after a calibration from unloaded poses, side by side.

    python benchmarks/calibrated_machines.py [--built 25] [--poses 25] [--seed 8301] [--write]

Each machine differs from its file as its tolerances allow. It is known by one tare in its
reference pose, or by a calibration from random unloaded poses within 10 degrees of that. Then it
is read in other poses, the same for both: untouched, and touched anywhere.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import harness
import numpy as np
from machines import FOLDER, MACHINES, TARE_READINGS, Bench, Contact, within
from rich.progress import track

from cablesense_base import Array
from cablesense_contact.calibration import Calibration, Unloaded
from cablesense_contact.judgement import ContactState
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import open_machine
from cablesense_sim.machine.simulated import SimulatedMachine

COMMANDS = 4
"""Of each machine, in which it is judged."""
UNTOUCHED = 100
"""Readings at each, and"""
TOUCHED = 2
"""contacts."""
POSE_READINGS = 20
"""Averaged in an unloaded pose, as a commissioning does."""
STATED = (ContactState.CONTACT, ContactState.MOMENT)


class Case(NamedTuple):
    """What a machine reads at one command.

    Attributes:
        command: (C,).
        untouched: (U, M) readings.
        contacts: those that it bears, and
        touched: (T, M) a reading of each.
    """

    command: Array
    untouched: Array
    contacts: list[Contact]
    touched: Array


class Tally:
    """What is stated of the cases of many machines, by one way to know them."""

    def __init__(self) -> None:
        self.readings = 0
        self.false_contacts: list[int] = []
        self.false_on: Counter[str] = Counter()
        self.false_n: list[float] = []
        self.refused = 0
        self.right: list[bool] = []
        self.half_width: list[float] = []
        self.error: list[float] = []
        self.force_holds: list[bool] = []
        self.place_mm: list[float] = []
        self.place_holds: list[bool] = []
        self.answered: list[bool] = []

    def judge(self, bench: Bench, known: Calibration, cases: list[Case]) -> None:
        """Take the statements on one machine, as well as it is known."""
        moved = bench.calibrator.moved(known)
        false = 0
        for case in cases:
            readings = np.concatenate([case.untouched, case.touched])
            commands = np.tile(case.command, (len(readings), 1))
            seen = bench.law(readings, commands, moved.mean, moved.covariance, bench.unrest)
            states = [
                bench.judge(seen.row(row), reading).state for row, reading in enumerate(readings)
            ]
            free = len(case.untouched)
            self.readings += free
            for row in range(free):
                if states[row] in STATED:
                    false += 1
                    link = bench.machine.links.names[int(seen.contact_evidence[row].argmax())]
                    self.false_on[f"{states[row].value} on {link}"] += 1
                    self.false_n.append(float(np.hypot(*seen.force_n[row, 1:])))
            for number, contact in enumerate(case.contacts):
                row = free + number
                self._take(contact, bench.felt_n(contact), seen.row(row), states[row])
        self.false_contacts.append(false)

    def _take(self, contact: Contact, true_n: float, seen: Any, state: ContactState) -> None:
        right = int(seen.contact_evidence[0].argmax()) == contact.link
        self.right.append(right)
        self.answered.append(state in STATED)
        if not right:
            return
        low_n, high_n = seen.magnitude_ci95_n[0]
        low_m, high_m = seen.place_ci95_m[0]
        self.half_width.append(0.5 * (high_n - low_n) / true_n)
        self.error.append(abs(float(np.hypot(*seen.force_n[0, 1:])) - true_n) / true_n)
        self.force_holds.append(bool(within(np.array([true_n]), seen.magnitude_ci95_n)[0]))
        self.place_mm.append(0.5e3 * (high_m - low_m))
        self.place_holds.append(bool(within(np.array([contact.place_m]), seen.place_ci95_m)[0]))

    def figures(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "machines": len(self.false_contacts),
            "refused": self.refused,
            "untouched readings": self.readings,
            "false contacts": sum(self.false_contacts),
            "machines with false contacts": int(np.count_nonzero(self.false_contacts)),
            "false contacts are": dict(self.false_on.most_common()),
            "their forces, N": harness.percentiles(self.false_n, ["median", "worst"]),
            "contacts": len(self.right),
            "answered": _share(self.answered),
            "link right": _share(self.right),
            "force interval, half, share": _median(self.half_width),
            "force error, share": _median(self.error),
            "force interval holds": _share(self.force_holds),
            "place interval, half, mm": _median(self.place_mm),
            "place interval holds": _share(self.place_holds),
        }


def _share(values: list[bool]) -> float:
    return round(float(np.mean(values)), 4)


def _median(values: list[float]) -> float:
    return float(f"{np.median(values):.3g}")


def unloaded(
    bench: Bench, built: SimulatedMachine, command: Array, count: int, rng: np.random.Generator
) -> Unloaded:
    """The mean of some readings of a machine that nothing touches."""
    values = built.untouched(command).values
    readings = bench.machine.channels.read(np.tile(values, (count, 1)), rng)
    return Unloaded(readings.mean(axis=0), command, count)


def case_of(bench: Bench, built: SimulatedMachine, rng: np.random.Generator) -> Case:
    """A command with readings of the machine there, untouched and touched."""
    command = bench.command(rng)
    rest = built.untouched(command)
    channels = bench.machine.channels
    contacts = []
    values = []
    for contact in [bench.contact(rng) for _ in range(TOUCHED)]:
        try:
            values.append(built.touched(command, (contact.acting,), rest).values)
        except MachineError:  # more than it bears
            continue
        contacts.append(contact)
    touched = np.array(values).reshape(-1, len(rest.values))
    return Case(
        command=command,
        untouched=channels.read(np.tile(rest.values, (UNTOUCHED, 1)), rng),
        contacts=contacts,
        touched=channels.read(touched, rng),
    )


def figures_of(name: str, built_count: int, poses: int, seed: int) -> dict[str, Any]:
    """Of machines within tolerances, by both ways to know them."""
    bench = Bench(open_machine(FOLDER / f"{name}.yaml"))
    rng = np.random.default_rng([seed, MACHINES.index(name)])
    at_reference = bench.holding.command_of(bench.machine.reference)
    tared = Tally()
    calibrated = Tally()
    for _ in track(range(built_count), name):
        built = bench.built(rng)
        tare = unloaded(bench, built, at_reference, TARE_READINGS, rng)
        in_poses = [
            unloaded(bench, built, bench.command(rng), POSE_READINGS, rng) for _ in range(poses)
        ]
        cases = [case_of(bench, built, rng) for _ in range(COMMANDS)]
        for tally, readings in ((tared, [tare]), (calibrated, in_poses)):
            known = bench.calibrator.from_poses(readings)
            # the node refuses a tare of which this is true, and warns of such a calibration
            if known.as_described:
                tally.judge(bench, known, cases)
            else:
                tally.refused += 1
    return {"one tare": tared.figures(), f"{poses} unloaded poses": calibrated.figures()}


def main() -> None:
    """Judges, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "calibrated_machines.json")
    options.add_argument("--built", type=int, default=25, help="machines of each kind")
    options.add_argument("--poses", type=int, default=25, help="unloaded ones of a calibration")
    options.add_argument(
        "--machines", nargs="*", default=["finger", "seven_hinges", "six_axis"], help="which"
    )
    options.add_argument("--seed", type=int, default=8301, help="of what is judged")
    given = options.parse_args()
    result = {
        name: figures_of(name, given.built, given.poses, given.seed) for name in given.machines
    }
    harness.publish("calibrated_machines.json", result, given, "mujoco", "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
