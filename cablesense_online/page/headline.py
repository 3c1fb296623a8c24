"""The sentence at the head of the page, and what machines and links are called in sentences."""

from __future__ import annotations

from dataclasses import dataclass

from cablesense_msgs_py.messages import Contact, ForceState
from cablesense_online.page.snapshot import ForceBounds

_HEADLINES = {
    ForceState.FREE: "No contact",
    ForceState.CONTACT: "Contact",
    ForceState.MOMENT: "Contact",
    ForceState.UNCONFIRMED: "Unconfirmed contact",
    ForceState.HIDDEN: "No contact seen",
    ForceState.MOVING: "Moving: no estimate",
    ForceState.UNTARED: "Not tared: no estimate",
    ForceState.REFUSED: "Readings refused: no estimate",
    ForceState.IMPLAUSIBLE: "Readings fit no contact: no estimate",
    ForceState.STALE: "Readings are out of date: no estimate",
    ForceState.SILENT: "The estimator is silent",
}


@dataclass(frozen=True)
class Words:
    """What a machine and its links are called.

    Attributes:
        machine: `arm` or `machine`.
        link: `segment` or `link`.
        links: (N,) of each: its number, or its name.
    """

    machine: str
    link: str
    links: tuple[str, ...]

    def of_link(self, number: int) -> str:
        """`segment 3`, or the name of the link alone; `number` counts from 1."""
        label = self.links[number - 1]
        return f"{self.link} {label}" if label.isdecimal() else label


def headline(
    state: ForceState,
    estimated: tuple[Contact, ...],
    bounds: ForceBounds | None,
    moment: Contact | None,
    words: Words,
) -> str:
    """One sentence for the head of the page."""
    text = _HEADLINES[state]
    if moment is not None:
        text += f" on {words.of_link(moment.segment)}: moment {moment.moment_n_m:.1f} N·m known"
        if bounds is not None:
            text += f", force between {bounds.low_n:.0f} and {bounds.high_n:.0f} N"
    elif len(estimated) == 1:
        text += f" on {words.of_link(estimated[0].segment)}"
    elif estimated:
        numbers = sorted(contact.segment for contact in estimated)
        labels = " and ".join(words.links[number - 1] for number in numbers)
        text += f" on {words.link}s {labels}"
    if state is ForceState.HIDDEN and bounds is not None:
        text += f"; up to {bounds.high_n:.1f} N may act"
    return text
