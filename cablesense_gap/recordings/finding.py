"""What is wrong with a recording, and how bad that is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from cablesense_gap.recordings.recording_error import RecordingError


class Severity(StrEnum):
    """Whether a recording can still be used."""

    WARN = "warn"
    REFUSE = "refuse"


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        severity: whether it rules the recording out.
        kind: one word for programs, such as `time` or `swapped`.
        text: what, where (rows from 1, columns by name) and what would be right.
    """

    severity: Severity
    kind: str
    text: str


@dataclass(frozen=True)
class RecordingReport:
    """All that was found in a recording, the worst first."""

    name: str
    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether nothing rules it out."""
        return all(finding.severity is not Severity.REFUSE for finding in self.findings)

    def of_kind(self, kind: str) -> tuple[Finding, ...]:
        """The findings of a kind."""
        return tuple(finding for finding in self.findings if finding.kind == kind)

    def raise_if_unusable(self) -> None:
        """Nothing, where the recording can be used.

        Raises:
            RecordingError: the first reason that rules it out, and how many more there are.
        """
        refusals = [f.text for f in self.findings if f.severity is Severity.REFUSE]
        if refusals:
            more = f" (and {len(refusals) - 1} more)" if len(refusals) > 1 else ""
            raise RecordingError(f"{self.name}: {refusals[0]}{more}")


def refuse(kind: str, text: str) -> Finding:
    """A finding that rules the recording out."""
    return Finding(Severity.REFUSE, kind, text)


def warn(kind: str, text: str) -> Finding:
    """A finding to know of."""
    return Finding(Severity.WARN, kind, text)
