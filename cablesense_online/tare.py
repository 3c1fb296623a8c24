"""The unloaded state of an arm: readings of which a tare is made, and what the tare changes.

A tare is the mean of the latest readings at one pose with nothing touching. On an arm with a law
it updates the calibration (`CalibratedArm`): the arm is then known better in every pose. A network
gets tension differences, so there it is carried to other poses by the arm file (`TaredArm`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Generic, TypeVar

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.cable_slides import CableSlides, LastWay
from cablesense_contact.calibration import Calibration, CalibrationError, Calibrator, Unloaded
from cablesense_contact.judgement import Judge
from cablesense_contact.law import Law
from cablesense_contact.reference_contacts import FORCE_N, ReferenceContacts
from cablesense_contact.slides import Belief, Slides
from cablesense_contact.slides_under_load import SlidesUnderLoad
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.settings import EstimationSettings
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium

_MOST_KEPT = 16
"""How many times a tare can be undone."""
_ONE_POSE_RAD = 1e-3
"""Readings of a tare are of poses within this of the first."""
_AGED_EVERY_NS = 30_000_000_000
"""How often the drift of the sensors' zeros is added to what is known."""
_FEWEST_UNTOUCHED = 5
"""Readings of the untouched arm at this pose before a cable can be said to have moved since."""


class TareError(CableSenseError):
    """No tare can be taken or undone now; the message states why, and what to do."""


def utc_text(time_ns: int) -> str:
    """A time since the epoch to the second, as diagnostics show it."""
    return f"{datetime.fromtimestamp(time_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S UTC}"


@dataclass(frozen=True)
class Tare:
    """The mean of some readings of the untouched arm, as the estimator took it.

    Attributes:
        unloaded: the readings.
        by_itself: whether it was taken by `auto_tare`.
        misfit_n: (M,) by how much the readings differed from what was expected of the arm.
    """

    unloaded: Unloaded
    by_itself: bool
    misfit_n: Array

    def described(self, cable_names: Sequence[str]) -> str:
        """Time and values, as text for a log; `cable_names` (M,)."""
        rows = zip(cable_names, self.unloaded.reading_n, self.misfit_n, strict=True)
        cables = ", ".join(f"{name} {tension:.2f} ({off:+.2f})" for name, tension, off in rows)
        return (
            f"at {utc_text(self.unloaded.taken_ns)}: average of {self.unloaded.count} readings; "
            f"in N, with the deviation from what was expected: {cables}"
        )


Known = TypeVar("Known")


class UnloadedArm(ABC, Generic[Known]):
    """The readings of the next tare, and the tares so far.

    Attributes:
        automatic: whether a tare is to be taken as soon as nothing is against it.
        tares: those in force, the latest last.
    """

    def __init__(self, settings: EstimationSettings, start: Known, *, known: bool) -> None:
        self._settings = settings
        self._readings: deque[Sequence[float]] = deque(maxlen=settings.tare_samples)
        self._pose_rad: Array | None = None
        self._state = start
        self._earlier: deque[Known] = deque(maxlen=_MOST_KEPT)
        self._known = known
        self.automatic = settings.auto_tare and not known
        self.tares: list[Tare] = []

    @property
    def known(self) -> bool:
        """Whether there is an unloaded state: a tare, or a calibration that was loaded."""
        return self._known or bool(self.tares)

    @property
    def undoable(self) -> int:
        """How many times `undo` can be called."""
        return len(self._earlier)

    @property
    def awaited(self) -> str:
        """Why the automatic tare is not taken though readings are there; else empty."""
        enough = len(self._readings) >= self._settings.tare_samples
        return self.refusal() if self.automatic and enough else ""

    def at(self, pose_rad: Array) -> None:
        """Readings are from now on of this pose (2N,)."""
        if self._pose_rad is None or np.abs(pose_rad - self._pose_rad).max() > _ONE_POSE_RAD:
            self._readings.clear()
            self._pose_rad = pose_rad
            self._moved(pose_rad)

    def forget_readings(self) -> None:
        """Exclude all earlier readings from the next tare."""
        self._readings.clear()

    def add(self, reading_n: Sequence[float]) -> None:
        """Add a reading (M,) in N at the present pose, with the arm at rest."""
        self._readings.append(reading_n)

    def drop_own(self) -> bool:
        """Drop a tare that was taken by itself; whether there was one."""
        if not (self.tares and self.tares[-1].by_itself):
            return False
        self.undo()
        self.automatic = True
        return True

    def refusal(self) -> str:
        """Why the last readings are no tare, as text; empty where they may be one."""
        count = self._settings.tare_samples
        steady_n = self._settings.tare_steady_n
        if len(self._readings) < count:
            return (
                f"only {len(self._readings)} of {count} usable readings at this pose yet; wait a "
                "moment with the arm at rest and call again"
            )
        spread_n = np.std(self._readings, axis=0)
        worst = int(np.argmax(spread_n))
        if spread_n[worst] > steady_n:
            return (
                f"cable_{worst + 1} varies by {spread_n[worst]:.2f} N (standard deviation; at "
                f"most {steady_n:g} N); let the arm rest with nothing touching it and call again"
            )
        return ""

    def take(self, now_ns: int, *, by_itself: bool = False, forced: bool = False) -> Tare:
        """Take the average of the last readings as the unloaded state at the present pose.

        `now_ns` is the time since the epoch. `forced` takes any steady readings.

        Raises:
            TareError: too few readings yet, they are not steady, or they are not those of the
                untouched arm.
        """
        if refusal := self.refusal():
            raise TareError(refusal)
        assert self._pose_rad is not None
        mean_n = np.mean(self._readings, axis=0)
        unloaded = Unloaded(
            mean_n, self._pose_rad, len(self._readings), now_ns, self._came_from_rad
        )
        state, misfit_n = self._with_tare(unloaded, forced=forced)
        tare = Tare(unloaded, by_itself, misfit_n)
        self._earlier.append(self._state)
        self.tares.append(tare)
        self.automatic = False
        self._use(state)
        return tare

    def undo(self) -> Tare | None:
        """Return to the state before the last tare; gives the tare now in force, if any.

        Raises:
            TareError: there is nothing to undo.
        """
        if not self._earlier:
            raise TareError("no tare has been taken, so there is nothing to undo")
        self._use(self._earlier.pop())
        self.tares.pop()
        return self.tares[-1] if self.tares else None

    def _use(self, state: Known) -> None:
        self._state = state

    @abstractmethod
    def _with_tare(self, unloaded: Unloaded, *, forced: bool) -> tuple[Known, Array]:
        """The state with a tare, and by how much its readings (M,) differ from the expected."""

    @abstractmethod
    def _moved(self, pose_rad: Array) -> None:
        """The arm is at another pose (2N,)."""

    @property
    def _came_from_rad(self) -> Array | None:
        """The pose (2N,) from which the unloaded arm came to the present one, if known."""
        return None

    @abstractmethod
    def status(self) -> Status:
        """The unloaded state, for diagnostics."""

    def _tare_status(self, message: str, values: dict[str, str]) -> Status:
        if not self.known:
            message = "call ~/tare with the arm unloaded"
            if self.automatic:
                message = f"auto_tare waits: {self.awaited or 'too few readings at rest yet'}"
            return Status("tare", Level.WARN, f"none taken: no estimate; {message}")
        if self.tares:
            last = self.tares[-1].unloaded
            values |= {
                "tared since": utc_text(last.taken_ns),
                "readings averaged": str(last.count),
                "tares that can be undone": str(self.undoable),
            }
        return Status("tare", Level.OK, message, values)


class CalibratedArm(UnloadedArm[Calibration]):
    """An arm with a law: tares update its calibration, and readings tell where cables slide.

    A cable whose reading has changed since the untouched arm rested at this pose has slid at its
    guides, in the direction of the change; what friction adds to its tension is then known but
    for the coefficient. One that has not moved may carry anything that friction holds.
    """

    def __init__(
        self,
        arm: Arm,
        law: Law,
        settings: EstimationSettings,
        calibration: Calibration | None = None,
    ) -> None:
        self.calibrator = Calibrator(arm, law)
        self._arm = arm
        self._law = law
        self._judge = Judge(arm)
        self._contacts: ReferenceContacts | None = None
        self._known_to_n: float | None = None
        self._measured: Calibration | None = None
        start = calibration or self.calibrator.by_tolerances()
        super().__init__(settings, start, known=calibration is not None)
        self._slides = CableSlides(arm)
        self._way = LastWay()
        self._unrest = np.zeros((arm.joint_count, arm.joint_count))
        self._untouched_n = np.zeros(arm.cable_count)
        self._untouched = 0
        self._aged_ns = 0
        self._beliefs: dict[object, Belief] = {}
        self._under_load: SlidesUnderLoad | None = None

    @property
    def calibration(self) -> Calibration:
        """The calibration in force."""
        return self._state

    def load(self, calibration: Calibration) -> None:
        """Take over a calibration; earlier tares count no more."""
        self._earlier.append(self._state)
        self.tares.clear()
        self._known = True
        self.automatic = False
        self._use(calibration)

    def restore(self, calibration: Calibration, *, known: bool) -> None:
        """Answer by the calibration of another estimator, as far as its state was known."""
        self._earlier.clear()
        self.tares.clear()
        self._known = known
        self.automatic = False
        self._use(calibration)

    def belief(
        self, reading_n: Array, now_ns: int, *, freed: bool = False, touched: bool = False
    ) -> Belief:
        """What is known at readings (M,) at a time since the epoch.

        Args:
            reading_n: they are given one after the other, as loads change.
            now_ns: the time.
            freed: whether a breath has taken friction out of the readings.
            touched: whether the arm is touched though it was not yet seen untouched here.
        """
        # whole steps since the last unloaded reading, which follow from sample and state alone
        passed_ns = now_ns - self._state.changed_ns
        aged_ns = now_ns - passed_ns % _AGED_EVERY_NS
        if aged_ns != self._aged_ns:
            self._aged_ns = aged_ns
            self._beliefs.clear()
        if freed:
            return self._with("freed", self._slides.freed, aged_ns)
        if not self._rubs:
            return self._with("unknown", self._slides.unknown, aged_ns)
        if self._untouched >= _FEWEST_UNTOUCHED:
            key, slides = self._slides.rounded(self._followed().follow(reading_n))
            return self._with(key, slides, aged_ns)
        if touched:
            return self._with("touched", self._slides.unknown, aged_ns)
        return self._with("came", self._came(), aged_ns)

    def untouched(self, reading_n: Array) -> None:
        """Note a reading (M,) of the arm that nothing touches, at the present pose."""
        weight = 1.0 / min(self._untouched + 1, self._settings.tare_samples)
        self._untouched_n = self._untouched_n + weight * (reading_n - self._untouched_n)
        self._untouched += 1

    def touched(self) -> None:
        """Note that something has moved cables over their guides, at the present pose."""
        self._way.forget()

    @property
    def seen_untouched(self) -> bool:
        """Whether the arm was seen untouched at this pose, or nothing depends on it."""
        return self._untouched >= _FEWEST_UNTOUCHED or not self._rubs

    @property
    def _rubs(self) -> bool:
        """Whether friction can be seen."""
        known = Belief(self._state.mean, self._state.covariance)
        return self._slides.matter(known)

    def _came(self) -> Slides:
        """Slides of the unloaded arm as it came to the present pose."""
        came_from_rad = self._came_from_rad
        if came_from_rad is None or self._pose_rad is None:
            return self._slides.unknown
        return self._slides.after_motion(came_from_rad, self._pose_rad)

    def _followed(self) -> SlidesUnderLoad:
        if self._under_load is None:
            assert self._pose_rad is not None
            known = Belief(self._state.mean, self._state.covariance)
            self._under_load = self._slides.under_load(
                self._pose_rad, self._untouched_n.copy(), known, self._came()
            )
        return self._under_load

    def _with(self, key: object, slides: Slides, now_ns: int) -> Belief:
        """What is known with these slides, which have a key among those of the present state."""
        if key not in self._beliefs:
            if len(self._beliefs) > _MOST_KEPT:
                self._beliefs.clear()
            calibration = self.calibrator.aged(self._state, now_ns)
            known = Belief(calibration.mean, calibration.covariance)
            self._beliefs[key] = self._slides.carried(known, slides)
        return self._beliefs[key]

    def _use(self, state: Calibration) -> None:
        same = np.array_equal(state.mean, self._state.mean)
        super()._use(state)
        self._beliefs.clear()
        if not same:
            self._under_load = None

    def _moved(self, pose_rad: Array) -> None:
        self._untouched = 0
        self._beliefs.clear()
        self._under_load = None
        self._way.go(pose_rad)

    @property
    def _came_from_rad(self) -> Array | None:
        return self._way.came_from_rad

    def _with_tare(self, unloaded: Unloaded, *, forced: bool) -> tuple[Calibration, Array]:
        present = self.calibrator.moved(self._state)
        seen = self._law(
            unloaded.reading_n[None],
            unloaded.command_rad[None],
            present.mean,
            present.covariance,
            self._unrest,
        )
        try:
            updated = self.calibrator.updated(self._state, unloaded, force=forced)
        except CalibrationError as error:
            doubt = self._judge(seen, unloaded.reading_n).doubt
            what = f" It may be that {doubt}." if doubt else ""
            raise TareError(f"{error}.{what} Set tare_force to take it nevertheless") from error
        return updated, seen.innovation_n[0]

    def force_known_to_n(self) -> float | None:
        """Half of the 95 % interval of a push of `FORCE_N` after a move to another pose, N.

        None where the arm of the file bears no such push.
        """
        if self._measured is not self._state:
            self._measured = self._state
            moved = self.calibrator.moved(self._state)
            try:
                self._contacts = self._contacts or ReferenceContacts(self._arm)
            except EquilibriumError:
                self._known_to_n = None
            else:
                known = moved.mean, moved.covariance
                self._known_to_n = self._contacts.force_known_n(self._law, *known)
        return self._known_to_n

    def status(self) -> Status:
        """How well the arm is known."""
        calibration = self._state
        poses = len(calibration.unloaded)
        values = {
            "calibrated by": calibration.made_from,
            "unloaded readings": str(poses),
            "misfit probability": f"{calibration.misfit_probability:.3g}",
        }
        message = f"known by {calibration.made_from}"
        if tares := len(self.tares):
            message += f" and {tares} tare{'s' * (tares > 1)}"
        force_n = self.force_known_to_n()
        if force_n is not None:
            values["force known to (N)"] = f"{force_n:.3f}"
            message += f": a push of {FORCE_N:g} N to ±{force_n:.2f} N"
        status = self._tare_status(message, values)
        if status.level is Level.OK and not calibration.as_described:
            return Status(
                "tare",
                Level.WARN,
                "the unloaded readings do not fit the tolerances of the arm file: it is not as "
                "described, or was touched; enlarge its tolerances, or diagnose it",
                values,
            )
        return status


class TaredArm(UnloadedArm[Tare | None]):
    """An arm whose model takes tension differences: one tare, carried to poses by the arm file."""

    def __init__(self, arm: Arm, settings: EstimationSettings) -> None:
        super().__init__(settings, None, known=False)
        self._nominal = mechanism_of(arm)
        self._mechanism = amended(self._nominal, entries_of(arm))
        self._limit_n = settings.tare_deviation_n or math.inf
        self._here_n: Array | None = None
        self._there_n: Array | None = None

    def unloaded_n(self) -> Array | None:
        """(M,) readings of the untouched arm at the present pose; None before a tare.

        Raises:
            EquilibriumError: the arm has no rest there.
        """
        if self._state is None or self._there_n is None:
            return None
        return self._state.unloaded.reading_n + self._predicted_n() - self._there_n

    def _predicted_n(self) -> Array:
        """(M,) at the present pose by the arm file."""
        if self._here_n is None:
            assert self._pose_rad is not None
            held_m = held_lengths_m(self._nominal, self._pose_rad)
            rest = solve_equilibrium(self._mechanism, self._pose_rad, held_m=held_m)
            self._here_n = rest.tensions_n
        return self._here_n

    def _moved(self, pose_rad: Array) -> None:
        self._here_n = None

    def _use(self, state: Tare | None) -> None:
        super()._use(state)
        self._there_n = None
        if state is not None:
            command_rad = state.unloaded.command_rad
            held_m = held_lengths_m(self._nominal, command_rad)
            rest = solve_equilibrium(self._mechanism, command_rad, held_m=held_m)
            self._there_n = rest.tensions_n

    def _with_tare(self, unloaded: Unloaded, *, forced: bool) -> tuple[Tare | None, Array]:
        off_n = unloaded.reading_n - self._predicted_n()
        worst = int(np.argmax(np.abs(off_n)))
        if not forced and abs(off_n[worst]) > self._limit_n:
            raise TareError(
                f"cable_{worst + 1} lies {off_n[worst]:+.1f} N from the arm file's unloaded "
                f"tension at this command (at most {self._limit_n:g} N, tare_deviation_n): take "
                "loads away, and send the command that the arm is at; or set tare_force"
            )
        return Tare(unloaded, False, off_n), off_n

    def status(self) -> Status:
        """Whether there is a tare, and since when."""
        since = utc_text(self.tares[-1].unloaded.taken_ns) if self.tares else ""
        return self._tare_status(f"tared since {since}", {})


def tare_undone_line(
    undone: Tare, earlier: Tare | None, cable_names: Sequence[str], undoable: int
) -> str:
    """Log line of an undo: the undone tare, the one in force, and how many `undoable` remain."""
    line = f"tare of {utc_text(undone.unloaded.taken_ns)} undone; "
    if earlier is None:
        return line + "there is none now"
    described = earlier.described(cable_names)
    return f"{line}again in force is the one {described}; {undoable} left to undo"
