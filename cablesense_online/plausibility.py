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
        self._withheld, self._last_problem = 0, ""

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
            return
        if not self.misfit_since_ns <= stamp_ns < until_ns:  # or the stamps stepped back
            self.misfit_since_ns = stamp_ns
        lasted_s = (stamp_ns - self.misfit_since_ns) * 1e-9
        if misfit:
            hold_ns = round(min(max(lasted_s, LEAST_WITHHELD_S), WITHHELD_S) * 1e9)
            if until_ns - stamp_ns < hold_ns // 2:
                until_ns = stamp_ns + hold_ns
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
        self._worst, self._withheld = 0.0, 0
        return Status("plausibility", level, message, values)

    def _misfit_text(self, difference_n: Array, contact: Contact) -> str:
        """What does not fit, as text; empty where all does."""
        if not contact.segment:
            free = difference_n / self._fits.spread_n
            self.misfit = math.sqrt(float(free @ free) / len(free))
            if self.misfit <= self._largest:
                return ""
            return self._described("no contact", difference_n)
        self.misfit = math.inf
        segment, force = contact.segment, contact.magnitude_n
        where = f"a force on segment {segment}"
        if force > self._largest_force_n:
            return (
                f"an estimate of {force:.0f} N is beyond the {self._largest_force_n:.0f} N that "
                f"are vouched for{self._suspects(difference_n)}"
            )
        y, z = (force * part for part in contact.direction)
        fit = self._fits.best(difference_n, segment, y, z, self._largest)
        if fit is None:
            return f"the arm cannot rest under the {force:.0f} N estimated on segment {segment}"
        self.misfit = fit.misfit
        if fit.misfit > self._largest:
            return self._described(where, difference_n, fit)
        if not fit.holds(self._largest):
            return self._slack_text(fit, where)
        best_y, best_z = fit.force_n
        off_n = math.hypot(best_y - y, best_z - z)
        if off_n > FORCE_OFF_N:
            return f"{where} that fits lies {off_n:.1f} N from the estimate"
        return ""

    def _slack_text(self, fit: Fit, where: str) -> str:
        """Which cable reads slack that would not be under the force that fits all others."""
        tension_n = fit.elastic_n
        cable = max(fit.response.slack, key=tension_n.__getitem__)
        if fit.consistent or not fit.near:
            return (
                f"the arm cannot rest under {where} with the cables slack that read so; no one "
                "cable explains it"
            )
        return (
            f"{self._cable_names[cable]} is slack and would carry {tension_n[cable]:.1f} N under "
            f"{where} that fits all others: a broken cable, or a channel that reads zero"
        )

    def _described(self, contact: str, difference_n: Array, fit: Fit | None = None) -> str:
        return (
            f"readings lie {self.misfit:.1f} times as far from {contact} as by their noise (at "
            f"most {self._largest:g}){self._suspects(difference_n, fit)}"
        )

    def _suspects(self, difference_n: Array, fit: Fit | None = None) -> str:
        """Cables without whose reading all others fit: no contact, or the one estimated."""
        free = difference_n / self._fits.spread_n
        left = [(free @ free - free**2, len(free) - 1)]
        if fit is not None:
            cables = range(len(free))
            left.append((np.array([fit.without([i]) for i in cables]), len(free) - 3))
        fits = np.any([chi <= max(n, 1) * self._largest**2 for chi, n in left], axis=0)
        names = [name for name, fit_it in zip(self._cable_names, fits, strict=True) if fit_it]
        if not names:
            return "; no one cable explains it"
        return f"; all but the reading of {' or '.join(names)} would fit"
