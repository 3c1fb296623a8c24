"""What answers goes through the events of a journal in their order."""

import pytest

from cablesense_msgs_py.journal import Event, EventKind, JournalEntry
from cablesense_online.journal import JournalFollower

HERE, THERE = (0.0,) * 8, (0.1,) * 8


class Told:
    """Stands in for what answers, and notes what it is told."""

    def __init__(self, in_motion=True):
        self.in_motion, self.told = in_motion, []

    def command(self, command_rad):
        self.told.append(("command", tuple(command_rad)))

    def restore(self, command_rad):
        self.told.append(("restore", tuple(command_rad)))

    def begin(self):
        self.told.append("begin")


def entry(*events):
    return JournalEntry(
        before_ns=1,
        events=events,
        arm="any",
        settings={},
        command_rad=THERE,
        lowest_rad=HERE,
        highest_rad=THERE,
        rest_from_ns=0,
    )


def test_events_are_gone_through_in_order_from_the_start_on():
    answers = Told()
    JournalFollower(answers).follow(
        entry(
            Event(EventKind.START, HERE),
            Event(EventKind.SETTINGS),
            Event(EventKind.COMMAND, THERE),
            Event(EventKind.CLOCK),
            Event(EventKind.TARE),
        )
    )
    assert answers.told == [("restore", THERE), ("restore", HERE), ("command", THERE), "begin"]


@pytest.mark.parametrize("kind", [EventKind.TARE, EventKind.AUTO_TARE, EventKind.TARE_UNDO])
def test_every_change_of_the_tare_begins_anew(kind):
    answers = Told()
    JournalFollower(answers).follow(entry(Event(kind)))
    assert answers.told == [("restore", THERE), "begin"]


def test_once_started_the_past_is_kept_from_entry_to_entry():
    answers = Told()
    follower = JournalFollower(answers)
    follower.follow(entry(Event(EventKind.START, HERE)))
    answers.told.clear()
    follower.follow(entry(Event(EventKind.COMMAND, THERE)))
    assert answers.told == [("command", THERE)]


def test_without_a_start_a_memory_has_no_past_that_it_can_vouch_for():
    follower = JournalFollower(Told())
    follower.follow(entry(Event(EventKind.TARE)))
    assert not follower.vouches
    follower.follow(entry(Event(EventKind.START, HERE)))
    assert follower.vouches


def test_what_remembers_nothing_vouches_from_any_entry_on():
    assert JournalFollower(Told(in_motion=False)).vouches
