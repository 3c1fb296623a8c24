"""The unloaded state: measured with nothing touching, carried to other commands, and its drift.

A tare is taken at one command. Elsewhere the unloaded tensions are

    unloaded(c) = measured(c_tare) + [ predicted(c) - predicted(c_tare) ]

with the prediction of the arm file's static equilibrium: the sensors' offsets from the model stay,
and the changes due to gravity and geometry are added.

A tare of a loaded arm, or of one elsewhere than commanded, would falsify all later estimates.
Therefore none is taken from readings far from the model at the command, nor soon after a reported
contact, unless it is forced. A tare that was taken by itself before any command rests on an
assumed pose; a first command to another pose drops it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.state import EstimationSettings, Tare, TareState, utc_text
from cablesense_online.stated_contacts import RestingArm
from cablesense_sim.replay import reading_variance_n2

_MOST_KEPT = 16
"""How many times a tare can be undone."""
_LINEAR_RAD = 0.02
"""Unloaded tensions are taken as linear while a joint turns by this."""
_DIFFERENCE_RAD = 1e-3
"""Step of their numeric derivative."""
_ONE_POSE_RAD = 1e-3
"""Readings of a tare are of poses within this of the first."""


class TareError(CableSenseError):
    """No tare can be taken or undone now; the message states why, and what to do."""


class Tares:
    """Takes tares from the latest readings, and carries the present one over to commands.

    Attributes:
        state: the tare in use, at the present angles.
        automatic: whether one is to be taken as soon as nothing is against it.
        unloaded_n: (M,) unloaded tensions at the present angles; None before the first tare.
    """

    def __init__(
        self, unloaded: RestingArm, settings: EstimationSettings, command_rad: Array
    ) -> None:
        """Without a tare, at a command (2N,).

        Raises:
            EquilibriumError: the arm has no rest at this command.
        """
        self._unloaded, self._settings = unloaded, settings
        self._deviation_n = settings.tare_deviation_n or math.inf
        self.automatic = settings.auto_tare
        self._contact: Contact | None = None
        self._since_contact = 0
        self._readings: deque[Sequence[float]] = deque(maxlen=settings.tare_samples)
        self._readings_at_rad = command_rad
        self._near: tuple[Array, Array, Array] | None = None
        self._earlier: deque[Tare] = deque(maxlen=_MOST_KEPT - 1)
        self.state = TareState(predicted_n=unloaded.predict_n(command_rad))
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
        before_n, predicted_n = self.state.predicted_n, self._unloaded.predict_n(command_rad)
        self.state.predicted_n = predicted_n
        self._linearise(None)
        self._readings.clear()
        self._readings_at_rad = command_rad
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
            EquilibriumError: the unloaded arm has no rest there.
        """
        if self._near is None and np.array_equal(angles_rad, self._readings_at_rad):
            return  # solved there
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
    def awaited(self) -> str:
        """Why the automatic tare is not taken though readings are there; else empty."""
        enough = len(self._readings) >= self._settings.tare_samples
        return self.refusal() if self.automatic and enough else ""

    def refusal(self, *, forced: bool = False) -> str:
        """Why the last readings are no tare, as text; empty where they may be one."""
        count, steady_n = self._settings.tare_samples, self._settings.tare_steady_n
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
        if forced:
            return ""
        if self._contact is not None and self._since_contact < count:
            return (
                f"a contact of {self._contact.magnitude_n:.1f} N on segment "
                f"{self._contact.segment} is reported, or was among these readings; take it away "
                "and call again. If nothing touches the arm, the present tare is wrong: call "
                "~/tare_undo, or set tare_force"
            )
        measured_n = np.mean(self._readings, axis=0)
        off_n = measured_n - self.state.predicted_n
        worst = int(np.argmax(np.abs(off_n)))
        if self._unloaded.incomplete or abs(off_n[worst]) <= self._deviation_n:
            return ""
        if exchanged := exchanged_plugs(measured_n, self.state.predicted_n):
            return f"{exchanged}; exchange them, or set tare_force if they are right"
        return (
            f"cable_{worst + 1} lies {off_n[worst]:+.1f} N from the arm file's unloaded tension "
            f"at the last command, straight before the first (at most {self._deviation_n:g} N, "
            "tare_deviation_n): take loads away, and send the command that the arm is at. If it "
            "is unloaded and there, its arm file or sensors are off: set tare_force to take it"
        )

    def take(
        self, command_rad: Array, now_ns: int, *, by_itself: bool = False, forced: bool = False
    ) -> Tare:
        """Take the average of the last readings as the unloaded state at angles (2N,).

        `now_ns` is the time since the epoch. `forced` takes any steady readings.

        Raises:
            TareError: too few readings yet, they are not steady, or the arm seems to be loaded or
                elsewhere.
        """
        if refusal := self.refusal(forced=forced):
            raise TareError(refusal)
        if self.present is not None:
            self._earlier.append(self.present)
        predicted_n = self.state.predicted_n
        tare = Tare(
            measured_n=np.mean(self._readings, axis=0),
            predicted_n=self._unloaded.predict_n(command_rad) if self._near else predicted_n,
            command_rad=command_rad,
            sample_count=len(self._readings),
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
            EquilibriumError: this arm has no unloaded rest at these angles or at the tare's.
        """
        state = state.model_copy()
        if not same_arm:
            state.predicted_n = self._unloaded.predict_n(angles_rad)
            if state.tare is not None:
                predicted = {"predicted_n": self._unloaded.predict_n(state.tare.command_rad)}
                state.tare = state.tare.model_copy(update=predicted)
        self._earlier.clear()
        self._readings.clear()
        self._readings_at_rad = angles_rad
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
        if not self._unloaded.incomplete and tare.offset_n > self._deviation_n:
            level, message = Level.WARN, f"{message}, {tare.offset_n:.1f} N from the arm file"
        exchanged = exchanged_plugs(tare.measured_n, tare.predicted_n)
        if exchanged and not self._unloaded.incomplete:
            level, message = Level.WARN, f"{message}; {exchanged}"
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
        around_rad = at_rad + np.vstack([np.zeros_like(at_rad), step, -step])
        there_n, *others_n = self._unloaded.predict_n(around_rad)
        more, less = np.split(np.array(others_n), 2)
        self._near = (at_rad, there_n, (more - less).T / (2.0 * _DIFFERENCE_RAD))
        self.state.linear_at_rad = at_rad


def tare_undone_line(
    undone: Tare, earlier: Tare | None, cable_names: Sequence[str], undoable: int
) -> str:
    """Log line of an undo: the undone tare, the one in force, and how many `undoable` remain."""
    line = f"tare of {undone.since} undone; "
    if earlier is None:
        return line + "there is none now, so no estimate"
    described = earlier.described(cable_names)
    return f"{line}again in force is the one {described}; {undoable} left to undo"


_APART_N = 1.0
"""Cables whose unloaded tensions differ by less cannot be distinguished: builds scatter more."""
_LEFT = 0.5
"""An exchange is believed if it leaves at most this share of the deviation from the arm file."""


def exchanged_plugs(measured_n: Array, predicted_n: Array) -> str:
    """The plugs whose exchange explains most of how readings (M,) differ from predicted ones (M,).

    Of an untouched arm at a known pose, as a sentence; empty where none does.
    """
    before_n2 = float(((measured_n - predicted_n) ** 2).sum())
    apart_n = np.abs(np.subtract.outer(predicted_n, predicted_n))
    # by how much each exchange lowers the sum of squares
    lower_n2 = -2.0 * np.subtract.outer(measured_n, measured_n)
    lower_n2 = np.triu(lower_n2 * np.subtract.outer(predicted_n, predicted_n))
    one, other = np.unravel_index(np.argmax(lower_n2), lower_n2.shape)
    after_n2 = max(before_n2 - float(lower_n2[one, other]), 0.0)
    if apart_n[one, other] < _APART_N or after_n2 > _LEFT**2 * before_n2:
        return ""
    before_n, after_n = (math.sqrt(each / len(measured_n)) for each in (before_n2, after_n2))
    return (
        f"the plugs of cable_{one + 1} and cable_{other + 1} look exchanged: the readings are "
        f"{before_n:.2f} N (RMS) from the arm file's unloaded tensions, and {after_n:.2f} N once "
        "these two are exchanged"
    )


_WINDOW_S, _FEWEST_READINGS = 0.5, 25
_WINDOWS = 3
"""Windows in a row; their smallest deviation is the drift, if all have its sign."""
_MOST_TOUCHED = 10
"""This many contacts in a row begin the windows anew; fewer are noise and excluded."""
_LEAST_STDS = 5.0
"""No limit is below this many standard deviations of a window and its tare."""


class DriftWatch:
    """Warns of unloaded tensions that have moved since the tare, and proposes a fresh one.

    Readings of an untouched arm less its unloaded tensions are averaged in windows. The part that
    several windows in a row share is drift. A swing, or a touch too light to be a contact, does
    not last that long.

    Attributes:
        drift_n: (M,) drift over the last windows, N; zero before there were enough.
        limit_n: a warning is due from here on; infinite where nothing is watched.
    """

    def __init__(self, unloaded: RestingArm, settings: EstimationSettings) -> None:
        self._cable_names = unloaded.arm.cable_names
        share = 1.0 / _FEWEST_READINGS + 1.0 / settings.tare_samples
        noise_n = math.sqrt(reading_variance_n2(unloaded.arm.sensors) * share)
        self._unwatched, limit_n = unloaded.incomplete, settings.tare_drift_n
        if not limit_n:
            self._unwatched = self._unwatched or "switched off (tare_drift_n is 0)"
        self.limit_n = math.inf if self._unwatched else max(limit_n, _LEAST_STDS * noise_n)
        self._sum_n = np.zeros(len(self._cable_names))
        self._means_n: deque[Array] = deque(maxlen=_WINDOWS)
        self.tared()

    def tared(self) -> None:
        """Begin anew with another tare, or none."""
        self.interrupt()
        self.drift_n = np.zeros(len(self._cable_names))
        self._since_ns: int | None = None

    def interrupt(self) -> None:
        """Begin new windows, as the arm is touched or moves; the last result is kept."""
        self._count = self._touched = 0
        self._means_n.clear()

    def add(self, difference_n: Array, stamp_ns: int, *, touched: bool) -> None:
        """Add a reading minus the unloaded one (M,), at rest; `touched` as estimated."""
        self._touched = self._touched + 1 if touched else 0
        if self._touched == _MOST_TOUCHED:
            self.interrupt()
        if touched:
            return
        if not self._count:
            self._began_ns = stamp_ns
            self._sum_n[:] = 0.0
            if not self._means_n:
                self._first_ns = stamp_ns
        self._sum_n += difference_n
        self._count += 1
        if self._count < _FEWEST_READINGS or abs(stamp_ns - self._began_ns) < _WINDOW_S * 1e9:
            return
        self._means_n.append(self._sum_n / self._count)
        self._count = 0
        if len(self._means_n) == _WINDOWS:
            lowest, highest = np.min(self._means_n, axis=0), np.max(self._means_n, axis=0)
            self.drift_n = np.maximum(lowest, 0.0) + np.minimum(highest, 0.0)
            if np.abs(self.drift_n).max() < self.limit_n:
                self._since_ns = None
            elif self._since_ns is None:
                self._since_ns = self._first_ns

    def status(self) -> Status:
        """Which tensions have drifted, and since when."""
        if self._unwatched:
            return Status("drift", Level.OK, f"not watched: {self._unwatched}")
        sizes = zip(self._cable_names, self.drift_n.tolist(), strict=True)
        values = {
            "drift since the tare (N)": ", ".join(f"{name} {n:+.2f}" for name, n in sizes),
            "warned of from (N)": f"{self.limit_n:.2f}",
        }
        if self._since_ns is None:
            return Status("drift", Level.OK, "none of the unloaded tensions seen", values)
        size_n = np.abs(self.drift_n)
        off = np.flatnonzero(size_n >= 0.4 * size_n.max())
        most = 2 * len(off) > len(size_n)
        which = "most cables" if most else ", ".join(self._cable_names[cable] for cable in off)
        message = (
            f"unloaded tensions have drifted by up to {self.drift_n[size_n.argmax()]:+.2f} N "
            f"({which}) from the tare since {utc_text(self._since_ns)}: call ~/tare with nothing "
            "touching the arm"
        )
        return Status("drift", Level.WARN, message, values)
