"""Progress is drawn on a terminal, and nothing of it elsewhere."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from cablesense_base.progress import (
    duration_text,
    error_console,
    progress_bar,
    staged_progress,
    status,
    task_bars,
)

STAGES = (("looking", 0.75), ("finding", 1.0))


def console(*, terminal: bool = True) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=120)


def text_of(shown_on: Console) -> str:
    assert isinstance(shown_on.file, io.StringIO)
    return shown_on.file.getvalue()


def test_it_goes_to_standard_error() -> None:
    assert error_console().stderr


def test_a_bar_counts_what_is_done() -> None:
    terminal = console()
    with progress_bar(4, what="rows", console=terminal) as advance:
        for _ in range(4):
            advance(1, "going well")
    assert "rows" in text_of(terminal)
    assert "4/4" in text_of(terminal)
    assert "going well" in text_of(terminal)


def test_no_bar_is_drawn_into_a_file_or_where_none_is_wanted() -> None:
    file = console(terminal=False)
    with progress_bar(4, console=file) as advance:
        advance(4)
    terminal = console()
    with progress_bar(4, shown=False, console=terminal) as advance:
        advance(4)
    with status("thinking", console=file) as say:
        say("still thinking")
    assert text_of(file) == text_of(terminal) == ""


def test_each_task_has_a_bar() -> None:
    terminal = console()
    with task_bars(console=terminal) as bars:
        for name in ("first", "second"):
            bars.begin(name)(1.0)
    assert "first" in text_of(terminal)
    assert "second" in text_of(terminal)


def test_every_stage_has_a_bar_of_its_own_and_none_states_a_time_left() -> None:
    terminal = console()
    with staged_progress(STAGES, console=terminal) as progress:
        progress.show("reading the file", 0.0)
        progress.announce(185.0)
        for done in (0.1, 0.5, 0.8, 1.0):
            progress.show("payload + sensor_gain", done)
    text = text_of(terminal)
    assert "This takes about 3 min." in text
    for name, _ in STAGES:
        assert name in text
    assert "left" not in text


def test_what_stages_say_is_in_a_file_too_without_their_bars() -> None:
    file = console(terminal=False)
    with staged_progress(STAGES, console=file) as progress:
        progress.announce(34.0)
        progress.warn("a row is odd")
        progress.show("payload", 0.5)
    assert text_of(file) == "This takes about 30 s.\nwarning: a row is odd\n"


@pytest.mark.parametrize(
    ("seconds", "text"), [(3.0, "10 s"), (34.0, "30 s"), (130.0, "2 min"), (1800.0, "30 min")]
)
def test_a_time_has_the_digits_that_are_known(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text
