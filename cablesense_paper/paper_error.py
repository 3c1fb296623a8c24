"""The errors of a reproduction of the paper."""

from __future__ import annotations

from cablesense_msgs_py.errors import CableSenseError


class PaperError(CableSenseError):
    """What cannot be reproduced: no such study, or no place for the report."""


class FailedStudyError(PaperError):
    """Studies have failed; the others ran, and the report is there."""

    exit_code = 1
