"""The gap between a recorded arm and the simulated one: what causes it, where, how far it shrinks.

What a program that uses the diagnosis needs stands here by short names::

    from cablesense_gap import diagnose, read_recording
    from cablesense_sim import open_arm

    arm = open_arm("cdsm_lab")
    found = diagnose(read_recording("recording.csv", arm), arm)
    print(found.verdict.effects, found.verdict.probability)

A name is imported when it is first used, so that `import cablesense_gap` itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablesense_gap.pipeline import Diagnosis as Diagnosis
    from cablesense_gap.pipeline import diagnose as diagnose
    from cablesense_gap.recordings.checks import read_recording as read_recording
    from cablesense_gap.recordings.recording import Recording as Recording
    from cablesense_gap.report.page import write_diagnosis as write_diagnosis
    from cablesense_gap.simulator import Candidate as Candidate
    from cablesense_gap.simulator import Simulator as Simulator
    from cablesense_gap.simulator import Term as Term
    from cablesense_gap.verdict import Verdict as Verdict
    from cablesense_gap.verdict import read_verdict as read_verdict

_MODULES = {
    "pipeline": ("Diagnosis", "diagnose"),
    "recordings.checks": ("read_recording",),
    "recordings.recording": ("Recording",),
    "report.page": ("write_diagnosis",),
    "simulator": ("Candidate", "Simulator", "Term"),
    "verdict": ("Verdict", "read_verdict"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
