"""Whether readings can come from the contacts that were estimated from them.

M readings determine two numbers of each of K contacts at the points of the arm file, or four of
each anywhere; the residuals of all further combinations must vanish within noise, slack cables
included. The misfit is their root mean square in their expected standard deviations, so 1 for a
healthy arm. These include the noise and step of the sensors and of the tare, and forces along the
segments, which friction at a contact may add. A model of contacts anywhere states it; for others
the contacts that fit best do (`RestingArm.explained`).

A verdict depends on nothing before its sample, except the time that forces are withheld after a
misfit, and an earlier equilibrium that fits this sample too where a cable reads slack.

A fit proves nothing: a fault with the pattern of a force looks like that force. Therefore a
contact is `unconfirmed` if one wrong reading would pass, or if the average of a steady contact's
readings, which has less noise, does not fit it. A wrong reading must pass the smaller limit of
an average too, once one has fitted. Both are judged against the static equilibrium when the
contact changes, and every two seconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.state import MisfitState
from cablesense_online.stated_contacts import (
    ANYWHERE_NUMBERS,
    AVERAGED_EVERY_NS,
    FORCE_OFF_N,
    LEAST_SPREAD_N,
    POINT_NUMBERS,
    TAUT_SPREADS,
    RestingArm,
    StatedContacts,
    SteadyContact,
)
from cablesense_sim.contact_location import touched_at
from cablesense_sim.replay import mean_variance_n2
from cablesense_training.inference.metadata import ANYWHERE, ModelMetadata

LARGEST_MISFIT: Final = 2.3
"""Unless a model file states another: by noise alone one sample of twelve cables in ten million
exceeds it."""

BEYOND_TRAINING: Final = 1.25
"""Estimates beyond this multiple of the model's training range give no force."""

LEAST_WITHHELD_S, WITHHELD_S = 0.05, 0.2
"""After misfits no force is given for as long as they lasted, within these limits: a swing ends
soon on a stiff arm. The time is renewed when half of it has passed."""

SETTLING_TIMES: Final = 2.0
"""Inertia and damping make misfits of up to about one and a half times the limit at rest, while
joints turn slowly or the arm swings after a move."""

AVERAGED_S: Final = 1.0
"""Readings of a contact are averaged over up to this time."""

_FEWEST_AVERAGED = 5

FALSE_ALARM_RATE: Final = 1e-7
"""Share of healthy samples that exceed the limits of model files by noise alone."""


class PlausibilityCheck:
    """Gives no force whose readings do not fit it, nor one soon after such a sample.

    Attributes:
        state: until when forces are withheld.
        unchecked: why nothing is checked; empty where all is.
        doubt: why the contact of the last sample that fits is unconfirmed; empty where it is not.
        misfit: misfit of the last sample; infinite if it was compared with no equilibrium.
    """

    def __init__(
        self,
        arm: RestingArm,
        largest_misfit: float,
        model: ModelMetadata | None,
        unchecked: str = "",
    ) -> None:
        """`largest_misfit` 0 checks nothing; only then may `model`, its metadata, be None.

        `unchecked` states why a model's answers cannot be checked.
        """
        self.arm, self._cable_names = arm, arm.arm.cable_names
        self.unchecked = unchecked or arm.incomplete
        if not largest_misfit:
            self.unchecked = "switched off (largest_misfit is 0)"
        self._largest, self._model = largest_misfit, model
        self._largest_force_n = BEYOND_TRAINING * (model.force_range_n if model else 0.0)
        kind = model.kind if model else ""
        self._reach_m = touched_at(arm.arm)[0] if kind == ANYWHERE else None
        most_by_kind: dict[str, int] = {"multi-contact": arm.arm.segment_count, ANYWHERE: 2}
        most = most_by_kind.get(kind, 1)
        self._limits = _limits(largest_misfit, arm.arm.cable_count, most, numbers_of(kind))
        self.state = MisfitState()
        self.misfit = self._worst = 0.0
        self._withheld, self._last_problem, self._suspects = 0, "", ""
        self._fit: StatedContacts | None = None
        self._judged: StatedContacts | None = None
        self._nearly_slack: StatedContacts | None = None
        self.doubt = self._last_doubt = self._apart = ""
        self._steady: SteadyContact | None = None
        self._command_rad: Array | None = None

    def check(
        self,
        difference_n: Array,
        command_rad: Array,
        contacts: Sequence[Contact],
        stamp_ns: int,
        stated_misfit: float | None = None,
        stated_doubt: str = "",
        *,
        settling: bool = False,
    ) -> None:
        """Check readings less unloaded tensions (M,) at a pose (2N,) of the arm.

        Contacts come the strongest first, with the misfit that the model states, if it does, and
        its own reason to doubt them. While the arm is `settling`, a larger misfit of contacts is
        a doubt only, as its motion makes one.

        Raises:
            SampleError: they do not fit the contacts estimated, or did not a moment ago.
        """
        if command_rad is not self._command_rad:
            self._command_rad = command_rad
            self.arm.command(command_rad)
            self._steady = self._judged = self._nearly_slack = None
        state = self.state
        until_ns = min(state.withheld_until_ns, stamp_ns + round(WITHHELD_S * 1e9))
        lasts = state.misfit_since_ns <= stamp_ns < until_ns  # otherwise the stamps stepped back
        lasted_s = (stamp_ns - state.misfit_since_ns) * 1e-9 if lasts else 0.0
        hold_ns = round(min(max(lasted_s, LEAST_WITHHELD_S), WITHHELD_S) * 1e9)
        due = until_ns - stamp_ns < hold_ns // 2
        misfit = self._misfit_text(difference_n, contacts, stated_misfit, due=due)
        self._worst = max(self._worst, self.misfit)
        most = SETTLING_TIMES * self._largest
        if settling and contacts and self._largest < self.misfit <= most:
            misfit, stated_doubt = "", f"{misfit} while the arm moves or settles"
        if not misfit and stamp_ns >= until_ns:
            doubted = self._doubted(difference_n, stamp_ns, settling)
            self.doubt = self._apart or doubted or stated_doubt
            self._last_doubt = self.doubt or self._last_doubt
            return
        self._steady = None
        if not lasts:
            state.misfit_since_ns = stamp_ns
        if misfit:
            if due:
                until_ns, self._suspects = stamp_ns + hold_ns, self._suspected(difference_n)
            misfit += self._suspects
        state.withheld_until_ns = until_ns
        self._withheld += 1
        misfit = misfit or "the readings fit again, and not yet for long enough"
        self._last_problem = f"{misfit} (no force for {lasted_s:.1f} s)"
        raise SampleError(ProblemKind.MISFIT, self._last_problem)

    def status(self) -> Status:
        """Whether readings have fitted since the last report."""
        if self.unchecked:
            return Status("plausibility", Level.OK, f"not checked: {self.unchecked}")
        values = {
            "largest misfit": f"{self._worst:.2f}",
            "largest misfit that passes": f"{self._largest:g}",
            "this limit is": self._limit_origin(),
            "withheld": str(self._withheld),
        }
        level, message = Level.OK, "readings fit the estimates"
        if self._withheld:
            level, message = Level.ERROR, self._last_problem
            values["no force since stamp (s)"] = f"{self.state.misfit_since_ns * 1e-9:.3f}"
        elif self._last_doubt:
            level, message = Level.WARN, f"readings fit, but {self._last_doubt}"
        self._worst, self._withheld, self._last_doubt = 0.0, 0, ""
        return Status("plausibility", level, message, values)

    def _limit_origin(self) -> str:
        stated = self._model.misfit_limit if self._model else None
        if stated is not None and self._largest == stated.largest_misfit:
            return (
                f"of the model file: above it are {stated.above} of {stated.samples} simulated "
                f"healthy samples, by noise alone a share of {stated.false_alarm_rate:g}"
            )
        if stated is None and self._largest == LARGEST_MISFIT:
            return "by default: the model file states none"
        return "of the parameter largest_misfit"

    def _misfit_text(
        self,
        difference_n: Array,
        contacts: Sequence[Contact],
        stated_misfit: float | None,
        *,
        due: bool,
    ) -> str:
        """Why the readings do not fit, as text; empty where they do."""
        self._fit, self._apart = None, ""
        if not contacts:
            self.misfit = self.arm.misfit(difference_n)
            return "" if self.misfit <= self._largest else self._described("no contact")
        self.misfit = math.inf
        force = contacts[0].magnitude_n
        if force > self._largest_force_n:
            return (
                f"an estimate of {force:.0f} N is beyond {self._largest_force_n:.0f} N, "
                f"{BEYOND_TRAINING:g} times what the model was trained on"
            )
        contacts = sorted(contacts, key=lambda contact: contact.segment)
        largest = self._limits[len(contacts)]
        where = on_segments([contact.segment for contact in contacts])
        off_n = 0.0
        if stated_misfit is None:
            best, stated_misfit = self.arm.explained(difference_n, contacts)
            off_n = max(map(_apart_n, contacts, best))
            contacts = best
        self._fit = fit = StatedContacts(
            self.arm, difference_n, contacts, stated_misfit, self._reach_m
        )
        if self._judged is not None and self._judged.is_near(fit):
            fit.response = self._judged.response
        if stated_misfit > largest:
            stated_misfit = self._by_statics(fit, difference_n, largest, due=due)
        self.misfit = stated_misfit * self._largest / largest
        if not stated_misfit <= largest:
            return self._described(where)
        if off_n > FORCE_OFF_N:
            return f"the estimate lies {off_n:.1f} N from {where} that would fit"
        return ""

    def _by_statics(
        self, fit: StatedContacts, difference_n: Array, largest: float, *, due: bool
    ) -> float:
        """The misfit where a cable reads slack, by the static equilibrium near stated contacts.

        A model takes a cable that pulls by less than a reading shows for slack: without its length
        few taut cables determine the pose badly. It is the stated misfit where no cable reads
        slack, where statics does not fit, and while a fault that lasts is not `due`, because an
        equilibrium takes milliseconds. The last one that did fit is tried at any time. An estimate
        far from the contacts that fit is doubted.
        """
        reading_n = self.arm.unloaded_n + difference_n
        if reading_n.min() > TAUT_SPREADS * self.arm.spread_n:
            return fit.misfit
        for near in self._near(fit, due=due):
            misfit = near.misfit_of(difference_n)
            if misfit <= largest:
                self._nearly_slack = near
                same = near.segments == fit.segments
                if not same or math.dist(near.force_n, fit.force_n) > FORCE_OFF_N:
                    self._apart = f"{on_segments(near.segments)} fits better than the estimate"
                return misfit
        return fit.misfit

    def _near(self, fit: StatedContacts, *, due: bool) -> Iterator[StatedContacts]:
        if self._nearly_slack is not None:
            yield self._nearly_slack
        if due:
            yield fit
            if (refitted := fit.refitted()) is not None:
                yield refitted
            yield from fit.beside()

    def _described(self, contact: str) -> str:
        text = f"readings lie {self.misfit:.1f} times as far from {contact} as by their noise"
        return f"{text} (at most {self._largest:g})"

    def _suspected(self, difference_n: Array) -> str:
        """The cable, or the cables of a segment, without which all other readings fit."""
        if self.misfit <= self._largest:
            return ""
        ends_on = self.arm.mechanism.cable_segment
        segments = [np.flatnonzero(ends_on == segment).tolist() for segment in np.unique(ends_on)]
        for sets in ([[cable] for cable in range(len(ends_on))], segments):
            names = [
                ", ".join(self._cable_names[cable] for cable in cables)
                for cables in sets
                if self.arm.misfit(np.delete(difference_n, cables)) <= self._largest
                or (self._fit is not None and self._fit.without(cables) <= self._largest)
            ]
            if names:
                return f"; all but the reading of {' or '.join(names)} would fit"
        return "; the cables of no one segment explain it"

    def _doubted(self, difference_n: Array, stamp_ns: int, settling: bool) -> str:
        """Why a contact that fits is unconfirmed; empty where it is not.

        While the arm settles, the motion makes readings differ, so no average is judged.
        """
        fit, steady = self._fit, self._steady
        if fit is None:
            self._steady = None
            return ""
        if steady is None or not steady.continues(fit.segments, stamp_ns):
            self._steady = steady = SteadyContact(fit.segments, 0.0 * difference_n)
        steady.add(difference_n, tuple(fit.force_n), stamp_ns)
        passed = steady.passed or (difference_n, self._limits[len(fit.segments)])
        if steady.to_be_judged(fit.response, stamp_ns, passed[1]):
            self._judged = fit
            hidden = self._hidden(fit, *passed) or self._paired(fit, difference_n)
            steady.judge(fit.response, stamp_ns, hidden, passed[1])
        due = stamp_ns - steady.averaged_ns >= AVERAGED_EVERY_NS and not settling
        if due and steady.count >= _FEWEST_AVERAGED:
            steady.averaged_ns = stamp_ns
            self._judge_average(steady, stamp_ns)
        return steady.hidden or steady.off_average

    def _hidden(self, fit: StatedContacts, difference_n: Array, largest: float) -> str:
        """The cables whose readings no others confirm in a contact, as text; else empty."""
        hidden_n = fit.hidden_n(difference_n, largest)
        of = np.flatnonzero(hidden_n > FORCE_OFF_N).tolist()
        if not of:
            return ""
        names = " or ".join(self._cable_names[cable] for cable in of)
        return (
            f"in this contact no others confirm that of {names}: if it is wrong, the force is, by "
            f"up to {min(float(hidden_n.max()), self._largest_force_n):.0f} N"
        )

    def _paired(self, fit: StatedContacts, difference_n: Array) -> str:
        """Two cables whose readings may be wrong, as text; else empty.

        Either all others are those of an untouched arm, as for a moment on segment 1 normal to
        one of its cables; or two exchanged ones fit other forces on several segments. With one
        contact the latter hardly ever happens, as its forces leave so little free.
        """
        segments = fit.segments
        if len(segments) == 1:
            *others, one, other = np.argsort(np.abs(difference_n)).tolist()
            if fit.size_n < FORCE_OFF_N or self.arm.misfit(difference_n[others]) > self._largest:
                return ""
            names = " and ".join(self._cable_names[cable] for cable in sorted((one, other)))
            return f"wrong readings of {names} on an untouched arm would look the same"
        found = fit.exchanged(difference_n, self._limits[len(segments)])
        if found is None:
            return ""
        names = " and ".join(self._cable_names[cable] for cable in found)
        return f"several contacts can hide exchanged plugs of {names}"

    def _judge_average(self, steady: SteadyContact, stamp_ns: int) -> None:
        """Judge whether the average of a contact's readings fits.

        The limit is that of one reading, reduced as the noise of an average is.
        """
        count, full = steady.count, stamp_ns - steady.began_ns >= AVERAGED_S * 1e9
        averaged = (count, self.arm.tare_samples)
        variance_n2 = sum(mean_variance_n2(self.arm.arm.sensors, number) for number in averaged)
        spread_n = max(variance_n2**0.5, LEAST_SPREAD_N)
        largest = self._limits[len(steady.segments)] * spread_n / self.arm.spread_n
        mean_n = steady.sum_n / count
        # contacts whose forces are steady within a newton are near those that were judged
        misfit = 0.0 if self._judged is None else self._judged.misfit_of(mean_n)
        if misfit <= largest:
            steady.passed = mean_n, largest
        else:
            steady.passed = None
            steady.off_average = (
                f"on their average of {count} they lie {misfit:.2f} times as far from "
                f"{on_segments(steady.segments)} as one by its noise (at most {largest:.2f})"
            )
        if full:
            if steady.passed is not None:
                steady.off_average = ""
            steady.begin(stamp_ns)


def numbers_of(kind: str) -> int:
    """How many numbers readings determine of each contact that a model of a kind states."""
    return ANYWHERE_NUMBERS if kind == ANYWHERE else POINT_NUMBERS


def _apart_n(one: Contact, other: Contact) -> float:
    """The distance of two forces across a segment."""
    return math.dist(one.wrench[1:3], other.wrench[1:3])


def on_segments(segments: Sequence[int]) -> str:
    """Forces on segments as text."""
    if len(segments) == 1:
        return f"a force on segment {segments[0]}"
    return f"forces on segments {', '.join(map(str, segments))}"


def noise_limit(free: int, rate: float = FALSE_ALARM_RATE) -> float:
    """The misfit that noise of `free` redundant readings exceeds at a `rate`."""
    from scipy.special import chdtri  # nodes that tell single contacts start sooner without

    return math.sqrt(float(chdtri(free, rate)) / free)


def _limits(of_one: float, cables: int, most: int, numbers: int) -> list[float]:
    """The largest misfit that passes, by number of contacts up to `most`.

    The stated limit `of_one` also holds without contact. With more contacts the residuals have
    fewer degrees of freedom and their mean square varies more: each limit is exceeded equally
    rarely by noise alone, where (M - n K) misfit² has a chi-square distribution, with `numbers` n
    of each contact.
    """
    if most == 1:
        return [of_one] * 2
    noise = [noise_limit(max(cables - numbers * count, 1)) for count in range(1, most + 1)]
    return [of_one, *(of_one * each / noise[0] for each in noise)]
