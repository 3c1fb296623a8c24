"""An independent plant: the "real arm" that the diagnosis is tried on without knowing it.

It shares no code and no solver with the simulator or with the diagnosis, and has its own forms of
the effects. Nothing of the diagnosis may import it.
"""

from cablesense_gap.plant.body import Nominal, PlantError, read_nominal
from cablesense_gap.plant.case import (
    Answer,
    Case,
    CaseRecording,
    draw_case,
    draw_kinds,
    record_case,
)

__all__ = [
    "Answer",
    "Case",
    "CaseRecording",
    "Nominal",
    "PlantError",
    "draw_case",
    "draw_kinds",
    "read_nominal",
    "record_case",
]
