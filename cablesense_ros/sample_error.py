"""Why a tension sample is of no use; no force is ever estimated from such a one."""

from __future__ import annotations

from enum import Enum

from cablesense_msgs_py.errors import CableSenseError


class ProblemKind(Enum):
    """What is wrong with a sample; the value is what diagnostics call it."""

    MALFORMED = "malformed"
    CLOCK = "stale or from another clock"
    NAMES = "wrong names or length"
    NOT_FINITE = "not finite"
    SATURATED = "saturated"
    IMPLAUSIBLE = "implausible"
    ESTIMATE = "no finite estimate"


class SampleError(CableSenseError):
    """A sample of no use: its kind, and a sentence on what it holds and what would be right."""

    def __init__(self, kind: ProblemKind, message: str) -> None:
        super().__init__(message)
        self.kind = kind
