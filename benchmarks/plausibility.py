"""The plausibility check: samples of healthy arms that it withholds, and faults that it passes.

    python benchmarks/plausibility.py [--commands 500] [--faulty 60] [--write]

Healthy arms: random commands within 10 degrees, a tare of 50 readings at each; 20 loads, one
fifth none, the others 0 to 200 N on any segment in any direction; 50 readings of each. Faulty
arms: every cable has every fault under each load; a force is wrong by the length of the difference
between the estimated and the true one, or by the larger of the two where segments differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import harness
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_msgs_py.messages import Contact, Level
from cablesense_online.answer import decide
from cablesense_online.models import load_model
from cablesense_online.plausibility import PlausibilityCheck
from cablesense_online.samples import SampleError
from cablesense_online.stated_contacts import RestingArm
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import read_tensions_n
from cablesense_training.inference.estimator import Estimator

ARMS = ("cdsm", "cdsm_lab")
LARGEST_MISFIT = 2.3
TARE_SAMPLES, LOADS, READINGS = 50, 20, 50
WRONG_N = 5.0
APART_NS, PERIOD_NS = 10_000_000_000, 10_000_000
SCALES = (0.5, 0.8, 0.9, 1.1, 2.0)
OFFSETS_N = (-20.0, -5.0, -2.0, 2.0, 5.0, 20.0, 100.0)
LOOSE_N = -1e5
"""Pretension of a broken cable: it would have to stretch by centimetres to be taut."""


class Bench:
    """One arm with its estimator and check, at one random command with its tare."""

    def __init__(self, arm_name: str, number: int) -> None:
        loaded = load_model(arm_name, arm_name)  # of contacts at the points of the arm file
        assert isinstance(loaded.estimator, Estimator)
        self.arm, self.estimator = loaded.arm, loaded.estimator
        self.rng = np.random.default_rng([20_260_013, ARMS.index(arm_name), number])
        resting = RestingArm(self.arm, TARE_SAMPLES)
        self.mechanism = resting.mechanism
        self.check = PlausibilityCheck(resting, LARGEST_MISFIT, self.estimator.metadata)
        self.command = np.deg2rad(self.rng.uniform(-10.0, 10.0, self.arm.joint_count))
        unloaded = resting.predict_n(self.command)
        self.tare = self.read(np.tile(unloaded, (TARE_SAMPLES, 1))).mean(axis=0)
        self._stamp_ns = 0

    def read(self, tensions_n: Array) -> Array:
        """Readings, never below zero."""
        return np.maximum(read_tensions_n(tensions_n, self.arm.sensors, self.rng), 0.0)

    def contacts(self, readings_n: Array) -> list[Contact]:
        """The estimates of readings (B, M)."""
        found = self.estimator.estimate_batch(readings_n - self.tare, self.command)
        reach_m = self.mechanism.contact_m.tolist()
        rows = zip(found.probabilities.tolist(), found.angle_deg, found.magnitude_n, strict=True)
        return [decide(p, float(angle), float(force), 0.5, reach_m) for p, angle, force in rows]

    def passes(self, reading_n: Array, contact: Contact, after_ns: int = APART_NS) -> bool:
        """Whether a reading (M,) fits its estimate, so long after the one before."""
        self._stamp_ns += after_ns
        try:
            contacts = [contact] if contact.segment else []
            self.check.check(reading_n - self.tare, self.command, contacts, self._stamp_ns)
        except SampleError:
            return False
        return True

    def loads(self, count: int) -> tuple[NDArray[np.int64], Array]:
        """Segments from 0 (none, one fifth) to N, and forces (B, 2), y and z, of random loads."""
        segments = self.rng.integers(1, self.arm.segment_count + 1, count)
        segments[self.rng.random(count) < 0.2] = 0
        angles = self.rng.uniform(0.0, 2.0 * np.pi, count)
        forces = self.rng.uniform(0.0, 200.0, count)[:, None]
        forces = forces * np.column_stack([np.sin(angles), np.cos(angles)])
        return segments, forces * (segments > 0)[:, None]

    def tensions_n(
        self, mechanism: Mechanism, segments: NDArray[np.int64], forces: Array
    ) -> Array:
        """(B, M) true tensions under those loads."""
        commands = np.tile(self.command, (len(segments), 1))
        angle_deg = np.rad2deg(np.arctan2(forces[:, 0], forces[:, 1]))
        size = np.hypot(forces[:, 0], forces[:, 1])
        loads = normal_force_n(self.mechanism, commands, segments, angle_deg, size)
        return solve_equilibrium(mechanism, commands, loads).tensions_n


def wrong_n(contact: Contact, segment: int, force_n: Array) -> float:
    """How far an estimate is from the true force (2,)."""
    y, z = (contact.magnitude_n * part for part in contact.direction)
    if contact.segment == segment:
        return float(np.hypot(y - force_n[0], z - force_n[1]))
    return max(contact.magnitude_n, float(np.hypot(*force_n)))


def healthy(arm_name: str, number: int) -> Array:
    """Misfit, whether it passes, segment, and whether it is unconfirmed, of each sample."""
    bench = Bench(arm_name, number)
    segments, forces = bench.loads(LOADS)
    tensions_n = bench.tensions_n(bench.mechanism, segments, forces)
    rows = []
    for segment, true in zip(segments, tensions_n, strict=True):
        readings = bench.read(np.tile(true, (READINGS, 1)))
        apart_ns = APART_NS
        for reading, contact in zip(readings, bench.contacts(readings), strict=True):
            passes, apart_ns = bench.passes(reading, contact, apart_ns), PERIOD_NS
            rows.append((bench.check.misfit, passes, segment, passes and bool(bench.check.doubt)))
    return np.array(rows)


def faults(bench: Bench, reading_n: Array, cable: int) -> Iterator[tuple[str, Array]]:
    """A healthy reading (M,) as every fault of one cable's channel leaves it."""

    def with_reading(value: float) -> Array:
        changed = reading_n.copy()
        changed[cable] = max(value, 0.0)
        return changed

    own = float(reading_n[cable])
    for scale in SCALES:
        yield f"scale {scale:g}", with_reading(scale * own)
    for offset in OFFSETS_N:
        yield f"offset {offset:+g} N", with_reading(own + offset)
    yield "stuck at the tare", with_reading(float(bench.tare[cable]))
    yield "zero", with_reading(0.0)
    yield "19,999 N", with_reading(19_999.0)
    others = [other for other in range(len(reading_n)) if other != cable]
    for other in bench.rng.choice(others, 3, replace=False):
        changed = with_reading(float(reading_n[other]))
        changed[other] = own
        yield "exchanged with another", changed
    if cable == 0:
        yield "all twelve at zero", np.zeros_like(reading_n)


class FaultCase(NamedTuple):
    """One fault under one load: the error of the force, and whether it passes."""

    fault: str
    wrong_n: float
    passes: bool
    unconfirmed: bool


def faulty(arm_name: str, number: int) -> list[FaultCase]:
    """Every case at one command."""
    bench = Bench(arm_name, 1_000_000 + number)
    segments, forces = bench.loads(6)
    tensions = bench.tensions_n(bench.mechanism, segments, forces)
    cases: list[tuple[str, Array, int]] = []
    for i, true in enumerate(tensions):
        reading = bench.read(true)
        for cable in range(bench.arm.cable_count):
            cases += [(name, changed, i) for name, changed in faults(bench, reading, cable)]
    for cable in range(bench.arm.cable_count):
        pretension = bench.mechanism.pretension_n.copy()
        pretension[cable] = LOOSE_N
        broken = replace(bench.mechanism, pretension_n=pretension)
        for i in range(len(segments)):
            try:
                true = bench.tensions_n(broken, segments[i : i + 1], forces[i : i + 1])[0]
            except EquilibriumError:
                continue  # the arm collapses
            cases.append(("broken cable", bench.read(true), i))
    contacts = bench.contacts(np.array([reading for _, reading, _ in cases]))
    judged = []
    for (name, reading, i), contact in zip(cases, contacts, strict=True):
        off_n, passes = wrong_n(contact, segments[i], forces[i]), bench.passes(reading, contact)
        unconfirmed = bench.check.status().level is Level.WARN
        judged.append(FaultCase(name, off_n, passes, unconfirmed))
    return judged


def healthy_figures(options: Any, arm_name: str) -> dict[str, Any]:
    """The samples of a healthy arm that are withheld or unconfirmed."""
    with WorkerPool(options.workers, arm_name) as pool:
        sound = np.concatenate(list(pool.map(healthy, range(options.commands))))
    misfit, passes, segment, unconfirmed = sound.T
    return {
        "samples": len(sound),
        "withheld": int((passes == 0).sum()),
        "contacts": int((segment > 0).sum()),
        "unconfirmed": int(unconfirmed.sum()),
        "of_these_on_segment_1": int(unconfirmed[segment == 1].sum()),
        "misfit": harness.percentiles(misfit, ("median", "99 %", "99.99 %", "worst")),
    }


def fault_figures(options: Any, arm_name: str) -> dict[str, Any]:
    """Which faults make a wrong force, and which of these pass."""
    with WorkerPool(options.workers, arm_name) as pool:
        found = [row for rows in pool.map(faulty, range(options.faulty)) for row in rows]
    by_fault = {
        name: _counts([row for row in found if row.fault == name])
        for name in dict.fromkeys(row.fault for row in found)
    }
    return {**_counts(found), "faults": by_fault}


def _counts(rows: list[FaultCase]) -> dict[str, int]:
    passed = [row for row in rows if row.wrong_n > WRONG_N and row.passes]
    return {
        "cases": len(rows),
        "noticed": sum(not row.passes for row in rows),
        "wrong": sum(row.wrong_n > WRONG_N for row in rows),
        "wrong_and_passed": len(passed),
        "of_these_not_reported_as_unconfirmed": sum(not row.unconfirmed for row in passed),
    }


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/plausibility.json")
    parser.add_argument("--commands", type=int, default=500, help="of 1000 healthy samples each")
    parser.add_argument("--faulty", type=int, default=60, help="commands with every fault")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    options = parser.parse_args()
    arms = {
        name: ({"healthy": healthy_figures(options, name)} if options.commands else {})
        | ({"faulty": fault_figures(options, name)} if options.faulty else {})
        for name in ARMS
    }
    result = {"largest_misfit": LARGEST_MISFIT, "arms": arms}
    harness.publish("plausibility.json", result, options)


if __name__ == "__main__":
    main()
