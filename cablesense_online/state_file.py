"""A JSON file that keeps the estimator's latest state, so that one that was killed keeps its tare.

Without the file, one that restarts next to a loaded arm would have no tare until the load is taken
away.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from cablesense_base import CableSenseError
from cablesense_base.files import read_bounded_text, write_atomically
from cablesense_msgs_py.messages import Level, Status
from cablesense_msgs_py.topics import ContractError
from cablesense_online.state import EstimatorState, validated_state

FORMAT: Final = "cablesense estimator state 2"
MAX_BYTES: Final = 200_000
ALIVE_PERIOD_S: Final = 1.0
"""The file's time is renewed this often; it shows when its estimator was last alive."""


class StateFileError(CableSenseError):
    """A state file that cannot be continued from, or cannot be written."""


class StateFile:
    """The latest state of one estimator in a file.

    A state is kept in memory and written by the next `flush`, so that no sample waits for a disk.
    """

    def __init__(
        self, path: str | Path, within_s: float, now_s: Callable[[], float] = time.time
    ) -> None:
        """An empty `path` keeps nothing; a state older than `within_s` is refused."""
        self._path = Path(path) if str(path) else None
        self._within_s, self._now_s = within_s, now_s
        self._state: EstimatorState | None = None
        self._written = self._ours = False
        self._tried_s = float("-inf")
        self._problem = ""

    def read(self, arm_identity: str) -> EstimatorState | None:
        """The state of an estimator of the same arm that was alive a moment ago; None without one.

        Raises:
            StateFileError: there is a file, and it cannot be continued from.
        """
        if self._path is None:
            return None
        try:
            age_s = self._now_s() - self._path.stat().st_mtime
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise StateFileError(f"{self._path}: cannot be read ({error})") from error
        if abs(age_s) > self._within_s:
            raise StateFileError(
                f"{self._path}: its estimator was last alive {age_s:.0f} s ago; at most "
                f"{self._within_s:g} s is accepted"
            )
        text = read_bounded_text(self._path, MAX_BYTES, "a state file", StateFileError)
        try:
            values = json.loads(text)
            if not isinstance(values, dict) or values.pop("format", None) != FORMAT:
                raise ContractError(f"its format is not {FORMAT}")
            state = validated_state(values)
        except (ContractError, ValueError, RecursionError) as error:
            raise StateFileError(f"{self._path}: is no state of an estimator: {error}") from error
        if state.arm != arm_identity:
            raise StateFileError(
                f"{self._path}: is of arm {state.arm[:80]!r}; this is {arm_identity}"
            )
        if state.tare.tare is None:
            raise StateFileError(f"{self._path}: its estimator had no tare")
        self._state, self._written, self._ours = state, True, True
        return state

    def keep(self, state: EstimatorState) -> None:
        """Take over the state that answers rest on from now on."""
        self._state, self._written = state, False

    def flush(self) -> None:
        """Write the state that was kept, or renew the file's time.

        If that fails the file is removed, as its state is outdated, and the write is tried again
        every `ALIVE_PERIOD_S`.

        Raises:
            StateFileError: it cannot be written.
        """
        now_s = self._now_s()
        recently = 0.0 <= now_s - self._tried_s < ALIVE_PERIOD_S
        done = self._written or bool(self._problem)
        if self._path is None or self._state is None or (recently and done):
            return
        self._tried_s = now_s
        try:
            if self._written:
                os.utime(self._path)
            else:
                values = self._state.model_dump(mode="json", exclude={"events"})
                text = json.dumps({"format": FORMAT, **values}, indent=1)
                write_atomically(self._path, text, StateFileError)
        except (OSError, StateFileError) as error:
            cause = error if isinstance(error, StateFileError) else f"{self._path}: {error}"
            self._written = False
            self._problem = f"{cause}; {self._removed(self._path)}"
            raise StateFileError(self._problem) from error
        self._written, self._ours, self._problem = True, True, ""

    def _removed(self, path: Path) -> str:
        """Leave no outdated state in the file; gives the consequence for a restart, as text."""
        try:
            if self._ours:
                path.unlink(missing_ok=True)
        except OSError:
            return "an earlier state stays in it: delete it before an estimator is started again"
        self._ours = False
        return "until it is, an estimator that is started again begins without tare"

    def status(self) -> Status | None:
        """Whether the present state is in the file; None where no file is wanted."""
        if self._path is None:
            return None
        if self._problem:
            return Status("state file", Level.ERROR, f"the state is not kept: {self._problem}")
        return Status("state file", Level.OK, f"the state is kept in {self._path}")
