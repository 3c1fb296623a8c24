"""Whether readings can come from the contact that was estimated from them.

M readings answer to the two components of one force, so M - 2 combinations of them are left over.
They must vanish within noise, slack cables included:

    r = (reading - unloaded) - (T(c, f) - T(c, 0))

with T the static equilibrium at the command c under a force f on the touched segment, and f fitted
too. The misfit is the root mean square of r over its expected spread, so 1 for a healthy arm. Its
spread has the sensors' noise and step, those of the tare, and a force along the segment, which
friction at the contact may add and no estimate has.

A verdict depends on nothing before its sample, apart from the time that forces are withheld after
a misfit.

What fits is not proven right: a fault whose pattern is that of a force looks like that force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact, Level, Status
from cablesense_online.force_fit import Fit, ForceFits
from cablesense_online.samples import ProblemKind, SampleError
from cablesense_online.tare import UnloadedTensions

FORCE_OFF_N: Final = 5.0
"""An estimate so far from the force that fits best is not vouched for."""

BEYOND_TRAINING: Final = 1.25
"""Forces up to this multiple of the model's training range are vouched for."""

LEAST_WITHHELD_S, WITHHELD_S = 0.05, 0.2
"""After misfits no force is given for as long as they lasted, between these; a swing ends soon on
a stiff arm. The time is renewed when half of it is left."""

_LEAST_SPREAD_N = 0.01
"""Of a sensor without noise and step."""


class PlausibilityCheck:
    """Gives no force whose readings do not fit it, nor one soon after such a sample.

    Attributes:
        unchecked: why nothing is checked; empty where all is.
        withheld_until_ns: samples with earlier stamps give no force.
        misfit_since_ns: stamp from which on readings did not fit, where that has not passed.
        misfit: of the last sample; infinite where no equilibrium was compared with.
    """

    def __init__(
        self,
        statics: UnloadedTensions,
        spread_n: float,
        largest_misfit: float,
        force_range_n: float,
        cable_names: Sequence[str],
        unchecked: str = "",
        limit_from: str = "",
    ) -> None:
        """`force_range_n` is that of the model's training; `largest_misfit` 0 checks nothing.

        `limit_from` states where that limit comes from.
        """
        self._limit_from = limit_from
        self._fits = ForceFits(statics, max(spread_n, _LEAST_SPREAD_N))
        self.unchecked = unchecked if largest_misfit else "switched off (largest_misfit is 0)"
        self._largest, self._largest_force_n = largest_misfit, BEYOND_TRAINING * force_range_n
        self._cable_names = cable_names
        self.withheld_until_ns = self.misfit_since_ns = 0
        self.misfit = self._worst = 0.0
        self._withheld, self._last_problem, self._suspects = 0, "", ""
        self._fit: Fit | None = None
        self._passed: tuple[Fit, Array] | None = None

    def check(
        self, difference_n: Array, command_rad: Array, contact: Contact, stamp_ns: int
    ) -> None:
        """Check readings less unloaded tensions (M,) at a command (2N,) with the arm at rest.

        Raises:
            SampleError: they do not fit the contact that was estimated, or did not a moment ago.
        """
        if command_rad is not self._fits.command_rad:
            self._fits.command(command_rad)
        misfit = self._misfit_text(difference_n, contact)
        self._worst = max(self._worst, self.misfit)
        until_ns = min(self.withheld_until_ns, stamp_ns + round(WITHHELD_S * 1e9))
        if not misfit and stamp_ns >= until_ns:
            if self._fit is not None:
                self._passed = (self._fit, difference_n)
            return
        if not self.misfit_since_ns <= stamp_ns < until_ns:  # or the stamps stepped back
            self.misfit_since_ns = stamp_ns
        lasted_s = (stamp_ns - self.misfit_since_ns) * 1e-9
        if misfit:
            hold_ns = round(min(max(lasted_s, LEAST_WITHHELD_S), WITHHELD_S) * 1e9)
            if until_ns - stamp_ns < hold_ns // 2:
                until_ns, self._suspects = stamp_ns + hold_ns, self._suspected(difference_n)
            misfit += self._suspects
        self.withheld_until_ns = until_ns
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
            "this limit is": self._limit_from,
            "withheld": str(self._withheld),
        }
        level, message = Level.OK, "readings fit the estimates"
        if self._withheld:
            level, message = Level.ERROR, self._last_problem
            values["no force since stamp (s)"] = f"{self.misfit_since_ns * 1e-9:.3f}"
        elif hidden := self._hidden():
            level, message = Level.WARN, f"readings fit, but {hidden}"
        self._worst, self._withheld, self._passed = 0.0, 0, None
        return Status("plausibility", level, message, values)

    def _misfit_text(self, difference_n: Array, contact: Contact) -> str:
        """What does not fit, as text; empty where all does."""
        self._fit = None
        if not contact.segment:
            free = difference_n / self._fits.spread_n
            self.misfit = math.sqrt(float(free @ free) / len(free))
            return "" if self.misfit <= self._largest else self._described("no contact")
        self.misfit = math.inf
        segment, force = contact.segment, contact.magnitude_n
        where = f"a force on segment {segment}"
        if force > self._largest_force_n:
            return (
                f"an estimate of {force:.0f} N is beyond the {self._largest_force_n:.0f} N that "
                "are vouched for"
            )
        y, z = (force * part for part in contact.direction)
        self._fit = fit = self._fits.best(difference_n, segment, y, z, self._largest)
        if fit is None:
            return f"the arm cannot rest under the {force:.0f} N estimated on segment {segment}"
        self.misfit = fit.misfit
        if fit.misfit > self._largest:
            return self._described(where)
        best_y, best_z = fit.force_n
        off_n = math.hypot(best_y - y, best_z - z)
        if off_n > FORCE_OFF_N:
            return f"{where} that fits lies {off_n:.1f} N from the estimate"
        return "" if fit.holds(self._largest) else self._slack_text(fit, where)

    def _slack_text(self, fit: Fit, where: str) -> str:
        """Which cable reads slack that would not be under the force that fits all others."""
        if fit.consistent or not fit.near:
            return f"the arm cannot rest under {where} with the cables slack that read so"
        tension_n = fit.elastic_n
        cable = max(fit.response.slack, key=tension_n.__getitem__)
        return (
            f"{self._cable_names[cable]} is slack and would carry {tension_n[cable]:.1f} N under "
            f"{where} that fits all others: a broken cable, or a channel that reads zero"
        )

    def _described(self, contact: str) -> str:
        return (
            f"readings lie {self.misfit:.1f} times as far from {contact} as by their noise (at "
            f"most {self._largest:g})"
        )

    def _suspected(self, difference_n: Array) -> str:
        """The cable, or a segment's cables, without whose readings all others fit."""
        if self.misfit <= self._largest:
            return ""
        ends_on = self._fits.statics.mechanism.cable_segment
        for cables in (
            [[cable] for cable in range(len(ends_on))],
            [np.flatnonzero(ends_on == segment).tolist() for segment in np.unique(ends_on)],
        ):
            names = [
                ", ".join(self._cable_names[cable] for cable in some)
                for some in cables
                if self._fit_without(difference_n, some)
            ]
            if names:
                return f"; all but the reading of {' or '.join(names)} would fit"
        return "; the cables of no one segment explain it"

    def _fit_without(self, difference_n: Array, cables: Sequence[int]) -> bool:
        """Whether all other readings fit no contact, or the one estimated."""
        free = np.delete(difference_n, cables) / self._fits.spread_n
        misfits = [math.sqrt(float(free @ free) / max(len(free), 1))]
        if self._fit is not None:
            misfits.append(self._fit.without(cables))
        return min(misfits) <= self._largest

    def _hidden(self) -> str:
        """Which cables' readings no others confirm in the last contact, as text; else empty."""
        if self._passed is None:
            return ""
        fit, difference_n = self._passed
        hidden_n = fit.hidden_n(difference_n, self._largest)
        of = np.flatnonzero(hidden_n > FORCE_OFF_N).tolist()
        if not of:
            return ""
        names = " or ".join(self._cable_names[cable] for cable in of)
        return (
            f"in this contact no others confirm that of {names}: if it is wrong, the force is, by "
            f"up to {min(float(hidden_n.max()), self._largest_force_n):.0f} N"
        )
