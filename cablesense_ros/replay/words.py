"""A comparison in words, for people."""

from __future__ import annotations

from cablesense_ros.replay.comparison import Comparison


def comparison_lines(comparison: Comparison, cut: str) -> list[str]:
    """One line for each count that is not zero, the verdict, and the first difference.

    Args:
        comparison: the counts.
        cut: where the file breaks off, in words; empty if it is whole.
    """
    counted = {
        "samples recorded": comparison.samples,
        "not answered when recorded (no estimator, or refused by their stamp)": (
            comparison.unanswered
        ),
        "answered before the journal tells enough, so not compared": comparison.before_journal,
        "samples without a stamp, so not compared": comparison.unstamped,
        "contacts reported whose sample the recording lacks": comparison.lone_contacts,
        "zero wrenches of the estimator in a silence": comparison.lone_zeros,
        "compared": comparison.compared,
        "of these contacts": comparison.contacts,
        "bit-identical": comparison.identical,
    }
    always = ("samples recorded", "compared", "bit-identical")
    lines = [f"the file {cut}"] if cut else []
    lines += [
        f"{count:>10,}  {what}" for what, count in counted.items() if count or what in always
    ]
    if comparison.first_difference:
        lines.append(f"first difference: {comparison.first_difference}")
    return lines
