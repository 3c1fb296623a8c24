"""Where commands begin in a bag: rows before the first are left out, as their pose is unknown."""

from __future__ import annotations

_FRESH_INTERVALS = 2.0
"""A first command that comes later than so many intervals of commands was not streamed before."""


class FirstCommand:
    """Takes when readings and commands came, ns, in the order they came.

    Attributes:
        rows_before: readings before the first command.
    """

    def __init__(self, command_topic: str) -> None:
        self.rows_before = 0
        self._command_topic = command_topic
        self._reading_ns: int | None = None
        self._commands_ns: list[int] = []

    def reading(self, log_ns: int) -> None:
        """A reading came."""
        if self._reading_ns is None:
            self._reading_ns = log_ns
        if not self._commands_ns:
            self.rows_before += 1

    def command(self, log_ns: int) -> None:
        """A command came."""
        if len(self._commands_ns) < 2:
            self._commands_ns.append(log_ns)

    @property
    def comes_inside(self) -> bool:
        """Whether it was given during the recording: the machine may be on its way to it.

        One of a stream that the recording only cuts into comes within about an interval of it.
        """
        if self._reading_ns is None or not self.rows_before:
            return False
        if len(self._commands_ns) < 2:
            return True
        first_ns, second_ns = self._commands_ns
        return first_ns - self._reading_ns > _FRESH_INTERVALS * (second_ns - first_ns)

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence where rows are left out."""
        if not self.rows_before:
            return ()
        rows = "1 row" if self.rows_before == 1 else f"{self.rows_before:,} rows"
        return (
            f"Left out: {rows} before the first message on {self._command_topic}, as the pose is "
            "not known.",
        )
