"""The unloaded state: tensions with nothing touching, carried over to other commands by a model.

A tare is taken at one command. Elsewhere the unloaded tensions are

    unloaded(c) = measured(c_tare) + [ predicted(c) - predicted(c_tare) ]

with the prediction of the arm file's static equilibrium: the sensors' offsets from the model stay,
and the changes due to gravity and geometry are added.

A tare of a loaded arm, or of one that is not where it was commanded, would falsify all later
estimates. Therefore no tare is taken from readings far from the model at the command, nor soon
after a reported contact, unless it is forced. A tare that was taken by itself before any command
rests on an assumed pose; a first command to another pose drops it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.state import Tare, TareState
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import Equilibrium, held_lengths_m, solve_equilibrium

MOST_TARES_KEPT = 16
"""How many times a tare can be undone."""
_LINEAR_RAD = 0.02
"""Unloaded tensions are taken as linear while a joint turns by this."""
_DIFFERENCE_RAD = 1e-3
"""Step of their numeric derivative."""
_ONE_POSE_RAD = 1e-3
"""Readings of a tare are of poses within this of the first."""


class UnloadedTensions:
    """The static equilibrium of an arm that is commanded as if its effects were unknown.

    Attributes:
        mechanism: the arm, amended by its effects.
        incomplete: why these tensions may not be those of the arm at rest; empty where they are.
    """

    def __init__(self, arm: Arm) -> None:
        self._nominal, entries = mechanism_of(arm), entries_of(arm)
        self.mechanism = amended(self._nominal, entries)
        causes = [[entry for entry in entries if not entry.effect.tolerance]]
        past = actuations(causes) or transmissions(causes) or sensings(causes)
        self.incomplete = (
            "the arm file lists effects of actuators, friction or sensors" if past else ""
        )

    def predict_n(self, command_rad: Array) -> Array:
        """Tensions (M,) at rest at a command (2N,).

        Raises:
            CableSenseError: the arm has no rest at this command.
        """
        return self.at_rest(command_rad).tensions_n

    def at_rest(self, command_rad: Array, forces_n: Array | None = None) -> Equilibrium:
        """Pose and tensions at a command (2N,) under forces (N, 3) in base axes.

        Raises:
            EquilibriumError: the arm has no rest there.
        """
        held = self.held_m(command_rad)
        return solve_equilibrium(self.mechanism, command_rad, forces_n, held_m=held)

    def held_m(self, command_rad: Array) -> Array:
        """Cable lengths (M,) that are held at a command (2N,), relative to the straight arm."""
        return held_lengths_m(self._nominal, command_rad)


class TareError(CableSenseError):
    """No tare can be taken or undone now; the message states why, and what to do."""


class Tares:
    """Takes tares from the latest readings, and carries the present one over to commands.

    Attributes:
        state: the tare in use, at the present angles.
        automatic: whether one is to be taken as soon as `ready`.
        unloaded_n: (M,) unloaded tensions at the present angles; None before the first tare.
    """

    def __init__(
        self,
        predict_n: Callable[[Array], Array],
        command_rad: Array,
        sample_count: int,
        steady_n: float,
        deviation_n: float = math.inf,
        *,
        complete: bool = True,
        automatic: bool = False,
    ) -> None:
        """Without a tare, at `command_rad` (2N,).

        Args:
            predict_n: the arm file's unloaded tensions (M,) at a command (2N,).
            command_rad: (2N,) where the arm is.
            sample_count: number of readings that a tare averages.
            steady_n: largest standard deviation of a cable's readings, N.
            deviation_n: largest deviation of their mean from the prediction, N.
            complete: whether that prediction is one of the arm at rest, so that it may judge.
            automatic: whether a tare is to be taken as soon as `ready`.

        Raises:
            CableSenseError: the arm has no unloaded state at this command.
        """
        self._predict_n = predict_n
        self._steady_n, self._sample_count = steady_n, sample_count
        self._deviation_n, self._complete = deviation_n, complete
        self.automatic = automatic
        self._contact: Contact | None = None
        self._since_contact = 0
        self._readings: deque[Sequence[float]] = deque(maxlen=sample_count)
        self._readings_at_rad = command_rad
        self._near: tuple[Array, Array, Array] | None = None
        self._earlier: deque[Tare] = deque(maxlen=MOST_TARES_KEPT - 1)
        self.state = TareState(predicted_n=predict_n(command_rad))
        self.unloaded_n: Array | None = None

    @property
    def present(self) -> Tare | None:
        """The tare in use."""
        return self.state.tare

    @property
    def undoable(self) -> int:
        """How many times `undo` can be called."""
        return len(self._earlier) + (self.present is not None)

    def command(self, command_rad: Array, *, first: bool = False) -> bool:
        """Go to another command (2N,): readings begin anew, the tare is carried over.

        The `first` command drops a tare that was taken by itself before, if the predicted tensions
        change by more than the allowed deviation. Gives whether the dropped tare was in use;
        another is then taken automatically.

        Raises:
            CableSenseError: the arm has no unloaded state at this command; nothing has changed.
        """
        before_n, predicted_n = self.state.predicted_n, self._predict_n(command_rad)
        self.state.predicted_n = predicted_n
        self._linearise(None)
        self._readings.clear()
        tare, dropped = self.present, False
        if first and np.abs(predicted_n - before_n).max() > self._deviation_n:
            kept = [earlier for earlier in self._earlier if not earlier.by_itself]
            self._earlier = deque(kept, maxlen=self._earlier.maxlen)
            dropped = tare is not None and tare.by_itself
            self.automatic |= dropped
        self._use(None if dropped else tare)
        return dropped

    def follow(self, angles_rad: Array) -> None:
        """Carry the tare over to angles (2N,) on the way of a followed motion.

        Predicted tensions are linear between the angles at which they are solved.

        Raises:
            CableSenseError: the arm has no unloaded state there.
        """
        if self._near is None or np.abs(angles_rad - self._near[0]).max() > _LINEAR_RAD:
            self._linearise(angles_rad)
        assert self._near is not None
        at_rad, there_n, by_angle = self._near
        self.state.predicted_n = there_n + by_angle @ (angles_rad - at_rad)
        if np.abs(angles_rad - self._readings_at_rad).max() > _ONE_POSE_RAD:
            self._readings.clear()
        if not self._readings:
            self._readings_at_rad = angles_rad
        self._use(self.present)

    @property
    def linear(self) -> bool:
        """Whether predicted tensions are linearised, on the way of a followed motion."""
        return self._near is not None

    def forget_readings(self) -> None:
        """Exclude all earlier readings from the next tare."""
        self._readings.clear()

    def add(self, reading_n: Sequence[float]) -> None:
        """Add a reading (M,) in N at the present angles, with the arm at rest."""
        self._readings.append(reading_n)
        self._since_contact += 1

    def touched(self, contact: Contact) -> None:
        """Note that a contact was estimated from the last reading."""
        self._contact, self._since_contact = contact, 0

    @property
    def ready(self) -> bool:
        """Whether the last readings can be those of the unloaded arm."""
        return not (self._obstacle() or self._objection())

    @property
    def awaited(self) -> str:
        """Why the automatic tare is not taken though readings are there; else empty."""
        if not self.automatic or len(self._readings) < self._sample_count:
            return ""
        return self._obstacle() or self._objection()

    def take(
        self, command_rad: Array, now_ns: int, *, by_itself: bool = False, forced: bool = False
    ) -> Tare:
        """Take the average of the last readings as the unloaded state.

        `command_rad` (2N,) are the present angles, `now_ns` is the time since the epoch. `forced`
        takes any steady readings.

        Raises:
            TareError: too few readings yet, they are not steady, or the arm seems to be loaded or
                elsewhere.
        """
        obstacle = self._obstacle() or ("" if forced else self._objection())
        if obstacle:
            raise TareError(obstacle)
        if self.present is not None:
            self._earlier.append(self.present)
        tare = Tare(
            measured_n=np.mean(self._readings, axis=0),
            predicted_n=self._predict_n(command_rad) if self.linear else self.state.predicted_n,
            command_rad=command_rad,
            sample_count=self._sample_count,
            taken_ns=now_ns,
            by_itself=by_itself,
        )
        self.automatic = False
        self._use(tare)
        return tare

    def undo(self) -> Tare | None:
        """Return to the previous tare and give it; None when the last was the first.

        Raises:
            TareError: there is nothing to undo.
        """
        if self.present is None:
            raise TareError("no tare has been taken, so there is nothing to undo")
        self._use(self._earlier.pop() if self._earlier else None)
        return self.present

    def restore(self, state: TareState, angles_rad: Array, *, same_arm: bool) -> None:
        """Continue from a state at angles (2N,); readings begin anew.

        A state of another arm keeps its measured tensions and gets this arm's predictions.

        Raises:
            CableSenseError: this arm has no unloaded state at these angles or at the tare's.
        """
        state = state.model_copy()
        if not same_arm:
            state.predicted_n = self._predict_n(angles_rad)
            if state.tare is not None:
                predicted = {"predicted_n": self._predict_n(state.tare.command_rad)}
                state.tare = state.tare.model_copy(update=predicted)
        self._earlier.clear()
        self._readings.clear()
        self._contact, self.automatic = None, False
        self.state = state
        self._linearise(state.linear_at_rad if state.linear_at_rad.size else None)
        self._use(state.tare)

    def status(self) -> Status:
        """Whether there is a tare, since when, and how far it is from the arm file."""
        tare = self.present
        if tare is None:
            message = "call ~/tare with the arm unloaded"
            if self.automatic:
                message = f"auto_tare waits: {self.awaited or 'too few readings at rest yet'}"
            return Status("tare", Level.WARN, f"none taken: no estimate; {message}")
        values = {
            "tared since": tare.since,
            "readings averaged": str(tare.sample_count),
            "largest deviation from the arm file (N)": f"{tare.offset_n:.2f}",
            "unloaded tensions (N)": ", ".join(f"{tension:.2f}" for tension in tare.measured_n),
            "tares that can be undone": str(self.undoable),
        }
        level, message = Level.OK, f"tared since {tare.since}"
        if self._complete and tare.offset_n > self._deviation_n:
            level, message = Level.WARN, f"{message}, {tare.offset_n:.1f} N from the arm file"
        return Status("tare", level, message, values)

    def _use(self, tare: Tare | None) -> None:
        self.state.tare = tare
        self.unloaded_n = None if tare is None else tare.unloaded_n(self.state.predicted_n)

    def _linearise(self, at_rad: Array | None) -> None:
        """Linearise predicted tensions about angles (2N,), or take them as solved."""
        if at_rad is None:
            self._near, self.state.linear_at_rad = None, np.zeros(0)
            return
        step = _DIFFERENCE_RAD * np.eye(len(at_rad))
        predicted_n = self._predict_n(at_rad + np.vstack([np.zeros_like(at_rad), step, -step]))
        more, less = np.split(predicted_n[1:], 2)
        self._near = (at_rad, predicted_n[0], (more - less).T / (2.0 * _DIFFERENCE_RAD))
        self.state.linear_at_rad = at_rad

    def _objection(self) -> str:
        """Why the last readings are not those of an unloaded arm; empty where they may be."""
        contact = self._contact
        if contact is not None and self._since_contact < self._sample_count:
            return (
                f"a contact of {contact.magnitude_n:.1f} N on segment {contact.segment} is "
                "reported, or was among these readings; take it away and call again. If nothing "
                "touches the arm, the present tare is wrong: call ~/tare_undo, or set tare_force"
            )
        off_n = np.mean(self._readings, axis=0) - self.state.predicted_n
        worst = int(np.argmax(np.abs(off_n)))
        if not self._complete or abs(off_n[worst]) <= self._deviation_n:
            return ""
        return (
            f"cable_{worst + 1} lies {off_n[worst]:+.1f} N from the arm file's unloaded tension "
            f"at the last command, straight before the first (at most {self._deviation_n:g} N, "
            "tare_deviation_n): take loads away, and send the command that the arm is at. If it "
            "is unloaded and there, its arm file or sensors are off: set tare_force to take it"
        )

    def _obstacle(self) -> str:
        """Why there is nothing to average now; empty where there is."""
        if len(self._readings) < self._sample_count:
            return (
                f"only {len(self._readings)} of {self._sample_count} usable readings at this pose "
                "yet; wait a moment with the arm at rest and call again"
            )
        spread = np.std(self._readings, axis=0)
        worst = int(np.argmax(spread))
        if spread[worst] <= self._steady_n:
            return ""
        return (
            f"cable_{worst + 1} varies by {spread[worst]:.2f} N (standard deviation; at most "
            f"{self._steady_n:g} N); let the arm rest with nothing touching it and call again"
        )


def tare_undone_line(
    undone: Tare, earlier: Tare | None, cable_names: Sequence[str], undoable: int
) -> str:
    """Log line of an undo: the undone tare, the one in force, and how many `undoable` remain."""
    line = f"tare of {undone.since} undone; "
    if earlier is None:
        return line + "there is none now, so no estimate"
    described = earlier.described(cable_names)
    return f"{line}again in force is the one {described}; {undoable} left to undo"
