"""Machines whose tendons rub: which contacts are answered, and whether their intervals hold.

    python benchmarks/machine_friction.py [--machines finger seven_hinges] [--built 30] [--write]

Each machine is built within its tolerances, and rubs with a coefficient of friction. It is tared
in its reference pose, walks from pose to pose from rest to rest, with every bend of each tendon
sticking or sliding (`cablesense_sim.machine.quasi_static`), and is touched there as in
`machines.py`. A contact comes to the untouched machine, and goes; each is answered at rest, as by
the node. With `denied` the file says that nothing rubs, with `unstated` it says nothing, so that
the default applies. With `tolerance` and `followed` it states the coefficient; slides of tendons
are then unknown in every pose, or known by the way and by the readings' change, as with
`unstated`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np
from estimation_settings import estimation_settings
from machines import FOLDER, TARE_READINGS, Bench, Contact
from rich.progress import track

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_contact.cable_slides import CableSlides, FrictionParameters
from cablesense_contact.calibration import CalibrationError, Unloaded
from cablesense_contact.felt import FeltMachine
from cablesense_contact.judgement import ContactState, Judgement
from cablesense_contact.law import LawOutput
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.tendon_friction import CarriedTendonFriction
from cablesense_contact.machine.tendon_routes import TendonRoutes
from cablesense_online.calibrated_arm import CalibratedArm
from cablesense_sim.machine.description import Cables, MachineError
from cablesense_sim.machine.machine import Machine, open_machine
from cablesense_sim.machine.quasi_static import QuasiStaticMachine
from cablesense_sim.machine.tendon_guides import RUN_COMPLIANCE

COEFFICIENTS = (0.02, 0.05)
MACHINES = ("finger", "seven_hinges")
WAYS = ("denied", "unstated", "tolerance", "followed")
POSES = 4
RUN_LOG_STD = 0.5
"""Deviation of the logarithm of the compliance before a tendon's first site, over that behind."""
ANSWERED = (ContactState.CONTACT, ContactState.MOMENT)
HOLDS = 0.93


class Kind(StrEnum):
    """What came before a reading."""

    CAME = "after a motion"
    TOUCHED = "touched"
    RELEASED = "after a contact"


class Answer(NamedTuple):
    """What is stated of one reading, and the contact, None of the untouched machine."""

    kind: Kind
    contact: Contact | None
    seen: LawOutput
    judgement: Judgement


class Walk:
    """One built machine on its way, and the estimator's state."""

    def __init__(
        self, bench: Bench, felt: FeltMachine, coefficient: float, rng: np.random.Generator
    ) -> None:
        """Tare it in the reference pose.

        Raises:
            MachineError: the machine finds no rest.
            CalibrationError: the tare is refused.
        """
        self._bench = bench
        self._settings = estimation_settings()
        self._arm = CalibratedArm(felt, bench.law, self._settings)
        reference = bench.holding.command_of(bench.machine.reference)
        run_compliance = RUN_COMPLIANCE * float(np.exp(RUN_LOG_STD * rng.standard_normal()))
        self._moving = QuasiStaticMachine(bench.built(rng), reference, coefficient, run_compliance)
        values = self._moving.go(reference).values
        tared = bench.machine.channels.read(np.tile(values, (TARE_READINGS, 1)), rng)
        calibrator = self._arm.calibrator
        calibration = calibrator.updated(
            calibrator.by_tolerances(), Unloaded(tared.mean(axis=0), reference, TARE_READINGS)
        )
        self._state = self._arm.at(self._arm.begin(calibration), reference)

    def answers(self, rng: np.random.Generator) -> Iterator[Answer]:
        """Untouched, touched and released in poses.

        Raises:
            MachineError: the machine finds no rest.
        """
        bench = self._bench
        for _ in range(POSES):
            command = bench.command(rng)
            self._state = self._arm.at(self._state, command)
            yield self._untouched(command, rng, Kind.CAME)
            contact = bench.contact(rng)
            touched = self._moving.go(command, (contact.acting,))
            reading = bench.machine.channels.read(touched.values, rng)
            yield self._answer(reading, Kind.TOUCHED, contact)
            yield self._untouched(command, rng, Kind.RELEASED)

    def _untouched(self, command: Array, rng: np.random.Generator, kind: Kind) -> Answer:
        values = self._moving.go(command).values
        for _ in range(self._settings.tare_samples):
            reading = self._bench.machine.channels.read(values, rng)
            answer = self._answer(reading, kind)
            if answer.judgement.state is ContactState.FREE:
                self._state = self._arm.with_untouched(self._state, reading)
        return answer

    def _answer(self, reading: Array, kind: Kind, contact: Contact | None = None) -> Answer:
        answer = self._answer_once(reading, kind, contact, touched=False)
        is_free = answer.judgement.state is ContactState.FREE
        if is_free or self._arm.seen_untouched(self._state):
            return answer
        return self._answer_once(reading, kind, contact, touched=True)

    def _answer_once(
        self, reading: Array, kind: Kind, contact: Contact | None, *, touched: bool
    ) -> Answer:
        bench = self._bench
        command = self._state.pose_rad
        assert command is not None
        state, belief = self._arm.belief(self._state, reading, 1, touched=touched)
        self._state = state
        seen = bench.law(
            reading[None], command[None], belief.mean, belief.covariance, bench.unrest
        )
        return Answer(kind, contact, seen, bench.judge(seen, reading))


class NotFollowed(FeltModel):
    """A machine whose tendons' slides are a tolerance."""

    @property
    def slides(self) -> CableSlides:
        """Never followed."""
        routes = TendonRoutes(self.source, CarriedTendonFriction(self.source))
        routes.are_followed = False
        return CableSlides(routes, FrictionParameters.of(self.parameters))


def stated_machine(name: str, coefficient: float) -> Machine:
    """An example machine whose file states a coefficient of friction."""
    file = open_machine(FOLDER / f"{name}.yaml").source.file
    cables = file.cables.model_copy(update={"friction_coefficient": coefficient})
    model = str((FOLDER / file.model).resolve())
    changed = file.model_copy(update={"cables": cables, "model": model})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.yaml"
        path.write_text(changed.model_dump_json())
        return open_machine(path)


class Statement(NamedTuple):
    """An answer to a contact against the truth; or the columns (K,) of many.

    Attributes:
        is_contact: whether force and place are stated, not the moment alone.
        off_mm: error of the place, along all links.
        off_share: error of the lateral force, as a share of it.
        in_region, in_force: whether the 95 % intervals hold the truth.
        half_width_share: of the force's interval, as a share of the force.
    """

    is_contact: Any
    off_mm: Any
    off_share: Any
    in_region: Any
    in_force: Any
    half_width_share: Any


def figures_of(answers: list[Answer], bench: Bench) -> dict[str, Any]:
    """Of all contacts, and of untouched readings after motions and after contacts."""
    touched = [answer for answer in answers if answer.contact is not None]
    stated = [answer for answer in touched if answer.judgement.state in ANSWERED]
    links = bench.machine.links
    span_m = links.touched_m[:, 1] - links.touched_m[:, 0]
    joint_m = np.cumsum(span_m) - links.touched_m[:, 1]
    statements = []
    for answer in stated:
        contact = answer.contact
        assert contact is not None
        seen = answer.seen
        low_n, high_n = seen.magnitude_ci95_n[0]
        start_m, end_m = seen.region_m[0]
        along_m = joint_m[contact.link] + contact.place_m
        true_n = bench.felt_n(contact)
        lateral_n = float(np.hypot(*seen.force_n[0, 1:]))
        off_m = abs(joint_m[int(seen.contact_evidence[0].argmax())] + seen.place_m[0] - along_m)
        statements.append(
            Statement(
                is_contact=answer.judgement.state is ContactState.CONTACT,
                off_mm=1e3 * off_m,
                off_share=abs(lateral_n - true_n) / true_n,
                in_region=start_m - 1e-6 <= along_m <= end_m + 1e-6,
                in_force=low_n <= true_n <= high_n,
                half_width_share=0.5 * (high_n - low_n) / true_n,
            )
        )
    if not statements:
        return {"contacts": len(touched), "answered": 0.0}
    columns = Statement._make(np.array(statements, dtype=float).T)
    known = columns.is_contact > 0.0

    def share(kind: Kind) -> float:
        of_kind = [answer.judgement.state in ANSWERED for answer in answers if answer.kind is kind]
        return round(float(np.mean(of_kind)), 3)

    return {
        "contacts": len(touched),
        "answered": round(len(stated) / len(touched), 3),
        "with force": round(float(known.sum()) / len(touched), 3),
        "place interval holds": round(float(columns.in_region.mean()), 3),
        "force interval holds": round(float(columns.in_force.mean()), 3),
        "place, mm": harness.percentiles(columns.off_mm[known], ("median", "95 %")),
        "force, share": harness.percentiles(columns.off_share[known], ("median", "95 %"), 4),
        "half of the force interval, share": round(float(np.median(columns.half_width_share)), 3),
        "false contacts": {kind.value: share(kind) for kind in (Kind.CAME, Kind.RELEASED)},
    }


def judged(count: int, seed: int, name: str, coefficient: float, way: str) -> dict[str, Any]:
    """Many built of one machine with a coefficient, in one of the ways of knowing it."""
    unlike_built = {"denied": 0.0, "unstated": Cables().friction_coefficient}
    bench = Bench(stated_machine(name, unlike_built.get(way, coefficient)))
    felt = NotFollowed(bench.machine) if way == "tolerance" else FeltModel(bench.machine)
    answers: list[Answer] = []
    refused = 0
    for number in range(count):
        rng = np.random.default_rng([seed, MACHINES.index(name), round(1e3 * coefficient), number])
        try:
            answers += Walk(bench, felt, coefficient, rng).answers(rng)
        except (MachineError, CalibrationError):
            refused += 1
    return {**figures_of(answers, bench), "tares refused, or no rest": refused}


def main() -> None:
    """Judges, prints; keeps figures with `--write`."""
    options = harness.parser(__doc__, "machine_friction.json")
    options.add_argument("--built", type=int, default=30, help="machines of each case")
    options.add_argument("--machines", nargs="*", default=list(MACHINES), help="some of them")
    options.add_argument("--ways", nargs="*", default=list(WAYS), help="some of them")
    options.add_argument(
        "--coefficients", nargs="*", type=float, default=list(COEFFICIENTS), help="of friction"
    )
    options.add_argument("--seed", type=int, default=8301, help="of the machines and contacts")
    options.add_argument("--workers", type=int, default=2, help="processes")
    given = options.parse_args()
    cases = list(product(given.machines, given.coefficients, given.ways))
    result: dict[str, Any] = {}
    bars: dict[str, bool] = {}
    with WorkerPool(given.workers, given.built, given.seed) as pool:
        judgements = track(pool.map(judged, *zip(*cases, strict=True)), total=len(cases))
        for (name, coefficient, way), figures in zip(cases, judgements, strict=True):
            result.setdefault(name, {}).setdefault(f"{coefficient:g}", {})[way] = figures
            if way != "followed" or not figures["answered"]:
                continue
            for what in ("place interval holds", "force interval holds"):
                bar = f"{name}, {coefficient:g}: {what}: {figures[what]:g}, at least {HOLDS:g}"
                bars[bar] = figures[what] >= HOLDS
    result["bars"] = bars
    harness.publish("machine_friction.json", result, given, "mujoco", "numpy", "onnxruntime")


if __name__ == "__main__":
    main()
