"""What an estimator's answers rest on, kept in a file: one that was killed goes on from there.

Without it an estimator that comes back beside a loaded arm would take the load for the unloaded
state (`auto_tare`), and be blind to it from then on.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from cablesense_msgs_py.bounded_file import read_bounded_text
from cablesense_msgs_py.errors import CableSenseError
from cablesense_msgs_py.journal import MOST_NUMBERS, JournalEntry

FORMAT: Final = "cablesense estimator state 1"
MAX_BYTES: Final = 200_000
SIGN_OF_LIFE_S: Final = 1.0
"""So often the file's time is renewed: it says when its estimator was last alive."""

_BEYOND: Final = 1e9
"""No angle in rad and no tension in N is so large; whole numbers may, and be no float."""

_NUMBERS: Final = (
    "command_rad",
    "lowest_rad",
    "highest_rad",
    "unloaded_n",
    "tared_n",
    "tare_command_rad",
)


class StateFileError(CableSenseError):
    """A state file that cannot be gone on from, or not be written: says why."""


class StateFile:
    """The latest journal entry of one estimator in a file.

    An entry is kept in memory and written by the next `flush`, so that no sample waits for a disk.
    """

    def __init__(
        self, path: str | Path, within_s: float, now_s: Callable[[], float] = time.time
    ) -> None:
        """`path` empty keeps nothing; a state older than `within_s` is not gone on from."""
        self._path = Path(path) if str(path) else None
        self._within_s = within_s
        self._now_s = now_s
        self._pending: JournalEntry | None = None
        self._kept = False
        self._alive_s = float("-inf")

    def read(self, arm_identity: str) -> JournalEntry | None:
        """The state of an estimator of the same arm that was alive a moment ago; None without one.

        Raises:
            StateFileError: there is a file, and it cannot be gone on from.
        """
        if self._path is None or not self._path.exists():
            return None
        age_s = self._now_s() - self._path.stat().st_mtime
        if not -self._within_s <= age_s <= self._within_s:
            raise StateFileError(
                f"{self._path}: its estimator was last alive {age_s:.0f} s ago, and at most "
                f"{self._within_s:g} s is gone on from"
            )
        entry = _entry(read_bounded_text(self._path, MAX_BYTES, "a state file", StateFileError))
        if entry is None:
            raise StateFileError(f"{self._path}: is no state of an estimator ({FORMAT})")
        if entry.arm != arm_identity:
            raise StateFileError(
                f"{self._path}: is of arm {entry.arm[:80]!r}; this is {arm_identity}"
            )
        if not entry.tared_n:
            raise StateFileError(f"{self._path}: its estimator had no tare")
        self._kept = True
        return entry

    def keep(self, entry: JournalEntry) -> None:
        """Take note of what answers rest on from now on."""
        self._pending = entry

    def flush(self) -> None:
        """Write what was noted, or renew the file's time.

        Raises:
            StateFileError: it cannot be written.
        """
        if self._path is None:
            return
        now_s = self._now_s()
        try:
            if self._pending is not None:
                _write(self._path, self._pending)
                self._pending, self._kept, self._alive_s = None, True, now_s
            elif self._kept and not 0.0 <= now_s - self._alive_s < SIGN_OF_LIFE_S:
                self._alive_s = now_s
                os.utime(self._path)
        except OSError as error:
            raise StateFileError(
                f"{self._path}: cannot be written ({error.strerror or error})"
            ) from error


def _write(path: Path, entry: JournalEntry) -> None:
    values = asdict(entry)
    del values["events"]
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        beside.write_text(json.dumps({"format": FORMAT, **values}, indent=1), encoding="utf-8")
        beside.replace(path)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        raise


def _entry(text: str) -> JournalEntry | None:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(values, Mapping) or values.get("format") != FORMAT:
        return None
    numbers = {name: _numbers(values.get(name)) for name in _NUMBERS}
    arm, before_ns, rest_from_ns = (
        values.get(name) for name in ("arm", "before_ns", "rest_from_ns")
    )
    if None in numbers.values() or not (
        isinstance(arm, str) and isinstance(before_ns, int) and isinstance(rest_from_ns, int)
    ):
        return None
    return JournalEntry(
        before_ns=before_ns,
        events=(),
        arm=arm,
        settings={},
        rest_from_ns=rest_from_ns,
        **numbers,  # type: ignore[arg-type]  # none is None
    )


def _numbers(given: Any) -> tuple[float, ...] | None:
    if not isinstance(given, list) or len(given) > MOST_NUMBERS:
        return None
    if not all(type(one) in (int, float) and abs(one) < _BEYOND for one in given):
        return None
    return tuple(float(one) for one in given)
