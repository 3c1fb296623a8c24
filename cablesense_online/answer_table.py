"""Answers as rows of a table: what is stated of each sample, with its interval and its place."""

from __future__ import annotations

from typing import Final

from cablesense_online.answer import Answer
from cablesense_online.placed_links import PlacedLinks

ANSWER_COLUMNS: Final = (
    "state",
    "segment",
    "angle_deg",
    "magnitude_n",
    "magnitude_low_n",
    "magnitude_high_n",
    "force_x_n",
    "force_y_n",
    "force_z_n",
    "place_m",
    "place_low_m",
    "place_high_m",
)
"""Angle, force and place of the stated contact are empty without one. The ends of the force's 95 %
interval are empty without an estimate; without a contact the upper one may act unseen. `force_…`
are the stated force along the axes of the segment's frame, or of the link's body, as in the
wrench. They are empty, as is the force, where the moment alone is known, and, as is the angle, of
networks that give no direction."""
NO_CELL = ""


def answer_cells(answer: Answer, links: PlacedLinks) -> list[object]:
    """The cells of `ANSWER_COLUMNS` for one answer; `segment` is 0 without a contact."""
    contact = answer.contact
    bounds = answer.bounds
    region_m = answer.region_m
    has_direction = bool(contact.segment) and answer.estimate is not None
    has_force = contact.magnitude_n > 0.0
    angle_deg: object = contact.angle_deg if has_direction else NO_CELL
    magnitude_n: object = contact.magnitude_n if has_force else NO_CELL
    ends: list[object] = [NO_CELL, NO_CELL]
    if bounds is not None:
        ends = [bounds[0].magnitude_n, bounds[1].magnitude_n]
    force: list[object] = [NO_CELL, NO_CELL, NO_CELL]
    if has_direction and has_force:
        force = [*links.wrench(contact.segment, contact.wrench)[:3]]
    place: list[object] = [NO_CELL, NO_CELL, NO_CELL]
    if contact.segment:
        low_m, high_m = region_m or (NO_CELL, NO_CELL)
        place = [contact.contact_m, low_m, high_m]
    stated: list[object] = [angle_deg, magnitude_n, *ends, *force, *place]
    return [answer.force.value, contact.segment, *stated]
