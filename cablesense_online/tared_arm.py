"""An arm whose model takes tension differences: one tare, carried to poses by the arm file."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_contact.felt_arm import FeltArm
from cablesense_online.settings import EstimationSettings
from cablesense_online.tare import (
    MOST_UNDOABLE,
    Tare,
    TareError,
    UnloadedState,
    is_same_pose,
    unloaded_reading,
)
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium

_Tare: TypeAlias = "Tare | None"


@dataclass(frozen=True)
class TaredState(UnloadedState[_Tare]):
    """The tare in force, as `known_by`, and what the arm file predicts.

    Attributes:
        predicted_n: (M,) at the present pose; None before it is asked for.
        at_tare_n: (M,) at the pose of the tare; None before a tare.
    """

    predicted_n: Array | None = None
    at_tare_n: Array | None = None


class TaredArm:
    """The unloaded state of an arm with a network; an `UnloadedArm`."""

    def __init__(self, arm: Arm, settings: EstimationSettings) -> None:
        self._settings = settings
        self._channels = FeltArm(arm).channels
        self._nominal = mechanism_of(arm)
        self._mechanism = amended(self._nominal, entries_of(arm))
        self._limit_n = settings.tare_deviation_n or math.inf

    def begin(self, calibration: Calibration | None = None) -> TaredState:
        """Nothing is known yet.

        Raises:
            TareError: a calibration is given.
        """
        if calibration is not None:
            raise TareError("the model is a network, which takes no calibration")
        return TaredState(known_by=None, loaded=False, automatic=self._settings.auto_tare)

    def at(self, state: TaredState, pose_rad: Array) -> TaredState:
        """Readings are from now on of this pose (2N,)."""
        if is_same_pose(state, pose_rad):
            return state
        return replace(state, readings=(), pose_rad=pose_rad, predicted_n=None)

    def predicted(self, state: TaredState) -> TaredState:
        """With what the arm file predicts at the present pose.

        Raises:
            EquilibriumError: the arm has no rest there.
        """
        if state.predicted_n is not None or state.pose_rad is None:
            return state
        return replace(state, predicted_n=self._unloaded_n(state.pose_rad))

    def unloaded_n(self, state: TaredState) -> Array | None:
        """(M,) readings of the untouched arm at the present pose, as predicted.

        None before a tare.
        """
        tare = state.known_by
        if tare is None or state.predicted_n is None or state.at_tare_n is None:
            return None
        return np.asarray(tare.unloaded.reading_n + state.predicted_n - state.at_tare_n)

    def taken(
        self, state: TaredState, now_ns: int, *, by_itself: bool = False, forced: bool = False
    ) -> TaredState:
        """With the average of the last readings as the tare that is carried to other poses.

        `now_ns` is the time since the epoch. `forced` takes any steady readings.

        Raises:
            TareError: too few readings, unsteady ones, or, unless `forced`, ones that lie too far
                from the arm file's.
        """
        unloaded = unloaded_reading(state, self._settings, self._channels, now_ns)
        state = self.predicted(state)
        assert state.predicted_n is not None
        off_n = unloaded.reading_n - state.predicted_n
        worst = int(np.argmax(np.abs(off_n)))
        if not forced and abs(off_n[worst]) > self._limit_n:
            raise TareError(
                f"cable_{worst + 1} lies {off_n[worst]:+.1f} N from the arm file's unloaded "
                f"tension at this command (at most {self._limit_n:g} N, tare_deviation_n): take "
                "loads away, and send the command that the arm is at; or set tare_force"
            )
        tare = Tare(unloaded, by_itself, off_n)
        return replace(
            state,
            known_by=tare,
            automatic=False,
            tares=(*state.tares, tare),
            earlier=(*state.earlier, state.known_by)[-MOST_UNDOABLE:],
            at_tare_n=state.predicted_n,
        )

    def undone(self, state: TaredState) -> TaredState:
        """The state before the last tare.

        Raises:
            TareError: there is nothing to undo.
        """
        if not state.earlier:
            raise TareError("no tare has been taken, so there is nothing to undo")
        tare = state.earlier[-1]
        at_tare_n = None if tare is None else self._unloaded_n(tare.unloaded.command_rad)
        return replace(
            state,
            known_by=tare,
            tares=state.tares[:-1],
            earlier=state.earlier[:-1],
            at_tare_n=at_tare_n,
        )

    def _unloaded_n(self, pose_rad: Array) -> Array:
        """(M,) tensions of the untouched arm at a pose (2N,), by the arm file."""
        held_m = held_lengths_m(self._nominal, pose_rad)
        return solve_equilibrium(self._mechanism, pose_rad, held_m=held_m).tensions_n
