"""The unloaded state: tensions with nothing touching, carried over to other commands by a model.

A tare is taken at one command. Elsewhere the unloaded tensions are

    unloaded(c) = measured(c_tare) + [ predicted(c) - predicted(c_tare) ]

with the prediction of the arm file's static equilibrium: what the sensors read beyond the model
(offsets) stays, what gravity and geometry change is added.

Readings of a loaded arm, or of one that is not where it was commanded, would be subtracted from
all that come after. So none are taken that lie far from the model at the command, nor soon after a
reported contact, unless that is forced; and a tare that was taken by itself before any command
rests on an assumed pose, so that it is dropped by a first command to another one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import Equilibrium, held_lengths_m, solve_equilibrium

MOST_TARES_KEPT = 16
"""How many times a tare can be undone."""
_LINEAR_RAD, _DIFFERENCE_RAD = 0.02, 1e-3
"""How far a joint turns while unloaded tensions are taken as linear, and the step of their numeric
derivative."""
_ONE_POSE_RAD = 1e-3
"""Readings of a tare are of poses within this of the first."""


_INCOMPLETE = "the arm file lists effects of actuators, friction or sensors"


class UnloadedTensions:
    """The static equilibrium of an arm that is commanded as if its effects were unknown.

    Attributes:
        mechanism: the arm with what its effects change of it.
        incomplete: why they may not be those of the arm at rest by themselves; empty where they
            are.
    """

    def __init__(self, arm: Arm) -> None:
        self._nominal, entries = mechanism_of(arm), entries_of(arm)
        self.mechanism = amended(self._nominal, entries)
        causes = [[entry for entry in entries if not entry.effect.tolerance]]
        past = actuations(causes) or transmissions(causes) or sensings(causes)
        self.incomplete = _INCOMPLETE if past else ""

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


def utc_text(time_ns: int) -> str:
    """A time since the epoch to the second, as diagnostics have it."""
    return f"{datetime.fromtimestamp(time_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S UTC}"


class TareError(CableSenseError):
    """No tare can be taken or undone now; the message states why, and what to do."""


@dataclass(frozen=True)
class Tare:
    """Tensions of the unloaded arm.

    Attributes:
        measured_n: (M,) average of the readings.
        predicted_n: (M,) by the arm's model at the same command.
        command_rad: (2N,) that command.
        sample_count: how many readings were averaged; 0 where that is not known any more.
        taken_ns: when it was taken, ns since the epoch; 0 as well.
    """

    measured_n: Array
    predicted_n: Array
    command_rad: Array
    sample_count: int
    taken_ns: int

    @property
    def offset_n(self) -> float:
        """Largest deviation of a cable from the model, N."""
        return float(np.abs(self.measured_n - self.predicted_n).max())

    @property
    def since(self) -> str:
        """When it was taken, as text."""
        return utc_text(self.taken_ns) if self.taken_ns else "before the estimator's start"

    def unloaded_n(self, predicted_n: Array) -> Array:
        """(M,) unloaded tensions where the arm's model predicts `predicted_n`."""
        return self.measured_n + (predicted_n - self.predicted_n)

    def described(self, cable_names: Sequence[str]) -> str:
        """Time and values, as text for a log; `cable_names` (M,)."""
        off_n = self.measured_n - self.predicted_n
        rows = zip(cable_names, self.measured_n, off_n, strict=True)
        cables = ", ".join(f"{name} {tension:.2f} ({off:+.2f})" for name, tension, off in rows)
        return (
            f"at {self.since}: average of {self.sample_count} readings, at most "
            f"{self.offset_n:.2f} N from the arm file's unloaded tensions; in N, with the "
            f"deviation: {cables}"
        )


class Tares:
    """Takes tares from the latest readings, and carries the present one over to commands.

    Attributes:
        present: the tare in use.
        automatic: whether one is to be taken as soon as `ready`.
        unloaded_n: (M,) unloaded tensions at the present command; none before the first tare.
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

        `predict_n` gives the unloaded tensions (M,) of the arm's model at a command (2N,). A tare
        averages `sample_count` readings, with a standard deviation of each cable's, N, of
        `steady_n` at most, and an average within `deviation_n` of the model's where that is
        `complete`.

        Raises:
            CableSenseError: the model has no unloaded state at this command.
        """
        self._predict_n = predict_n
        self._predicted_n = predict_n(command_rad)
        self._steady_n, self._sample_count = steady_n, sample_count
        self._deviation_n, self._complete = deviation_n, complete
        self.automatic = automatic
        self._by_itself: Tare | None = None
        self._contact: Contact | None = None
        self._since_contact = 0
        self._readings: deque[Sequence[float]] = deque(maxlen=sample_count)
        self._readings_at_rad = command_rad
        self._near: tuple[Array, Array, Array] | None = None
        self._earlier: deque[Tare] = deque(maxlen=MOST_TARES_KEPT - 1)
        self.present: Tare | None = None
        self.unloaded_n: Array | None = None

    @property
    def undoable(self) -> int:
        """How many times `undo` can be called."""
        return len(self._earlier) + (self.present is not None)

    @property
    def taken_by_itself(self) -> bool:
        """Whether the tare in use was."""
        return self.present is not None and self.present is self._by_itself

    def command(self, command_rad: Array, *, first: bool = False) -> bool:
        """The arm goes to another command (2N,): readings begin anew, the tare is carried over.

        The `first` drops a tare that was taken by itself before, where the model's tensions change
        by more than a tare may be wrong by; gives whether it was in use. Another is then taken.

        Raises:
            CableSenseError: the model has no unloaded state at this command; nothing has changed.
        """
        before_n, self._predicted_n = self._predicted_n, self._predict_n(command_rad)
        self._near = None
        self._readings.clear()
        present, dropped = self.present, self._by_itself
        if first and np.abs(self._predicted_n - before_n).max() > self._deviation_n:
            kept = [tare for tare in self._earlier if tare is not dropped]
            self._earlier = deque(kept, maxlen=self._earlier.maxlen)
            if self.taken_by_itself:
                present, self.automatic = None, True
        lost = present is not self.present
        self._use(present)
        return lost

    def follow(self, angles_rad: Array) -> None:
        """The arm is at angles (2N,) on its way: the tare is carried over there.

        The model's tensions are linear between angles at which they are predicted.

        Raises:
            CableSenseError: the model has no unloaded state there.
        """
        if self._near is None or np.abs(angles_rad - self._near[0]).max() > _LINEAR_RAD:
            self._linearise(angles_rad)
        assert self._near is not None
        at_rad, there_n, by_angle = self._near
        self._predicted_n = there_n + by_angle @ (angles_rad - at_rad)
        if np.abs(angles_rad - self._readings_at_rad).max() > _ONE_POSE_RAD:
            self._readings.clear()
        if not self._readings:
            self._readings_at_rad = angles_rad
        self._use(self.present)

    @property
    def linear_at_rad(self) -> Array | None:
        """(2N,) where the model's tensions were predicted that are taken as linear; or none."""
        return None if self._near is None else self._near[0]

    def _linearise(self, at_rad: Array) -> None:
        step = _DIFFERENCE_RAD * np.eye(len(at_rad))
        predicted_n = self._predict_n(at_rad + np.vstack([np.zeros_like(at_rad), step, -step]))
        more, less = np.split(predicted_n[1:], 2)
        self._near = (at_rad, predicted_n[0], (more - less).T / (2.0 * _DIFFERENCE_RAD))

    def forget_readings(self) -> None:
        """Readings before this moment do not belong to the next tare."""
        self._readings.clear()

    def add(self, reading_n: Sequence[float]) -> None:
        """A reading (M,) in N at the present angles, with the arm at rest."""
        self._readings.append(reading_n)
        self._since_contact += 1

    def touched(self, contact: Contact) -> None:
        """A contact was estimated from the last reading."""
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

        At the present angles (2N,), `now_ns` since the epoch. `forced` takes steady readings
        whatever they are.

        Raises:
            TareError: too few readings yet, they do not hold still, or the arm seems to be loaded
                or elsewhere.
        """
        obstacle = self._obstacle() or ("" if forced else self._objection())
        if obstacle:
            raise TareError(obstacle)
        measured_n = np.mean(self._readings, axis=0)
        if self.present is not None:
            self._earlier.append(self.present)
        predicted_n = self._predicted_n if self._near is None else self._predict_n(command_rad)
        tare = Tare(measured_n, predicted_n, command_rad, self._sample_count, now_ns)
        self._by_itself = tare if by_itself else self._by_itself
        self.automatic = False
        self._use(tare)
        return tare

    def undo(self) -> Tare | None:
        """Go back to the tare before the last and give it; none when the last was the first.

        Raises:
            TareError: there is nothing to undo.
        """
        if self.present is None:
            raise TareError("no tare has been taken, so there is nothing to undo")
        self._use(self._earlier.pop() if self._earlier else None)
        return self.present

    def restore(
        self,
        command_rad: Array,
        unloaded_n: Array | None,
        tared_n: Array,
        tare_command_rad: Array,
        *,
        by_itself: bool,
        linear_at_rad: Array | None = None,
    ) -> None:
        """Be at a command (2N,) with the tare `tared_n` (M,) of another; readings begin anew.

        `unloaded_n` (M,) at this command is none where this arm's model is to predict it;
        `tared_n` is empty without a tare.

        Raises:
            CableSenseError: the model has no unloaded state at one of the commands.
        """
        self._earlier.clear()
        self.present = self._by_itself = self._contact = None
        self.automatic = False
        self.command(command_rad)
        if tared_n.size:
            predicted_n = self._predict_n(tare_command_rad)
            tare = Tare(tared_n, predicted_n, tare_command_rad, 0, 0)
            self._by_itself = tare if by_itself else None
            self._use(tare)
            if unloaded_n is not None:
                self.unloaded_n = unloaded_n
        if linear_at_rad is not None:
            self._linearise(linear_at_rad)

    def status(self) -> Status:
        """Whether there is a tare, since when, and how far it lies from the arm's model."""
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
        self.present = tare
        self.unloaded_n = None if tare is None else tare.unloaded_n(self._predicted_n)

    def _objection(self) -> str:
        """Why the last readings are not those of an unloaded arm; empty where they may be."""
        contact = self._contact
        if contact is not None and self._since_contact < self._sample_count:
            return (
                f"a contact of {contact.magnitude_n:.1f} N on segment {contact.segment} is "
                "reported, or was among these readings; take it away and call again. If nothing "
                "touches the arm, the present tare is wrong: call ~/tare_undo, or set tare_force"
            )
        off_n = np.mean(self._readings, axis=0) - self._predicted_n
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
    """Log line of an undo: which tare is gone, which is in force; `undoable` are left."""
    line = f"tare of {undone.since} undone; "
    if earlier is None:
        return line + "there is none now, so no estimate"
    described = earlier.described(cable_names)
    return f"{line}again in force is the one {described}; {undoable} left to undo"
