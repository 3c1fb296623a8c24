"""Contacts on the example machines, by the law of each, against the bound and its own intervals.

    python benchmarks/machines.py [--samples 1000] [--untouched 100000] [--seed 8101] [--write]

Each sample is of another machine, which differs from its file as its tolerances allow, in a pose
within 10 degrees of its reference, and is read with the sensors' noise and step. Nothing of it was
calibrated, but for a tare of those that nothing touches. A contact is anywhere on the links and
around them, at any radius up to the surface's, and its force points beside the axis and along it
by up to the friction of the file.

The bound is that of Cramér and Rao: the law's derivative by the contact, at the pose of the
machine as its file describes it under that contact, with the covariance of what is read by noise
and tolerances, and with the law's priors.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
from rich.progress import track

from cablesense_base import Array
from cablesense_contact.calibration import CalibrationError, Calibrator, Unloaded
from cablesense_contact.judgement import ContactState, Judge
from cablesense_contact.law import LawOutput
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.model_file import open_machine_law
from cablesense_contact.machine.observation import OperatingPoint
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.holding import Holding
from cablesense_sim.machine.machine import Machine, open_machine
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from cablesense_training.machine_export import export_machine

FOLDER = Path(__file__).parents[1] / "config" / "machines"
MACHINES = ("finger", "hand", "seven_hinges", "continuum", "six_axis")
REACH_DEG = 10.0
FORCES = (0.05, 1.0)
"""Lateral forces, as shares of the largest that the file expects."""
TARE_READINGS = 50
"""Of a tare, as by default of the node."""
AT_ONCE = 200
HALF_NORMAL_MEDIAN = 0.6744898
"""Median of the absolute value of a standard normal number."""
DETERMINED = 0.1
"""A force is determined if its bound is below this share of it, and"""
PLACED = 0.2
"""a place if its bound is below this share of its link."""
FROM_JOINT = 3.0
"""Deviations of a place from the nearest end of its link, beyond which the link must be right."""

OVER_BOUND = 1.25
LINK_RIGHT = 0.99
COVERAGE = (0.93, 0.975)
FALSE_CONTACTS = 1e-5
RESTS_PER_CORE = 1500.0
SAMPLE_MS = 1.0


class Contact(NamedTuple):
    """A contact on a machine's link.

    Attributes:
        link: its number.
        place_m: along the link's axis.
        point_m: (3,) on the surface, in the link's axis frame.
        force_n: (3,) along the link's stated axes.
    """

    link: int
    place_m: float
    point_m: Array
    force_n: Array

    @property
    def lateral_n(self) -> float:
        """Of the force across the link."""
        return float(np.hypot(*self.force_n[1:]))

    @property
    def acting(self) -> LinkForce:
        """As what a simulated machine is touched by."""
        return LinkForce(self.link, self.point_m, self.force_n)


class Sample(NamedTuple):
    """A reading, its command, the contact, and the least deviations of place, m, and force, N."""

    reading: Array
    command: Array
    contact: Contact
    place_std_m: float
    lateral_std_n: float


@dataclass(frozen=True)
class Stated:
    """What is stated of B contacts, and the truth.

    Attributes:
        link, true_link: (B,).
        place_m, true_place_m: (B,) along these.
        lateral_n, true_lateral_n: (B,).
        in_place, in_region, in_force: (B,) whether intervals hold what is true.
        place_std_m, lateral_std_n: (B,) bounds.
        answered: (B,) whether a contact is stated.
    """

    link: Array
    true_link: Array
    place_m: Array
    true_place_m: Array
    lateral_n: Array
    true_lateral_n: Array
    in_place: Array
    in_region: Array
    in_force: Array
    place_std_m: Array
    lateral_std_n: Array
    answered: Array


class Bench:
    """One machine with its law."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{machine.name}.onnx"
            export_machine(self.machine, path, "benchmarks/machines.py")
            self.law = open_machine_law(path, self.machine)
        felt = FeltModel(self.machine)
        self.felt_across = felt.felt_across
        self.judge = Judge(felt)
        self.calibrator = Calibrator(felt, self.law)
        self.parameters = self.law.observer.parameters
        self.mean = self.parameters.prior_mean
        self.covariance = np.diag(self.parameters.prior_std**2)
        count = len(self.machine.coordinates)
        self.unrest = np.zeros((count, count))
        self.holding = Holding(self.machine)
        exact = np.zeros(len(self.parameters))
        self.as_described = SimulatedMachine(self.machine, self.parameters, exact)

    def command(self, rng: np.random.Generator) -> Array:
        """One that holds the machine near a pose within reach of the reference."""
        coordinates = self.machine.coordinates
        away = np.deg2rad(rng.uniform(-REACH_DEG, REACH_DEG, len(coordinates)))
        pose = self.machine.reference + np.where(coordinates.is_hinge, away, 0.0)
        return self.holding.command_of(pose)

    def built(self, rng: np.random.Generator) -> SimulatedMachine:
        """A machine within tolerances."""
        deviations = self.parameters.prior_std * rng.standard_normal(len(self.parameters))
        return SimulatedMachine(self.machine, self.parameters, self.mean + deviations)

    def contact(self, rng: np.random.Generator) -> Contact:
        """Anywhere on the machine."""
        links = self.machine.links
        touch = self.machine.source.file.touch
        link = int(rng.integers(len(links.names)))
        place_m = float(rng.uniform(*links.touched_m[link]))
        lateral_n = float(rng.uniform(*FORCES)) * touch.largest_n
        inward = rng.uniform(0.0, 2.0 * np.pi)
        beside = touch.friction * rng.uniform(-1.0, 1.0)
        along_n = lateral_n * touch.friction * rng.uniform(-1.0, 1.0)
        out_m = links.radius_m[link] * np.sqrt(rng.uniform())
        point_m = np.array([place_m, -out_m * np.sin(inward), -out_m * np.cos(inward)])
        direction = np.array([np.sin(inward + beside), np.cos(inward + beside)])
        return Contact(link, place_m, point_m, np.append(along_n, lateral_n * direction))

    def sample(self, rng: np.random.Generator) -> Sample | None:
        """A contact on a built machine; None if that, or the one described, finds no rest."""
        built = self.built(rng)
        command = self.command(rng)
        contact = self.contact(rng)
        try:
            touched = built.touched(command, (contact.acting,), built.untouched(command))
            place_std_m, lateral_std_n = self.bound(command, contact)
        except MachineError:
            return None
        reading = self.machine.channels.read(touched.values, rng)
        return Sample(reading, command, contact, place_std_m, lateral_std_n)

    def bound(self, command: Array, contact: Contact) -> tuple[float, float]:
        """Least deviations of place, m, and lateral force, N.

        The unknowns are the force, the line at which it crosses the axis, the torsion about it,
        and the share of the radius at which it acts.
        """
        machine = self.as_described
        touched = machine.touched(command, (contact.acting,), machine.untouched(command))
        operating_point = None if self.machine.is_measured else OperatingPoint(touched.pose)
        seen = self.law.observer.observe(
            touched.values, command, 0.0 * self.mean, self.covariance, self.unrest, operating_point
        )
        links = self.machine.links
        touch = self.machine.source.file.touch
        radius_m = float(links.radius_m[contact.link])
        x, y, z = contact.force_n
        lateral_n = contact.lateral_n
        share = 0.5
        line_m = contact.place_m + radius_m * share * x / lateral_n
        levers = seen.levers[contact.link]
        by_force = levers[:3] + line_m * levers[3:]
        by_line = contact.force_n @ levers[3:]
        columns = np.stack([*by_force, by_line, seen.torsion[contact.link, 0]])
        # (f_x, f_y, f_z, line, torsion) by (f_x, f_y, f_z, place, torsion, share)
        by = np.zeros((5, 6))
        by[range(5), range(5)] = 1.0
        by[3, 0] = radius_m * share / lateral_n
        by[3, 1] = -radius_m * share * x * y / lateral_n**3
        by[3, 2] = -radius_m * share * x * z / lateral_n**3
        by[3, 5] = radius_m * x / lateral_n
        by_unknowns = seen.by_torque @ columns.T @ by
        information = by_unknowns.T @ seen.information @ by_unknowns
        span_m = float(np.diff(links.touched_m[contact.link])[0])
        spreads = np.array(
            [
                touch.friction * lateral_n,
                touch.largest_n,
                touch.largest_n,
                span_m / np.sqrt(12.0),
                touch.friction * radius_m * lateral_n,
                1.0 / np.sqrt(12.0),
            ]
        )
        covariance = np.linalg.inv(information + np.diag(spreads**-2))
        felt = self.felt_across[contact.link] @ contact.force_n[1:]
        across = np.concatenate([[0.0], felt / np.linalg.norm(felt), np.zeros(3)])
        return float(covariance[3, 3] ** 0.5), float((across @ covariance @ across) ** 0.5)

    def felt_n(self, contact: Contact) -> float:
        """Of a force across its link what the machine feels, which is what is stated."""
        return float(np.linalg.norm(self.felt_across[contact.link] @ contact.force_n[1:]))

    def answers(self, readings: Array, commands: Array) -> LawOutput:
        """What the law states."""
        parts = [
            self.law(
                readings[first : first + AT_ONCE],
                commands[first : first + AT_ONCE],
                self.mean,
                self.covariance,
                self.unrest,
            )
            for first in range(0, len(readings), AT_ONCE)
        ]
        return LawOutput._make(np.concatenate(column) for column in zip(*parts, strict=True))

    def stated(self, samples: list[Sample]) -> Stated:
        """The law's statements on samples."""
        readings = np.array([sample.reading for sample in samples])
        commands = np.array([sample.command for sample in samples])
        seen = self.answers(readings, commands)
        links = self.machine.links
        span_m = links.touched_m[:, 1] - links.touched_m[:, 0]
        joint_m = np.cumsum(span_m) - links.touched_m[:, 1]
        true_link = np.array([sample.contact.link for sample in samples])
        true_place_m = np.array([sample.contact.place_m for sample in samples])
        true_lateral_n = np.array([self.felt_n(sample.contact) for sample in samples])
        states = [self.judge(seen.row(row), reading).state for row, reading in enumerate(readings)]
        return Stated(
            link=seen.contact_evidence.argmax(axis=1),
            true_link=true_link,
            place_m=seen.place_m,
            true_place_m=true_place_m,
            lateral_n=np.hypot(*seen.force_n[:, 1:].T),
            true_lateral_n=true_lateral_n,
            in_place=within(true_place_m, seen.place_ci95_m),
            in_region=within(joint_m[true_link] + true_place_m, seen.region_m),
            in_force=within(true_lateral_n, seen.magnitude_ci95_n),
            place_std_m=np.array([sample.place_std_m for sample in samples]),
            lateral_std_n=np.array([sample.lateral_std_n for sample in samples]),
            answered=np.array(
                [state in (ContactState.CONTACT, ContactState.MOMENT) for state in states]
            ),
        )

    def false_contacts(self, count: int, rng: np.random.Generator, until_s: float) -> Any:
        """Samples of untouched machines, and how many of these are answered with a contact.

        As by the node, there is a tare in the reference pose first. A machine whose tare is
        refused, as none of its tolerances, has no answers.
        """
        judged = 0
        false = 0
        refused = 0
        while judged < count and time.monotonic() < until_s:
            built = self.built(rng)
            at_reference = self.holding.command_of(self.machine.reference)
            values = built.untouched(at_reference).values
            tared = self.machine.channels.read(np.tile(values, (TARE_READINGS, 1)), rng)
            tare = Unloaded(tared.mean(axis=0), at_reference, TARE_READINGS)
            try:
                known = self.calibrator.updated(self.calibrator.by_tolerances(), tare)
            except CalibrationError:
                refused += 1
                judged += AT_ONCE
                continue
            command = self.command(rng)
            values = built.untouched(command).values
            readings = self.machine.channels.read(np.tile(values, (AT_ONCE, 1)), rng)
            commands = np.tile(command, (AT_ONCE, 1))
            seen = self.law(readings, commands, known.mean, known.covariance, self.unrest)
            for row, reading in enumerate(readings):
                state = self.judge(seen.row(row), reading).state
                false += state in (ContactState.CONTACT, ContactState.MOMENT)
            judged += AT_ONCE
        return {"samples": judged, "false_contacts": false, "tares refused": refused}

    def rests_per_s(self, samples: list[Sample]) -> float:
        """Rests under contacts, from the untouched one on, in a second of one core."""
        machine = self.as_described
        statics = machine.built.statics
        cases = []
        for sample in samples[:200]:
            untouched = machine.untouched(sample.command)
            axes = machine.frames(sample.command, untouched).axes[sample.contact.link]
            acting = sample.contact.acting
            force = LinkForce(acting.link, acting.point_m, axes @ acting.force_n)
            cases.append((machine.unstretched_m(sample.command), force, untouched.pose))
        began = time.process_time()
        for unstretched_m, force, start in cases:
            statics.rest(unstretched_m, (force,), start)
        return len(cases) / (time.process_time() - began)

    def sample_ms(self, samples: list[Sample]) -> float:
        """Processor time of one sample at a command that is known, ms."""
        spent_s = 0.0
        for sample in samples[:200]:
            row = (sample.reading[None], sample.command[None])
            known = (self.mean, self.covariance, self.unrest)
            self.law(*row, *known)
            began = time.process_time()
            self.law(*row, *known)
            spent_s += time.process_time() - began
        return 1e3 * spent_s / len(samples[:200])


def within(value: Array, interval: Array) -> Array:
    """(B,) whether values are inside intervals (B, 2), to rounding."""
    rounding = 1e-6 * np.abs(value)
    return np.asarray((interval[:, 0] <= value + rounding) & (value - rounding <= interval[:, 1]))


def figures_of(bench: Bench, stated: Stated) -> dict[str, Any]:
    """Of all contacts, and of those that readings determine."""
    links = bench.machine.links
    low, high = links.touched_m[stated.true_link].T
    margin_m = np.minimum(stated.true_place_m - low, high - stated.true_place_m)
    placed = stated.place_std_m < PLACED * (high - low)
    clear = margin_m > FROM_JOINT * stated.place_std_m
    right = stated.link == stated.true_link
    sized = stated.lateral_std_n < DETERMINED * stated.true_lateral_n
    force_n = np.abs(stated.lateral_n - stated.true_lateral_n)
    place_m = np.abs(stated.place_m - stated.true_place_m)

    def over_bound(error: Array, bound: Array, rows: Array) -> float:
        return round(float(np.median(error[rows] / bound[rows])) / HALF_NORMAL_MEDIAN, 3)

    clear_rows = placed & clear
    known = placed & right
    force_rows = sized & right
    shares = {
        "contacts": len(right),
        "answered": round(float(stated.answered.mean()), 3),
        "place determined": int(placed.sum()),
        "clear of joints": int(clear_rows.sum()),
        "link right, clear of joints": round(float(right[clear_rows].mean()), 4),
        "place, mm": harness.percentiles(1e3 * place_m[known], ("median", "95 %")),
        "place over bound": over_bound(place_m, stated.place_std_m, clear_rows & right),
        "force determined": int(sized.sum()),
        "force, share": harness.percentiles(
            (force_n / stated.true_lateral_n)[force_rows], ("median", "95 %"), 4
        ),
        "force over bound": over_bound(force_n, stated.lateral_std_n, force_rows),
        "region holds": round(float(stated.in_region.mean()), 4),
        "place interval holds": round(float(stated.in_place[right].mean()), 4),
        "force interval holds": round(float(stated.in_force[right].mean()), 4),
    }
    by_link = {}
    for n, name in enumerate(links.names):
        on_link = stated.true_link == n
        if not on_link.any():
            continue
        by_link[name] = [
            int(on_link.sum()),
            int((on_link & right).sum()),
            round(float(stated.in_region[on_link].mean()), 3),
            round(float(stated.in_force[on_link].mean()), 3),
        ]
    return {**shares, "links: contacts, right, region holds, force interval holds": by_link}


def bars_of(name: str, figures: dict[str, Any]) -> dict[str, bool]:
    """Which bars a machine keeps."""
    bars: dict[str, bool] = {}

    def bar(what: str, value: float, least: float, most: float) -> None:
        bars[f"{name}: {what}: {value:.4g} in [{least:g}, {most:g}]"] = least <= value <= most

    bar("link right", figures["link right, clear of joints"], LINK_RIGHT, 1.0)
    bar("place over bound", figures["place over bound"], 0.0, OVER_BOUND)
    bar("force over bound", figures["force over bound"], 0.0, OVER_BOUND)
    bar("region holds", figures["region holds"], *COVERAGE)
    bar("force interval holds", figures["force interval holds"], *COVERAGE)
    untouched = figures["untouched"]
    most = max(1.0, FALSE_CONTACTS * untouched["samples"])
    bar(f"false contacts of {untouched['samples']}", untouched["false_contacts"], 0.0, most)
    if name == "seven_hinges":
        bar("rests a second and core", figures["rests a second"], RESTS_PER_CORE, np.inf)
        bar("sample, ms", figures["sample, ms"], 0.0, SAMPLE_MS)
    return bars


def main() -> None:
    """Judges, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "machines.json")
    options.add_argument("--samples", type=int, default=1000, help="of each machine")
    options.add_argument("--untouched", type=int, default=100_000, help="of each machine")
    options.add_argument("--machines", nargs="*", default=list(MACHINES), help="some of them")
    options.add_argument("--minutes", type=float, default=60.0, help="at most, for untouched ones")
    options.add_argument("--seed", type=int, default=8101, help="of the samples to judge")
    given = options.parse_args()
    result: dict[str, Any] = {}
    bars: dict[str, bool] = {}
    for name in given.machines:
        row = MACHINES.index(name)
        bench = Bench(open_machine(FOLDER / f"{name}.yaml"))
        rng = np.random.default_rng([given.seed, row])
        drawn = [bench.sample(rng) for _ in track(range(given.samples), name)]
        samples = [sample for sample in drawn if sample is not None]
        figures = figures_of(bench, bench.stated(samples))
        figures["not borne"] = len(drawn) - len(samples)
        until_s = time.monotonic() + 60.0 * given.minutes
        figures["untouched"] = bench.false_contacts(
            given.untouched, np.random.default_rng([given.seed, row, 1]), until_s
        )
        if not bench.machine.is_measured:
            figures["rests a second"] = round(bench.rests_per_s(samples))
        figures["sample, ms"] = round(bench.sample_ms(samples), 3)
        result[name] = figures
        bars |= bars_of(name, figures)
    result["bars"] = bars
    harness.publish("machines.json", result, given, "mujoco", "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
