"""Several contacts at once: what the check of plausibility lets pass of sound and faulty arms.

    python benchmarks/several_contacts.py [--loads 1000] [--faulty 20] [--write]

The straight arm `cdsm` with its model of several contacts: one to four segments touched, each by
up to the force of the model's training in any direction, one reading of each load. With the faults
of `plausibility.py`, each in every cable's channel. A case is wrong where the force told of any
segment, none where it is not told, is more than 5 N off.
"""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any, cast

import harness
import numpy as np
import plausibility

from cablesense_base import Array
from cablesense_online.models import MultiContactModel, load_model
from cablesense_online.plausibility import PlausibilityCheck
from cablesense_online.samples import SampleError
from cablesense_online.tare import UnloadedTensions
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.replay import read_tensions_n
from cablesense_training.inference.estimator import MultiEstimator


class Bench:
    """The straight arm with its model of several contacts, a tare, and the check."""

    def __init__(self) -> None:
        loaded = load_model("cdsm", "cdsm_multi")
        assert isinstance(loaded.estimator, MultiEstimator)
        self.arm, self.rng = loaded.arm, np.random.default_rng(20_260_122)
        self.range_n = loaded.estimator.metadata.force_range_n
        self.statics = UnloadedTensions(self.arm)
        self.mechanism = self.statics.mechanism
        self.command = np.zeros(self.arm.joint_count)
        self.axes = kinematics.segment_rotations(self.mechanism, self.command)[..., 1:]
        unloaded_n = self.statics.predict_n(self.command)
        self.tare = self.read(np.tile(unloaded_n, (plausibility.TARE_SAMPLES, 1))).mean(axis=0)
        still = SimpleNamespace(pose_rad=self.command, unloaded_n=self.tare)
        self.check = PlausibilityCheck(
            self.statics,
            self.arm,
            plausibility.TARE_SAMPLES,
            loaded.largest_misfit(-1.0),
            loaded.estimator.metadata,
        )
        self.model = MultiContactModel(
            loaded.estimator, cast(Any, still), cast(Any, still), self.check.fits
        )
        self.stamp_ns = 0

    def read(self, tensions_n: Array) -> Array:
        """Readings, never below zero."""
        return np.maximum(read_tensions_n(tensions_n, self.arm.sensors, self.rng), 0.0)

    def load(self) -> tuple[int, Array, Array]:
        """How many segments are touched, forces (N, 3) on all, and a reading under them (M,)."""
        while True:
            count = int(self.rng.integers(1, self.arm.segment_count + 1))
            touched = self.rng.choice(self.arm.segment_count, count, replace=False)
            angle, size_n = self.rng.uniform([0.0, 0.0], [2 * np.pi, self.range_n], (count, 2)).T
            forces = np.zeros((self.arm.segment_count, 3))
            parts = (size_n * np.array([np.sin(angle), np.cos(angle)])).T[..., None]
            forces[touched] = (self.axes[touched] @ parts)[..., 0]
            try:
                tensions_n = self.statics.at_rest(self.command, forces).tensions_n
            except EquilibriumError:
                continue  # the arm collapses
            return count, forces, self.read(tensions_n[None])[0]

    def judged(self, reading_n: Array, forces: Array) -> tuple[str, float]:
        """The state of a reading (M,), and by how much a force is off."""
        self.stamp_ns += plausibility.APART_NS
        estimate = self.model.estimate(reading_n, self.stamp_ns)
        assert estimate is not None
        contacts = self.model.decide(estimate, 0.5, self.mechanism.contact_m.tolist())
        told = np.zeros_like(forces)
        for contact in contacts:
            part = contact.magnitude_n * np.array(contact.direction)
            told[contact.segment - 1] = self.axes[contact.segment - 1] @ part
        off_n = float(np.linalg.norm(told - forces, axis=1).max())
        try:
            self.check.check(reading_n - self.tare, self.command, contacts, self.stamp_ns)
        except SampleError:
            return "withheld", off_n
        return "unconfirmed" if self.check.doubt else "vouched for", off_n


def counted(cases: list[tuple[int, str, float]]) -> dict[str, Any]:
    """States by number of contacts, of right and of wrong forces, and the largest error."""
    figures: dict[str, Any] = {}
    for wrong in (False, True):
        those = [case for case in cases if (case[2] > plausibility.WRONG_N) is wrong]
        by_count = Counter((count, state) for count, state, _ in those)
        figures["wrong" if wrong else "right"] = {
            f"{count} touched": {
                state: n for (c, state), n in sorted(by_count.items()) if c == count
            }
            for count in sorted({count for count, _ in by_count})
        }
    vouched = [off_n for _, state, off_n in cases if state == "vouched for"]
    largest_n = round(max(vouched, default=0.0), 2)
    return figures | {"cases": len(cases), "largest error vouched for (N)": largest_n}


def main() -> None:
    """Measures and prints; with `--write` writes the file."""
    parser = harness.parser(__doc__, "results/several_contacts.json")
    parser.add_argument("--loads", type=int, default=1000, help="of a sound arm")
    parser.add_argument("--faulty", type=int, default=20, help="loads with every fault")
    options = parser.parse_args()
    bench, sound, faulty = Bench(), [], []
    for _ in range(options.loads):
        count, forces, reading_n = bench.load()
        sound.append((count, *bench.judged(reading_n, forces)))
    for _ in range(options.faulty):
        count, forces, reading_n = bench.load()
        for cable in range(bench.arm.cable_count):
            for _, changed_n in plausibility.faults(cast(Any, bench), reading_n, cable):
                faulty.append((count, *bench.judged(changed_n, forces)))
    result = harness.origin() | {"sound": counted(sound), "faulty": counted(faulty)}
    harness.publish("several_contacts.json", result, options)


if __name__ == "__main__":
    main()
