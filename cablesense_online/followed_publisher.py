"""One publisher of samples is followed, so that those of two are never mixed."""

from __future__ import annotations

from collections import deque
from typing import Final

from cablesense_online.samples import ProblemKind, SampleError

_UNNUMBERED: Final = 2**64 - 1
"""In place of a number where the middleware gives none."""
_MOST_LOST: Final = 1000
"""Samples in turn that may be lost; a larger step of the number is of another publisher."""
_OTHERS_KEPT = 16
"""Latest numbers of other publishers by which theirs are told apart."""


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
