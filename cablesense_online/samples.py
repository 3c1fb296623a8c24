"""Which tension samples can be used: their stamps and values are checked.

No force is ever estimated from a sample that is refused here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from math import inf, isfinite, nextafter
from typing import Final, NoReturn

from cablesense_base import CableSenseError
from cablesense_contact.felt import ChannelLimits


class ProblemKind(Enum):
    """The kind of fault of a sample; the value is its name in diagnostics."""

    PUBLISHER = "of another publisher"
    MALFORMED = "malformed"
    CLOCK = "stale or from another clock"
    NAMES = "wrong names or length"
    NOT_FINITE = "not finite"
    SATURATED = "saturated"
    IMPLAUSIBLE = "implausible"
    MISFIT = "readings that fit no contact"
    ESTIMATE = "no finite estimate"


class SampleError(CableSenseError):
    """A sample that cannot be used, and what would be right."""

    def __init__(self, kind: ProblemKind, message: str) -> None:
        super().__init__(message)
        self.kind = kind


PLAUSIBLE_N: Final = (-20.0, 20_000.0)
"""A cable pulls: lower readings are a fault, not an offset. No such arm bears higher ones."""
PLAUSIBLE_N_M: Final = (-20_000.0, 20_000.0)
"""Torques of any such machine's joints."""


class ReadingLimits:
    """Refuses readings that no cable carries or no sensor gives; slack cables are no fault.

    A saturated reading means only that the tension lies at or beyond the sensor's limit, so any
    force estimated from it would be false.
    """

    def __init__(self, channels: ChannelLimits) -> None:
        self._channels = channels
        self._limits = [
            (_refused_up_to(low, unit), high)
            if isfinite(low) or isfinite(high)
            else _plausible(unit)
            for low, high, unit in zip(
                channels.lowest.tolist(), channels.highest.tolist(), channels.units, strict=True
            )
        ]
        self._common = (max(low for low, _ in self._limits), min(high for _, high in self._limits))

    def check(self, readings: Sequence[float]) -> None:
        """Check (M,) readings in the units of their channels.

        Raises:
            SampleError: a reading is not finite, saturated or implausible.
        """
        low, high = self._common
        within = low < min(readings) and max(readings) < high
        if not (isfinite(sum(readings)) and within):
            self._check_each(readings)

    def _check_each(self, readings: Sequence[float]) -> None:
        for number, (reading, (low, high)) in enumerate(zip(readings, self._limits, strict=True)):
            if not low < reading < high:
                self._refuse(number, reading, low, high)

    def _refuse(self, number: int, reading: float, low: float, high: float) -> NoReturn:
        unit = self._channels.units[number]
        lowest = self._channels.lowest[number]
        highest = self._channels.highest[number]
        given = isfinite(lowest) or isfinite(highest)
        if not isfinite(reading):
            kind = ProblemKind.NOT_FINITE
            text = "; it must be a finite number"
        elif not given:
            text = f"; no cable of such an arm is outside {low:g} … {high:g} {unit}"
            kind = ProblemKind.IMPLAUSIBLE
        else:
            text = f", at an end of the sensors' range {lowest:g} … {highest:g} {unit}"
            text += "; unload the arm" if reading >= highest else "; check the sensor's zero"
            kind = ProblemKind.SATURATED
        name = self._channels.names[number]
        raise SampleError(kind, f"effort of {name} is {reading:g} {unit}{text}")


def _refused_up_to(lowest: float, unit: str) -> float:
    """Where a tension sensor's range ends at zero, that is what a slack cable reads."""
    return nextafter(0.0, -inf) if lowest == 0.0 and unit == "N" else lowest


def _plausible(unit: str) -> tuple[float, float]:
    return PLAUSIBLE_N if unit == "N" else PLAUSIBLE_N_M


def slack_cables(
    readings: Sequence[float], units: Sequence[str], slack_below_n: float
) -> tuple[int, ...]:
    """Numbers, from 1, of the cables whose readings (M,), N, are below a limit.

    Channels of other units (M) are no cables: torques may be negative.
    """
    if min(readings) >= slack_below_n:
        return ()
    numbered = enumerate(zip(readings, units, strict=True), start=1)
    return tuple(n for n, (reading, unit) in numbered if unit == "N" and reading < slack_below_n)


@dataclass(frozen=True)
class Stamps:
    """The stamps of samples so far: those that are too old or not newer are refused.

    Samples without a stamp (zero) are accepted, as sampled on arrival, until one with a stamp has
    come. Stamps may step back only if this machine's clock has.

    Attributes:
        last_ns: of the last sample that was accepted; 0 without one.
        last_now_ns: this machine's clock then.
    """

    last_ns: int = 0
    last_now_ns: int = 0

    def accepted(self, stamp_ns: int, now_ns: int, stale_after_s: float) -> Stamps:
        """With the stamp of a sample that comes at `now_ns`, of this age at most.

        Raises:
            SampleError: the stamp cannot be that of a present sample.
        """
        if stamp_ns == 0 and not self.last_ns:
            return self
        if problem := self._problem(stamp_ns, now_ns, stale_after_s):
            raise SampleError(ProblemKind.CLOCK, f"header.stamp {problem}")
        return Stamps(stamp_ns, now_ns)

    def _problem(self, stamp_ns: int, now_ns: int, stale_after_s: float) -> str:
        """What is wrong with a stamp, as text; empty where nothing is."""
        if stamp_ns == 0:
            return (
                "is 0, and samples with stamps have come: such a sample's age is unknown; stamp "
                "every sample"
            )
        age_s = (now_ns - stamp_ns) * 1e-9
        if abs(age_s) > stale_after_s:
            where = "old" if age_s > 0 else "ahead of this machine's clock"
            return (
                f"is {abs(age_s):.3f} s {where}; at most {stale_after_s:g} s is accepted "
                "(synchronise the clocks; for a replay set use_sim_time)"
            )
        behind_ns = self.last_ns - stamp_ns
        stepped_back = now_ns < self.last_now_ns and behind_ns >= stale_after_s * 1e9
        if behind_ns >= 0 and not stepped_back:
            return (
                f"lies {behind_ns * 1e-9:.6f} s before that of the last sample; stamps must "
                "ascend (is there more than one publisher?)"
            )
        return ""
