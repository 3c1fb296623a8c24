"""Models that remember go through what a journal tells, and so come to the same past."""

from __future__ import annotations

import numpy as np

from cablesense_msgs_py.journal import EventKind, JournalEntry
from cablesense_ros.answering import Answers

TARES = frozenset({EventKind.TARE, EventKind.AUTO_TARE, EventKind.TARE_UNDO})


class JournalFollower:
    """Tells the events of one entry after the other to what answers."""

    def __init__(self, answers: Answers) -> None:
        self._answers = answers
        self._started = False

    @property
    def vouches(self) -> bool:
        """Whether what answers has the past that the journal speaks of.

        A model with memory has one from a start on.
        """
        return self._started or not self._answers.in_motion

    def follow(self, entry: JournalEntry) -> None:
        """Let what answers be where the entry was made, from its own past where it has one.

        Raises:
            CableSenseError: a command of the entry is of a pose that this arm cannot take.
        """
        if not self._started:
            self._answers.restore(np.array(entry.command_rad))
        for event in entry.events:
            if event.kind is EventKind.START and event.command_rad:
                self._answers.restore(np.array(event.command_rad))
            elif event.kind is EventKind.COMMAND:
                self._answers.command(np.array(event.command_rad))
            elif event.kind in TARES:
                self._answers.begin()
            self._started |= event.kind is EventKind.START
