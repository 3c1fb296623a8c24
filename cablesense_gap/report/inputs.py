"""All that a report is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.verdict import UNKNOWN, Verdict
from cablesense_sim.arm import Arm


@dataclass(frozen=True)
class ReportInputs:
    """A recording, what two arms predict for it, and the verdict.

    Attributes:
        recording: R rows of M cables.
        arm: the nominal arm.
        verdict: on the recording.
        predicted_before_n: (R, M) tensions of the nominal arm.
        predicted_after_n: (R, M) tensions of the amended arm.
        held_out_n: (R, M) tensions of the amended arm, each trial predicted by a fit that has not
            seen it; NaN where there is none. Pictures show these where they are given.
        findings: what the checks of the recording found, as sentences.
        amended_file: name of the amended arm file beside the report.
    """

    recording: Recording
    arm: Arm
    verdict: Verdict
    predicted_before_n: Array
    predicted_after_n: Array
    held_out_n: Array | None = None
    findings: tuple[str, ...] = ()
    amended_file: str = "arm.yaml"

    @property
    def after_label(self) -> str:
        """What pictures call the state after; empty where nothing was changed."""
        if np.allclose(self.before_n, self.after_n, equal_nan=True):
            return ""
        return "flexible correction" if self.verdict.effects == (UNKNOWN,) else "amended arm"

    @property
    def before_n(self) -> Array:
        """Residual (R, M) of the nominal arm, measured less predicted."""
        return self.recording.tensions_n - self.predicted_before_n

    @property
    def after_n(self) -> Array:
        """Residual (R, M) of the amended arm, on held-out trials where these are given."""
        predicted = self.predicted_after_n if self.held_out_n is None else self.held_out_n
        return self.recording.tensions_n - predicted
