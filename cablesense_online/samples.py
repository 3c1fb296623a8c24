"""Which tension samples can be used: publisher, stamps and values are checked, and counted.

No force is ever estimated from a sample that is refused here.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from enum import Enum
from math import isfinite
from typing import Final, NoReturn

from cablesense_base import CableSenseError
from cablesense_msgs_py.messages import Level, Status


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


class SampleCheck:
    """Refuses readings that no cable carries or no sensor gives; slack cables are no fault.

    A saturated reading means only that the tension lies at or beyond the sensor's limit, so any
    force estimated from it would be false.

    Attributes:
        slack: numbers, from 1, of the cables below `slack_below_n` in the last sample.
    """

    def __init__(self, range_n: tuple[float, float] | None, slack_below_n: float) -> None:
        """`range_n` is the sensors' range, if the arm file gives one."""
        self._given = range_n is not None
        self._range_n = range_n or PLAUSIBLE_N
        self.slack_below_n = slack_below_n
        self.slack: tuple[int, ...] = ()

    def check(self, tensions_n: Sequence[float]) -> None:
        """Check (M,) readings in N.

        Raises:
            SampleError: a reading is not finite, saturated or implausible.
        """
        low, high = self._range_n
        lowest = min(tensions_n)
        if not (isfinite(sum(tensions_n)) and low < lowest and max(tensions_n) < high):
            self._refuse(tensions_n)
        self.slack = ()
        if lowest < self.slack_below_n:
            numbered = enumerate(tensions_n, start=1)
            self.slack = tuple(number for number, t in numbered if t < self.slack_below_n)

    def status(self) -> Status:
        """Which cables are slack. Estimates continue: statics holds with slack cables too."""
        names = ", ".join(f"cable_{number}" for number in self.slack)
        values = {"slack": names or "none", "slack below (N)": f"{self.slack_below_n:g}"}
        if names:
            return Status("cables", Level.WARN, f"slack: {names}", values)
        return Status("cables", Level.OK, "all cables taut", values)

    def _refuse(self, tensions_n: Sequence[float]) -> NoReturn:
        low, high = self._range_n
        numbered = enumerate(tensions_n, start=1)
        cable, tension = next((n, t) for n, t in numbered if not low < t < high)
        if not isfinite(tension):
            kind = ProblemKind.NOT_FINITE
            text = "; it must be a finite number"
        elif not self._given:
            text = f"; no cable of such an arm is outside {low:g} … {high:g} N"
            kind = ProblemKind.IMPLAUSIBLE
        else:
            text = f", at the end of the sensors' range {low:g} … {high:g} N; unload the arm"
            kind = ProblemKind.SATURATED
        raise SampleError(kind, f"effort of cable_{cable} is {tension:g} N{text}")


class SampleClock:
    """Refuses samples that are too old, from the future, or not newer than the previous one.

    Samples without a stamp (zero) are accepted, as sampled on arrival, until one with a stamp has
    come. Stamps may step back only if this machine's clock has.

    Attributes:
        stale_after_s: largest age that is accepted; may be changed.
        largest_age_s: largest age since the last report set it to zero.
    """

    def __init__(self, stale_after_s: float) -> None:
        self.stale_after_s = stale_after_s
        self.largest_age_s = 0.0
        self._last_ns = 0
        self._last_now_ns = 0

    @property
    def last_ns(self) -> int:
        """Stamp of the last sample that was accepted; 0 without one."""
        return self._last_ns

    def accept(self, stamp_ns: int, now_ns: int) -> None:
        """Accept the stamp of a sample that comes at `now_ns`.

        Raises:
            SampleError: the stamp cannot be that of a present sample.
        """
        age_s = (now_ns - stamp_ns) * 1e-9
        problem = ""
        behind_ns = self._last_ns - stamp_ns
        stepped_back = now_ns < self._last_now_ns and behind_ns >= self.stale_after_s * 1e9
        if stamp_ns == 0:
            if not self._last_ns:
                return
            problem = (
                "is 0, and samples with stamps have come: such a sample's age is unknown; stamp "
                "every sample"
            )
        elif abs(age_s) > self.stale_after_s:
            where = "old" if age_s > 0 else "ahead of this machine's clock"
            problem = (
                f"is {abs(age_s):.3f} s {where}; at most {self.stale_after_s:g} s is accepted "
                "(synchronise the clocks; for a replay set use_sim_time)"
            )
        elif behind_ns >= 0 and not stepped_back:
            problem = (
                f"lies {behind_ns * 1e-9:.6f} s before that of the last sample; stamps must "
                "ascend (is there more than one publisher?)"
            )
        if problem:
            raise SampleError(ProblemKind.CLOCK, f"header.stamp {problem}")
        self._last_ns = stamp_ns
        self._last_now_ns = now_ns
        self.largest_age_s = max(self.largest_age_s, age_s)


_UNNUMBERED: Final = 2**64 - 1
"""In place of a number where the middleware gives none."""
_MOST_LOST: Final = 1000
_OTHERS_KEPT = 16


class FollowedPublisher:
    """Follows one publisher, so that samples of two are never mixed.

    rclpy gives no GID with a sample, only its publisher's number, which ascends by 1. The first
    publisher is followed. While it is alone its numbers ascend, and samples may be lost. While
    others are present, its next sample has exactly the next number; if another publisher's next
    sample would have that number too, none is used. A publisher that begins at exactly the next
    number is mistaken for the followed one until that one's next sample comes.

    Another is followed once the first has left, or only others have published for `stale_after_s`.

    Attributes:
        stale_after_s: may be changed.
        refused_s: monotonic time of the last sample of another.
        lost: how many of its samples never came, since the last report set it to zero.
    """

    def __init__(self, stale_after_s: float = 0.2) -> None:
        self.stale_after_s = stale_after_s
        self.refused_s = float("-inf")
        self.lost = 0
        self._publishers = 0
        self._last: int | None = None
        self._others: deque[int] = deque(maxlen=_OTHERS_KEPT)
        self._others_since_s: float | None = None
        self._one_was_followed = False
        self._in_doubt = False

    def matched(self, publishers: int) -> None:
        """Set the number of publishers that are present now."""
        self._publishers = publishers
        if not publishers:
            self._last = None

    def accept(self, number: int, now_s: float) -> bool:
        """Accept the sample with this number of its publisher, at monotonic time `now_s`.

        Gives whether another publisher is followed from this sample on, or may be.

        Raises:
            SampleError: the sample is not of the followed publisher, or may not be.
        """
        last = self._last
        if last is None:
            return self._follow(number)
        if self._others or self._publishers > 1:
            if number != last + 1 or last in self._others:
                return self._other(number, last, now_s)
            self._last = number
            self._others_since_s = None
            if self._publishers < 2:
                self._others.clear()
            in_doubt = self._in_doubt
            self._in_doubt = False
            return in_doubt
        if number != _UNNUMBERED:
            if not last < number <= last + _MOST_LOST:
                return self._other(number, last, now_s)
            self.lost += number - last - 1
        self._last = number
        return False

    def _other(self, number: int, last: int, now_s: float) -> bool:
        """As `accept`, for a sample that is not the next after the followed publisher's `last`."""
        if self._others_since_s is None:
            self._others_since_s = now_s
        elif now_s - self._others_since_s >= self.stale_after_s:
            return self._follow(number)
        if number - 1 != last:  # else it may be the followed one's
            if number - 1 in self._others:
                self._others.remove(number - 1)
            elif abs(number - last) < _MOST_LOST:
                self._in_doubt = True  # either of the two may have been followed before
            self._others.append(number)
        self.refused_s = now_s
        raise SampleError(
            ProblemKind.PUBLISHER,
            f"its publisher's number {number}, where the followed publisher's last was {last}; "
            "another is followed when that has been silent for "
            f"{self.stale_after_s:g} s: let one alone publish",
        )

    def _follow(self, number: int) -> bool:
        another = self._one_was_followed or self._publishers > 1
        self._one_was_followed = True
        self._in_doubt = False
        self._last = number
        self._others_since_s = None
        self._others.clear()
        return another


class InputHealth:
    """Counts samples between reports, and in total."""

    def __init__(self, clock: SampleClock, publisher: FollowedPublisher, now_s: float) -> None:
        """Counts from monotonic time `now_s` on; ages and lost samples are those of the others."""
        self._clock = clock
        self._publisher = publisher
        clock.largest_age_s = 0.0
        self._report_s = now_s
        self._last_arrival_s = self._report_s
        self._received = False
        self._last_problem = ""
        self._arrived = 0
        self._total_missing = 0
        self._total_refused = 0
        self._refused: Counter[ProblemKind] = Counter()

    def arrived(self, now_s: float) -> None:
        """Count a message, whatever its content."""
        self._arrived += 1
        self._received = True
        self._last_arrival_s = now_s

    def refused(self, problem: SampleError) -> None:
        """Count a sample that could not be used."""
        self._refused[problem.kind] += 1
        self._total_refused += 1
        self._last_problem = str(problem)

    def silence_s(self, now_s: float) -> float:
        """Time since the last message, or since the start before the first."""
        return now_s - self._last_arrival_s

    def status(self, now_s: float, lost: int, publisher_count: int) -> Status:
        """The report since the last one.

        `lost` samples were reported by the middleware since then; `publisher_count` publishers are
        on the topic.
        """
        missing = max(lost, self._publisher.lost)
        self._publisher.lost = 0
        self._total_missing += missing
        rate = self._arrived / max(now_s - self._report_s, 1e-9)
        level, message = self._verdict(now_s, missing, publisher_count)
        values = {
            "rate (Hz)": f"{rate:.1f}",
            "largest age (s)": f"{self._clock.largest_age_s:.4f}",
            "dropped": str(missing),
            "dropped in all": str(self._total_missing),
            "refused": str(sum(self._refused.values())),
            "refused in all": str(self._total_refused),
            "publishers": str(publisher_count),
        }
        values |= {f"refused: {kind.value}": str(count) for kind, count in self._refused.items()}
        if self._last_problem:
            values["last refusal"] = self._last_problem
        self._report_s = now_s
        self._arrived = 0
        self._clock.largest_age_s = 0.0
        self._refused.clear()
        return Status("cable_tensions", level, message, values)

    def _verdict(self, now_s: float, missing: int, publisher_count: int) -> tuple[Level, str]:
        silence = self.silence_s(now_s)
        if not self._received:
            return Level.STALE, "no sample received yet"
        if silence > self._clock.stale_after_s:
            return Level.STALE, f"no sample for {silence:.1f} s"
        others = f"{publisher_count} publishers; one arm has one, and one is used"
        if publisher_count > 1 and self._refused[ProblemKind.PUBLISHER]:
            return Level.ERROR, others
        if self._refused:
            kinds = ", ".join(f"{count} {kind.value}" for kind, count in self._refused.items())
            return Level.ERROR, f"samples refused: {kinds}"
        if publisher_count > 1:
            silent = "the others are silent (one that was killed is counted for 5 s)"
            return Level.WARN, f"{others}; {silent}"
        if missing:
            lost = f"{missing} sample{'s' if missing != 1 else ''} lost"
            return Level.WARN, f"{lost} on the way, as on a busy machine; the others are used"
        return Level.OK, "receiving"
