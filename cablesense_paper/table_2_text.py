"""The finding on Table II in sentences, with every figure worked out anew.

The pictures of the gap of Table II, drawn in the style of the reports.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import (
    AFTER,
    BEFORE,
    GRID,
    INK,
    OTHER,
    WIDTH_IN,
    listed,
    newtons,
    percent,
)
from cablesense_gap.verdict import NONE, UNKNOWN
from cablesense_paper.table_2_gap import KINDS, PRIOR_UNLISTED, STEP_N, Findings
from cablesense_paper.tension_changes import Explained, OneNumber
from cablesense_sim.effects.registry import known_effects
from cablesense_training.evaluation.table2 import STANDARD_GRAVITY_M_S2

ALIKE = 1.05
"""Numbers that leave this much more than the best are called no worse."""

SLACK_ROW, SLACK_SET, SLACK_CABLE = 5, slice(3, 6), 5
"""2 kg on segment 3, the cables that end on segment 2, cable 6."""


class Share(NamedTuple):
    """A part of the gap: what it is, and its share of the squares."""

    what: str
    share: float


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt((np.asarray(values) ** 2).mean()))


def loads(found: Findings) -> list[str]:
    """The rows by name."""
    kg = -found.changes.load_n[:, 2] / STANDARD_GRAVITY_M_S2
    segments = found.changes.load_segment
    return [f"{m:.0f} kg on segment {n}" for m, n in zip(kg, segments, strict=True)]


def shares(found: Findings) -> list[Share]:
    """The gap in parts that add up."""
    whole = (found.gap_n**2).sum()
    inner = found.internal_n**2
    last, row = inner[:, 6:].sum(), inner[SLACK_ROW, SLACK_SET].sum()
    parts = [
        ("cables 7 to 9 all tighter, the more where segment 1 or 2 is loaded", last),
        ("cables 4 to 6 all tighter, under 2 kg on segment 3 alone", row),
        ("the other internal forces", inner.sum() - last - row),
        ("moments, most of it too large a pull at joint 1", whole - inner.sum()),
    ]
    return [Share(what, float(part / whole)) for what, part in parts]


def disproportion_n(found: Findings) -> Array:
    """(3, 9) rows with 2 kg less twice those with 1 kg."""
    measured = found.changes.changes_n
    return measured[3:] - 2.0 * measured[:3]


def number_name(number: OneNumber) -> str:
    """As in `sensor gain of cable 1`."""
    effect = number.effect.replace("_", " ")
    if len(number.terms) > 1:
        return "one gain of all sensors, or a load heavier than believed"
    (term,) = number.terms
    place = term.place.replace("_", " ")
    several = number.effect == "routing_geometry"
    what = f"{effect}, {term.parameter.rsplit('_', 1)[0].replace('_', ' ')}" if several else effect
    return what if place == "arm" else f"{what}, {place}"


def value_of(explained: Explained) -> str:
    """The fitted value with its unit, as far as the name has it."""
    value, name = explained.value, explained.number.terms[0].parameter
    if name in ("gain", "share", "change"):
        return f"{100 * value:+.1f} %"
    for end, scale, unit in (
        ("_n_m", 1.0, "N·m"), ("_m", 1e3, "mm"), ("_rad", 57.2958, "°"),
        ("_n", 1.0, "N"), ("_kg", 1.0, "kg"),
    ):  # fmt: skip
        if name.endswith(end):
            return f"{scale * value:+.3g} {unit}"
    return f"{value:.3g}"


def ranked_singles(found: Findings) -> list[Explained]:
    """All numbers, the best first; among equals that of the effect with fewer places to choose."""
    tried = Counter(s.number.effect for s in found.judged.singles)
    return sorted(
        found.judged.singles,
        key=lambda s: (round(s.held_out_rmse, 2), tried[s.number.effect]),
    )


def no_worse(found: Findings) -> list[str]:
    """Numbers that cannot be told from the best."""
    ranked = ranked_singles(found)
    limit = ALIKE * ranked[0].held_out_rmse
    near = [s for s in ranked if s.held_out_rmse <= limit]
    return list(dict.fromkeys(f"{number_name(s.number)} ({value_of(s)})" for s in near))


def reasons(found: Findings) -> tuple[str, ...]:
    """Why the verdict is what it is."""
    gap, floor = rms(found.gap_n), found.floor_n
    inner = rms(found.internal_n) ** 2 / gap**2
    best = ranked_singles(found)[0]
    tip = [f"{value:+.2f}" for value in found.changes.changes_n[0, 6:]]
    several = sorted(found.judged.hypotheses, key=lambda h: h.held_out_rmse)
    single = next((h for h in several if len(h.effects) == 1), None)
    pair = next((h for h in several if len(h.effects) == 2), None)
    sentences = [
        f"The gap is {newtons(gap)}, at most {newtons(float(np.abs(found.gap_n).max()))}: "
        f"{gap / floor:.0f} times the {newtons(floor)} that noise and the step of {STEP_N} N "
        "leave of a change.",
        f"{percent(inner)} of its squares carry no moment: all cables of a segment grow tighter "
        "or slacker by the same. On taut cables no load, contact point, mass, joint or stiffness "
        "does that; sensors, friction along cables, misplaced holes and slack cables can. "
        f"Clearest: 1 kg on segment 1 pulls cables 7 to 9 by {listed(tip)} N, and springs of "
        "whatever stiffness that run parallel to the arm would feel nothing.",
        f"Of one number of a listed effect, the best is {number_name(best.number)} "
        f"({value_of(best)}): it leaves {newtons(best.held_out_rmse)} of rows that it was not "
        f"fitted to. No worse, and so not told apart: {listed(no_worse(found)[1:])}.",
    ]
    for how_many, hypothesis in (("one effect", single), ("two effects at once", pair)):
        if hypothesis is not None:
            names = listed([effect.replace("_", " ") for effect in hypothesis.effects])
            sentences.append(
                f"Of {how_many} with all numbers, the best is {names} "
                f"({len(hypothesis.values)} numbers): it leaves "
                f"{newtons(hypothesis.held_out_rmse)}."
            )
    if pair is None:
        sentences.append("No two effects at once leave clearly less than one of them alone.")
    return (*sentences, rehearsed(found), blindness(found))


def rehearsed(found: Findings) -> str:
    """Where the probability comes from."""
    r = found.rehearsal
    return (
        "Probability: fitted to all rows, which is the kinder measure, the best listed effects, "
        f"one or two, leave {percent(found.judged.least_left)} of the gap. Of {r.count} simulated "
        f"tables each, they left as much in {r.unexplained[KINDS[0]]} with one such "
        f"effect, in {r.unexplained[KINDS[1]]} with two, and in {r.unexplained[KINDS[2]]} with "
        f"something unlisted; {percent(PRIOR_UNLISTED)} of causes are taken to be unlisted "
        "beforehand. What is unlisted in these tables is any pattern in proportion to the load, "
        "so the probability holds as far as that is a fair guess. The calibration of "
        "recordings of the twelve-cable arm does not apply and was not used. Three or more listed "
        "effects at once were not tried: 54 numbers would fit them whether true or not."
    )


def blindness(found: Findings) -> str:
    """What the table cannot say anything about."""
    blind = [name.replace("_", " ") for name in found.blind]
    timed = [name.replace("_", " ") for name, e in known_effects().items() if e.needs_time]
    return (
        f"Not candidates: {listed(blind)}, which change no number here by more than the floor; "
        f"{listed(timed)}, which need times that the table does not state."
    )


def slack_cable(found: Findings) -> str:
    """The one departure from proportion, and what it looks like."""
    off = disproportion_n(found)
    there = off[SLACK_ROW - 3, SLACK_SET]
    others = np.delete(off.ravel(), [21, 22, 23])
    cable = found.changes.changes_n[SLACK_ROW, SLACK_CABLE]
    pretension = min(
        (s for s in found.judged.singles if s.number.terms[0].effect == "pretension_error"),
        key=lambda s: (s.number.terms[0].place != "arm", s.rmse),
    )
    return (
        f"Changes under 2 kg are twice those under 1 kg to {newtons(rms(others))} RMS, except for "
        f"cables 4 to 6 under 2 kg on segment 3: {listed([f'{v:+.2f}' for v in there])} N, nearly "
        f"the same. That is what follows when cable 6 goes slack and can give no more than its "
        f"{-cable:.2f} N. In the simulation that needs {value_of(pretension)} of pretension, and "
        f"leaves {newtons(pretension.rmse)} of all 54 numbers. It rests on one row, so no row "
        f"held out confirms it ({newtons(pretension.held_out_rmse)} left), and it is a lead and "
        "no verdict."
    )


def paper_rows(found: Findings) -> str:
    """How the paper's own simulation differs from this one."""
    apart = found.paper_n - found.nominal_n
    constant = apart.mean(0)
    paper_gap = found.changes.changes_n - found.paper_n
    numbers = ", ".join(f"{v:+.2f}" for v in constant)
    return (
        f"The paper's simulated rows differ from the physical ones by {newtons(rms(paper_gap))} "
        f"(largest {newtons(float(np.abs(paper_gap).max()))}), ours by "
        f"{newtons(rms(found.gap_n))} (largest {newtons(float(np.abs(found.gap_n).max()))}). "
        f"The two simulations differ by {newtons(rms(apart))}, but all of that except "
        f"{newtons(rms(apart - constant))} is the same whatever the load: {numbers} N on cables 1 "
        "to 9. Their slopes agree. The paper's changes seem to be taken from another unloaded "
        "state than that of the loads. In the physical rows such a constant would show as a "
        "departure from proportion, and ours come nearer to them."
    )


def resolution(found: Findings) -> str:
    """The step in the physical values."""
    steps = found.changes.changes_n / STEP_N
    off = float(np.abs(steps - np.round(steps)).max())
    return (
        f"All 54 physical values are whole multiples of {STEP_N} N to {off * STEP_N:.3f} N, which "
        "is the rounding of the table to two decimals. The step is the sensors' only visible "
        f"noise; a change of two readings has {newtons(STEP_N * np.sqrt(2 / 12))} of it."
    )


def next_experiment() -> str:
    """What to measure to learn more."""
    return (
        "Hang 0, 0.5, 1, 1.5 and 2 kg on each segment, up and down again, three times, with the "
        "raw readings at every step and not their changes, at two pretensions and with the arm "
        "turned about its axis by 90° and 180°. Up against down shows friction; turning moves the "
        "load from cable 1 to other cables, which parts its sensor from the holes; a cable that "
        "goes slack does so at a reading near zero; and where the tightening of cables 7 to 9 "
        "stays when their sensors are exchanged with others, it is in the arm."
    )


def worded(found: Findings) -> Findings:
    """Findings whose verdict says why, and what to measure next."""
    said = {"why": reasons(found), "next_experiment": next_experiment()}
    return replace(found, verdict=found.verdict.model_copy(update=said))


def best_listed_n(found: Findings) -> float:
    """What the best one or two listed effects leave of rows that they were not fitted to, N."""
    candidates = found.verdict.candidates
    return min(c.held_out_rmse_n for c in candidates if c.effects[0] not in (NONE, UNKNOWN))


def readme(found: Findings) -> str:
    """The finding in Markdown."""
    gap = found.verdict.gap
    cell = " | "
    names = loads(found)
    table = [
        f"| load | {cell.join(str(i + 1) for i in range(9))} | RMS |",
        "| --- |" + " ---: |" * 10,
        *(
            f"| {name} | {cell.join(f'{v:+.2f}' for v in row)} | {rms(row):.2f} |"
            for name, row in zip(names, found.gap_n, strict=True)
        ),
    ]
    return "\n".join(
        [
            "# The gap of Table II",
            "",
            f"Made by `{found.command}`; [report.html](report.html) has the pictures, "
            "[verdict.json](verdict.json) the figures.",
            "",
            f"**Verdict: unknown** ({percent(found.verdict.probability)}). The physical rows of "
            "Table II lie beside this project's simulation by "
            f"{newtons(gap.before_n)} (floor {newtons(gap.floor_n)}), and no effect of the "
            "library, alone or with a second one, removes more than "
            f"{percent(1 - best_listed_n(found) / gap.before_n)} of that on rows that it was not "
            "fitted to. "
            f"A law that is only proportional to the load, and knows no physics, leaves "
            f"{newtons(gap.after_n)} on the other load level: the larger part repeats, and it is "
            "not in the library.",
            "",
            "Measured less simulated change, N, by cable:",
            "",
            *table,
            "",
            "## Where it lies",
            "",
            "In shares of its squares:",
            "",
            *(f"- {percent(part.share)}: {part.what}" for part in shares(found)),
            "",
            f"The pull at joint 1 is {_moments(found, 0)} of the known load's, at joint 2 "
            f"{_moments(found, 1)}, at joint 3 {_moments(found, 2)}: no one scale of load or "
            "sensors.",
            "",
            slack_cable(found),
            "",
            "## What it is, as far as 54 numbers carry",
            "",
            *(f"- {sentence}" for sentence in reasons(found)),
            f"- {_folds(found)}",
            f"- {named_tables(found)}",
            "",
            resolution(found),
            "",
            "## The paper's own simulation",
            "",
            paper_rows(found),
            "",
            "## What to measure next",
            "",
            next_experiment(),
            "",
        ]
    )


def _moments(found: Findings, joint: int) -> str:
    there = found.moments[:, joint][~np.isnan(found.moments[:, joint])]
    return f"{100 * there.min():.0f} to {100 * there.max():.0f} %"


def _folds(found: Findings) -> str:
    left = found.any_single_n.items()
    kinds = listed([f"{newtons(size)} with {name} held out" for name, size in left])
    return f"With the number itself chosen on the rows that are fitted: {kinds}."


def named_tables(found: Findings) -> str:
    """How often a table of this size names its cause."""
    r = found.rehearsal
    return (
        f"Of {r.count} simulated tables with one listed effect, the number that leaves least on "
        f"held-out rows belonged to the true effect in {r.named}: a table like this can name a "
        "cause often, not always, and where it cannot, it takes one effect for another that acts "
        "on the same cables."
    )


SETS = ("cables 1 to 3", "cables 4 to 6", "cables 7 to 9")
COLOURS = (BEFORE, AFTER, "#009E73")


def gap_figure(found: Findings) -> Any:
    """Measured less simulated change of every cable, one panel a load, with its internal part."""
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        2, 3, figsize=(WIDTH_IN, 4.4), sharex=True, sharey=True, layout="constrained"
    )
    cables = np.arange(1, 10)
    colours = np.repeat(COLOURS, 3)
    for axes, name, gap, inner in zip(
        every.ravel(), loads(found), found.gap_n, found.internal_n, strict=True
    ):
        axes.bar(cables, gap, 0.72, color=colours)
        for k in range(3):
            axes.hlines(inner[3 * k], 3 * k + 0.5, 3 * k + 3.5, color=INK, lw=2.2)
        axes.axhline(0.0, color=INK, lw=0.7)
        axes.set_title(name)
        axes.set_xticks(cables)
        axes.grid(axis="y")
    figure.supxlabel("cable", fontsize=9.5)
    figure.supylabel("measured less simulated, N", fontsize=9.5)
    return figure


def proportion_figure(found: Findings) -> Any:
    """Gap under 2 kg against gap under 1 kg, beside the line of proportion."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.2), layout="constrained")
    one, two = found.gap_n[:3], found.gap_n[3:]
    along = np.array([one.min() - 0.2, one.max() + 0.2])
    band = 1.96 * np.sqrt(5.0) * found.floor_n  # of a difference between one number and two others
    axes.fill_between(along, 2.0 * along - band, 2.0 * along + band, color=GRID, lw=0)
    axes.plot(along, 2.0 * along, color=OTHER, lw=1.2)
    for k, (name, colour) in enumerate(zip(SETS, COLOURS, strict=True)):
        of_set = slice(3 * k, 3 * k + 3)
        for point, mark in enumerate("osD"):
            axes.scatter(
                one[point, of_set], two[point, of_set], s=36, color=colour, marker=mark, zorder=3,
                label=name if point == 0 else None,
            )  # fmt: skip
    for point, mark in enumerate("osD"):
        axes.scatter([], [], s=36, color=OTHER, marker=mark, label=f"load on segment {point + 1}")
    axes.set(xlabel="gap under 1 kg, N", ylabel="gap under 2 kg, N")
    axes.grid()
    figure.legend(loc="outside right center")
    return figure


def paper_figure(found: Findings) -> Any:
    """The paper's simulated changes less ours, by cable."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.6), layout="constrained")
    cables = np.arange(1, 10)
    for k, (name, apart) in enumerate(
        zip(loads(found), found.paper_n - found.nominal_n, strict=True)
    ):
        axes.plot(
            cables, apart, marker="osD"[k % 3], ms=5, lw=1.2, color=COLOURS[k % 3],
            ls="-" if k < 3 else "--", label=name,
        )  # fmt: skip
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.set(xlabel="cable", ylabel="N", xticks=cables)
    axes.grid(axis="y")
    figure.legend(loc="outside right center")
    return figure
