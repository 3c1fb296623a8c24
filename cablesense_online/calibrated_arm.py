"""An arm with a law: tares update its calibration, and readings tell where cables slide.

A cable whose reading has changed since the untouched arm rested at this pose has slid at its
guides, in the direction of the change; what friction adds to its tension is then known but for the
coefficient. One that has not moved may carry anything that friction holds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_contact.cable_slides import LastWay
from cablesense_contact.calibration import Calibration, CalibrationError, Calibrator, Unloaded
from cablesense_contact.felt import FeltMachine, SlidesUnderLoad, torque_covariance_at_rest
from cablesense_contact.judgement import Judge
from cablesense_contact.law import Law
from cablesense_contact.slides import Belief, Slides
from cablesense_online.settings import EstimationSettings
from cablesense_online.tare import (
    MOST_UNDOABLE,
    Tare,
    TareError,
    UnloadedState,
    is_same_pose,
    unloaded_reading,
)

_AGED_EVERY_NS = 30_000_000_000
"""How often the drift of the sensors' zeros is added to what is known."""
_FEWEST_UNTOUCHED = 5
"""Readings of the untouched arm at this pose before a cable can be said to have moved since."""


@dataclass(frozen=True)
class Untouched:
    """Readings of the arm that nothing touches, at the present pose.

    Attributes:
        mean_n: (M,) of the latest.
        count: how many there were.
    """

    mean_n: Array
    count: int = 0


class _Remembered(NamedTuple):
    """A belief, with what it depends on beside calibration and pose."""

    slides: object
    aged_ns: int
    belief: Belief


@dataclass(frozen=True)
class CalibratedState(UnloadedState[Calibration]):
    """The calibration in force, as `known_by`, and what has moved the cables.

    Attributes:
        way: how the arm came to the present command, which says where its cables have slid.
        untouched: readings at the present pose.
        under_load: what readings since have said of slides; None before they count.
        remembered: the belief at the last sample, which is mostly that of the next.
    """

    way: LastWay = field(default_factory=LastWay)
    untouched: Untouched | None = None
    under_load: SlidesUnderLoad | None = None
    remembered: _Remembered | None = None

    @property
    def calibration(self) -> Calibration:
        """The calibration in force."""
        return self.known_by

    @property
    def untouched_count(self) -> int:
        """How many readings of the untouched arm there are at the present pose."""
        return 0 if self.untouched is None else self.untouched.count

    @property
    def touched(self) -> CalibratedState:
        """The same after something has moved cables over their guides, at the present pose."""
        return replace(self, way=self.way.forgotten)


class _Update(NamedTuple):
    """A calibration after a tare, and by how much its observations were unexpected (`Tare`)."""

    calibration: Calibration
    misfit: Array


class CalibratedArm:
    """The unloaded state of a machine with a law; an `UnloadedArm`."""

    def __init__(self, machine: FeltMachine, law: Law, settings: EstimationSettings) -> None:
        self.calibrator = Calibrator(machine, law)
        self._law = law
        self._settings = settings
        self._channels = machine.channels
        self._judge = Judge(machine)
        self._slides = machine.slides
        self._covariance_at_rest = torque_covariance_at_rest(machine)

    def begin(self, calibration: Calibration | None = None) -> CalibratedState:
        """The arm as well known as a calibration says, or as its tolerances."""
        return CalibratedState(
            known_by=calibration or self.calibrator.by_tolerances(),
            loaded=calibration is not None,
            automatic=self._settings.auto_tare and calibration is None,
        )

    def at(self, state: CalibratedState, pose_rad: Array) -> CalibratedState:
        """Readings are from now on of this pose (2N,)."""
        if is_same_pose(state, pose_rad):
            return state
        return replace(
            state,
            readings=(),
            pose_rad=pose_rad,
            way=state.way.to(pose_rad),
            untouched=None,
            under_load=None,
            remembered=None,
        )

    def taken(
        self, state: CalibratedState, now_ns: int, *, by_itself: bool = False, forced: bool = False
    ) -> CalibratedState:
        """With the average of the last readings as a tare, by which the calibration is updated.

        `now_ns` is the time since the epoch. `forced` takes any steady readings.

        Raises:
            TareError: too few readings, unsteady ones, or, unless `forced`, ones that are not
                those of the untouched arm.
        """
        unloaded = unloaded_reading(
            state, self._settings, self._channels, now_ns, state.way.came_from_rad
        )
        update = self._updated(state.calibration, unloaded, forced=forced)
        tare = Tare(unloaded, by_itself, update.misfit)
        return replace(
            self._with_calibration(state, update.calibration),
            automatic=False,
            tares=(*state.tares, tare),
            earlier=(*state.earlier, state.calibration)[-MOST_UNDOABLE:],
        )

    def undone(self, state: CalibratedState) -> CalibratedState:
        """The state before the last tare, or the last calibration that was loaded.

        Raises:
            TareError: there is nothing to undo.
        """
        if not state.earlier:
            raise TareError("no tare has been taken, so there is nothing to undo")
        return replace(
            self._with_calibration(state, state.earlier[-1]),
            tares=state.tares[:-1],
            earlier=state.earlier[:-1],
        )

    def loaded(self, state: CalibratedState, calibration: Calibration) -> CalibratedState:
        """With another calibration; earlier tares count no more."""
        return replace(
            self._with_calibration(state, calibration),
            loaded=True,
            automatic=False,
            tares=(),
            earlier=(*state.earlier, state.calibration)[-MOST_UNDOABLE:],
        )

    def restored(
        self, state: CalibratedState, calibration: Calibration, *, known: bool
    ) -> CalibratedState:
        """With the calibration of another estimator, as far as its state was known."""
        return replace(
            self._with_calibration(state, calibration),
            loaded=known,
            automatic=False,
            tares=(),
            earlier=(),
        )

    def belief(
        self,
        state: CalibratedState,
        reading_n: Array,
        now_ns: int,
        *,
        freed: bool = False,
        touched: bool = False,
    ) -> tuple[CalibratedState, Belief]:
        """What is known at readings (M,) at a time since the epoch.

        Args:
            state: readings are given one after the other, as loads change.
            reading_n: the readings.
            now_ns: the time.
            freed: whether a breath has taken friction out of the readings.
            touched: whether the arm is touched though it was not yet seen untouched here.
        """
        if freed:
            return self._carried(state, "freed", self._slides.freed, now_ns)
        if not self._rubs(state):
            return self._carried(state, "unknown", self._slides.unknown, now_ns)
        if state.untouched_count >= _FEWEST_UNTOUCHED:
            under_load = (state.under_load or self._from_untouched(state)).after(reading_n)
            state = replace(state, under_load=under_load)
            key, slides = self._slides.rounded(under_load.slides)
            return self._carried(state, key, slides, now_ns)
        if touched:
            return self._carried(state, "touched", self._slides.unknown, now_ns)
        return self._carried(state, "came", self._arrived(state), now_ns)

    def seen_untouched(self, state: CalibratedState) -> bool:
        """Whether the arm was seen untouched at this pose, or nothing depends on it."""
        return state.untouched_count >= _FEWEST_UNTOUCHED or not self._rubs(state)

    def with_untouched(self, state: CalibratedState, reading_n: Array) -> CalibratedState:
        """With a reading (M,) of the arm that nothing touches, at the present pose."""
        earlier = state.untouched or Untouched(np.zeros_like(reading_n))
        weight = 1.0 / min(earlier.count + 1, self._settings.tare_samples)
        mean_n = earlier.mean_n + weight * (reading_n - earlier.mean_n)
        return replace(state, untouched=Untouched(mean_n, earlier.count + 1))

    def _with_calibration(
        self, state: CalibratedState, calibration: Calibration
    ) -> CalibratedState:
        same = np.array_equal(calibration.mean, state.calibration.mean)
        under_load = state.under_load if same else None
        return replace(state, known_by=calibration, under_load=under_load, remembered=None)

    def _rubs(self, state: CalibratedState) -> bool:
        """Whether friction can be seen."""
        calibration = state.calibration
        return self._slides.matter(Belief(calibration.mean, calibration.covariance))

    def _arrived(self, state: CalibratedState) -> Slides:
        """Slides of the unloaded arm as it came to the present pose."""
        came_from_rad = state.way.came_from_rad
        if came_from_rad is None or state.pose_rad is None:
            return self._slides.unknown
        return self._slides.after_motion(came_from_rad, state.pose_rad)

    def _from_untouched(self, state: CalibratedState) -> SlidesUnderLoad:
        """The slides of the untouched arm, which readings under a load change."""
        assert state.pose_rad is not None
        assert state.untouched is not None
        calibration = state.calibration
        known = Belief(calibration.mean, calibration.covariance)
        return self._slides.under_load(
            state.pose_rad, state.untouched.mean_n, known, self._arrived(state)
        )

    def _carried(
        self, state: CalibratedState, key: object, slides: Slides, now_ns: int
    ) -> tuple[CalibratedState, Belief]:
        """What is known with these slides, which have a key among all that may be at a pose."""
        # whole steps since the last unloaded reading, which follow from sample and state alone
        passed_ns = now_ns - state.calibration.last_unloaded_ns
        aged_ns = now_ns - passed_ns % _AGED_EVERY_NS
        remembered = state.remembered
        if remembered is not None and (remembered.slides, remembered.aged_ns) == (key, aged_ns):
            return state, remembered.belief
        calibration = self.calibrator.aged(state.calibration, aged_ns)
        known = Belief(calibration.mean, calibration.covariance)
        belief = self._slides.carried(known, slides)
        return replace(state, remembered=_Remembered(key, aged_ns, belief)), belief

    def _updated(self, calibration: Calibration, unloaded: Unloaded, *, forced: bool) -> _Update:
        """The calibration with a tare."""
        present = self.calibrator.moved(calibration)
        seen = self._law(
            unloaded.reading_n[None],
            unloaded.command_rad[None],
            present.mean,
            present.covariance,
            self._covariance_at_rest,
        )
        try:
            updated = self.calibrator.updated(calibration, unloaded, force=forced)
        except CalibrationError as error:
            doubt = self._judge(seen, unloaded.reading_n).doubt
            what = f" It may be that {doubt}." if doubt else ""
            raise TareError(f"{error}.{what} Set tare_force to take it nevertheless") from error
        return _Update(updated, seen.innovation_n[0])
