"""Table II, sim-to-real: what makes the gap to the physical rows, and what does not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_gap.report.style import AFTER, BEFORE, GRID, INK, OTHER, newtons, percent
from cablesense_gap.report.text import candidate_name
from cablesense_gap.verdict import listed
from cablesense_sim.effects.registry import known_effects
from cablesense_training.evaluation.comparison import STANDARD_GRAVITY_M_S2
from paper.drawing import GREEN, one_panel, panels
from paper.study import Figures, Numbers, Progress
from paper.table_2_gap import STEP_N, TableDiagnosis, best_of_each, diagnose_table
from paper.tension_changes import Explained, OneNumber

_ALIKE = 1.05
"""Numbers that leave this much more than the best are called no worse."""

_SLACK_ROW = 5
_SLACK_SET = slice(3, 6)
_SLACK_CABLE = 5
"""2 kg on segment 3, the cables that end on segment 2, cable 6."""

_SETS = {"cables 1 to 3": BEFORE, "cables 4 to 6": AFTER, "cables 7 to 9": GREEN}
_MOST = 12
"""Candidates that are listed."""
_UNITS = (
    ("_n_m", 1.0, "N·m"),
    ("_m", 1e3, "mm"),
    ("_rad", 57.2958, "°"),
    ("_n", 1.0, "N"),
    ("_kg", 1.0, "kg"),
)
"""End of a parameter's name, scale and unit in a report; the first that fits counts."""


def sim_to_real(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Diagnose the 54 measured changes as `cablesense gap` diagnoses a recording."""
    diagnosis = diagnose_table(progress)
    return numbers_of(diagnosis), figures_of(diagnosis)


def figures_of(found: TableDiagnosis) -> Figures:
    """All pictures of the study; to be called in the report's style."""
    return {
        "sim_to_real_gap": gap_figure(found),
        "sim_to_real_proportion": proportion_figure(found),
    }


def numbers_of(found: TableDiagnosis) -> Numbers:
    """All that the text of the study names."""
    measured = found.changes.changes_n
    gap_n = found.gap_n
    paper_gap_n = measured - found.paper_n
    apart_n = found.paper_n - found.nominal_n
    largest_n = float(np.abs(gap_n).max())
    disproportion_n = measured[3:] - 2.0 * measured[:3]
    steps = measured / STEP_N
    ranked = ranked_singles(found)
    near = [s for s in ranked if s.held_out_rmse <= _ALIKE * ranked[0].held_out_rmse]
    best, *no_worse = dict.fromkeys(f"{number_name(s.number)} ({value_of(s)})" for s in near)
    slack = min(
        (s for s in found.singles if s.number.effect == "pretension_error"),
        key=lambda s: (s.number.terms[0].place != "arm", s.rmse),
    )
    return {
        "gap": newtons(rms(gap_n)),
        "gap_n": rms(gap_n),
        "largest": newtons(largest_n),
        "largest_n": largest_n,
        "best_listed": newtons(min(found.held_out_n.values())),
        "proportional": newtons(found.proportional_n),
        "inner": percent((found.internal_n**2).sum() / (gap_n**2).sum()),
        "floor": newtons(found.floor_n),
        "times_floor": rms(gap_n) / found.floor_n,
        "of_changes": percent(rms(gap_n) / rms(measured)),
        "last_cables": listed([f"{value:+.2f}" for value in measured[0, 6:]]),
        "best_number": best,
        "best_number_left": newtons(ranked[0].held_out_rmse),
        "no_worse": listed(no_worse),
        "explanations": tuple(_best_explanations(found)),
        "blind": listed([_spaced(name) for name in found.blind]),
        "timed": listed([_spaced(n) for n, e in known_effects().items() if e.needs_time]),
        "disproportion": newtons(rms(np.delete(disproportion_n.ravel(), [21, 22, 23]))),
        "slack_off": listed([f"{v:+.2f}" for v in disproportion_n[_SLACK_ROW - 3, _SLACK_SET]]),
        "slack_n": -measured[_SLACK_ROW, _SLACK_CABLE],
        "slack_needs": value_of(slack),
        "slack_left": newtons(slack.rmse),
        "slack_held_out": newtons(slack.held_out_rmse),
        "step_n": STEP_N,
        "off_step_n": float(np.abs(steps - np.round(steps)).max()) * STEP_N,
        "step_noise": newtons(STEP_N * np.sqrt(2 / 12)),
        "paper_gap": newtons(rms(paper_gap_n)),
        "paper_gap_n": rms(paper_gap_n),
        "paper_largest": newtons(float(np.abs(paper_gap_n).max())),
        "apart": newtons(rms(apart_n)),
        "apart_less_constant": newtons(rms(apart_n - apart_n.mean(0))),
        "constant": ", ".join(f"{v:+.2f}" for v in apart_n.mean(0)),
        "left_rows": [
            (number_name(s.number), value_of(s), s.rmse, s.held_out_rmse)
            for s in best_of_each(found.singles)
        ],
        "candidate_rows": [
            ("a law in proportion to the load, whatever its cause", found.proportional_n),
            *((candidate_name(effects), n) for effects, n in found.held_out_n.items()),
        ][:_MOST],
        "share_rows": [(what, 100.0 * share) for what, share in shares(found).items()],
    }


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt((np.asarray(values) ** 2).mean()))


def load_names(found: TableDiagnosis) -> list[str]:
    """The rows by name."""
    kg = -found.changes.load_n[:, 2] / STANDARD_GRAVITY_M_S2
    segments = found.changes.load_segment
    return [f"{m:.0f} kg on segment {n}" for m, n in zip(kg, segments, strict=True)]


def shares(found: TableDiagnosis) -> dict[str, float]:
    """Parts of the gap by their share of its squares; they add up to 1."""
    whole = (found.gap_n**2).sum()
    inner = found.internal_n**2
    last = inner[:, 6:].sum()
    row = inner[_SLACK_ROW, _SLACK_SET].sum()
    parts = {
        "cables 7 to 9 all tighter, the more where segment 1 or 2 is loaded": last,
        "cables 4 to 6 all tighter, under 2 kg on segment 3 alone": row,
        "the other internal forces": inner.sum() - last - row,
        "moments, most of it too large a pull at joint 1": whole - inner.sum(),
    }
    return {what: float(part / whole) for what, part in parts.items()}


def number_name(number: OneNumber) -> str:
    """As in `sensor gain, cable 1`."""
    if len(number.terms) > 1:
        return "one gain of all sensors, or a load heavier than believed"
    (term,) = number.terms
    parts = [number.effect]
    if number.effect == "routing_geometry":
        parts.append(term.parameter.rsplit("_", 1)[0])
    if term.place != "arm":
        parts.append(term.place)
    return ", ".join(map(_spaced, parts))


def value_of(explained: Explained) -> str:
    """The fitted value with its unit, as far as the name has it."""
    value = explained.value
    name = explained.number.terms[0].parameter
    if name in ("gain", "share", "change"):
        return f"{100 * value:+.1f} %"
    for end, scale, unit in _UNITS:
        if name.endswith(end):
            return f"{scale * value:+.3g} {unit}"
    return f"{value:.3g}"


def _spaced(name: str) -> str:
    return name.replace("_", " ")


def ranked_singles(found: TableDiagnosis) -> list[Explained]:
    """All numbers, the best first; among equals that of the effect with fewer places to choose."""
    tried = Counter(s.number.effect for s in found.singles)
    return sorted(found.singles, key=lambda s: (round(s.held_out_rmse, 2), tried[s.number.effect]))


def _best_explanations(found: TableDiagnosis) -> Iterator[str]:
    """The best single effect and the best pair, as sentences."""
    ranked = sorted(found.hypotheses, key=lambda h: h.held_out_rmse)
    for count, what in ((1, "one effect"), (2, "two effects at once")):
        best = next((h for h in ranked if len(h.effects) == count), None)
        if best is not None:
            names = listed([_spaced(effect) for effect in best.effects])
            yield (
                f"Of {what} with all numbers, the best is {names} ({len(best.values)} numbers): "
                f"it leaves {newtons(best.held_out_rmse)}."
            )
        elif count == 2:
            yield "No two effects at once leave clearly less than one of them alone."


def gap_figure(found: TableDiagnosis) -> Any:
    """Measured less simulated change of every cable, one panel a load, with its internal part."""
    figure, grid_axes = panels(2, 3, 4.4, grid="y", sharex=True, sharey=True)
    cables = np.arange(1, 10)
    colours = np.repeat(list(_SETS.values()), 3)
    for axes, name, gap, inner in zip(
        grid_axes.ravel(), load_names(found), found.gap_n, found.internal_n, strict=True
    ):
        axes.bar(cables, gap, 0.72, color=colours)
        for k in range(3):
            axes.hlines(inner[3 * k], 3 * k + 0.5, 3 * k + 3.5, color=INK, lw=2.2)
        axes.axhline(0.0, color=INK, lw=0.7)
        axes.set_title(name)
        axes.set_xticks(cables)
    figure.supxlabel("cable", fontsize=9.5)
    figure.supylabel("measured less simulated, N", fontsize=9.5)
    return figure


def proportion_figure(found: TableDiagnosis) -> Any:
    """Gap under 2 kg against gap under 1 kg, with the line of proportion."""
    figure, axes = one_panel(4.2)
    gap_1_kg_n = found.gap_n[:3]
    gap_2_kg_n = found.gap_n[3:]
    along = np.array([gap_1_kg_n.min() - 0.2, gap_1_kg_n.max() + 0.2])
    # 95 % of a difference between one number and two others
    band = 1.96 * np.sqrt(5.0) * found.floor_n
    axes.fill_between(along, 2.0 * along - band, 2.0 * along + band, color=GRID, lw=0)
    axes.plot(along, 2.0 * along, color=OTHER, lw=1.2)
    for k, (name, colour) in enumerate(_SETS.items()):
        of_set = slice(3 * k, 3 * k + 3)
        for point, mark in enumerate("osD"):
            axes.scatter(
                gap_1_kg_n[point, of_set],
                gap_2_kg_n[point, of_set],
                s=36,
                color=colour,
                marker=mark,
                zorder=3,
                label=name if point == 0 else None,
            )
    for point, mark in enumerate("osD"):
        axes.scatter([], [], s=36, color=OTHER, marker=mark, label=f"load on segment {point + 1}")
    axes.set(xlabel="gap under 1 kg, N", ylabel="gap under 2 kg, N")
    figure.legend(loc="outside right center")
    return figure
