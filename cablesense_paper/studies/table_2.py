"""Table II, section IV-A: weights hung on the nine-cable arm, ours beside the paper's two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import GRID
from cablesense_paper.drawing import BLACK, BLUE, ORANGE, one_panel, panels
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.evaluation.table2 import STANDARD_GRAVITY_M_S2, read_table2

_ARM = "cdsm_table2"
_SLOPE_LIMIT_N = 0.45
"""How near the part in proportion to the load is to come to the paper's simulation."""

_MARKS = (
    ("physical, the paper’s", "D", BLACK),
    ("simulated, the paper’s", "s", ORANGE),
    ("simulated, here", "o", BLUE),
)
_CABLES = np.arange(1, 10)

Loads = Sequence[tuple[int, float]]
"""Segment and weight in N of each."""


def run(quick: bool, progress: Progress) -> StudyResult:
    """All six loads by statics and by MuJoCo stepped to rest, beside the rows of the table."""
    table = read_table2()
    physical_n, paper_n = (
        np.stack([row.tension_difference_n for row in table if row.source == source])
        for source in ("physical", "simulated")
    )
    loads = [(row.segment, row.weight_n) for row in table if row.source == "physical"]
    names = [f"{weight / STANDARD_GRAVITY_M_S2:.0f} kg, segment {n}" for n, weight in loads]
    ours_n = _by_statics_n(loads)
    progress(0.3)
    statics_off_n = _largest(_by_stepping_n(loads) - ours_n)
    progress(0.7)
    differences = {
        "ours less physical": ours_n - physical_n,
        "the paper’s simulation less physical": paper_n - physical_n,
        "ours less the paper’s simulation": ours_n - paper_n,
    }
    error_n, paper_error_n, apart_n = differences.values()
    slopes_off_n = (ours_n[3:] - ours_n[:3]) - (paper_n[3:] - paper_n[:3])
    constant_n = -apart_n.mean(0)
    worst, paper_worst = (np.abs(error).argmax() for error in (error_n, paper_error_n))
    row, cable = np.unravel_index(worst, error_n.shape)
    correlation = float(np.corrcoef(ours_n.ravel(), physical_n.ravel())[0, 1])
    numbers = {
        "slope_limit_n": _SLOPE_LIMIT_N,
        "slopes_rms_n": _rms(slopes_off_n),
        "slopes_largest_n": _largest(slopes_off_n),
        "error_rms_n": _rms(error_n),
        "paper_error_rms_n": _rms(paper_error_n),
        "apart_rms_n": _rms(apart_n),
        "apart_less_constant_n": _rms(apart_n + constant_n),
        "paper_largest_n": _largest(paper_error_n),
        "largest_n": _largest(error_n),
        "which": "the same" if worst == paper_worst else "another",
        "cable": cable + 1,
        "load": names[int(row)],
        "share": 100.0 * _largest(error_n) / loads[int(row)][1],
        "correlation": correlation,
        "consistent": Agreement.YES if correlation > 0.98 else Agreement.PARTLY,
        "statics_off_n": statics_off_n,
        "constant": ", ".join(_signed(value) for value in constant_n),
        "values": [
            (name, source, *map(_signed, values))
            for name, *three in zip(names, physical_n, paper_n, ours_n, strict=True)
            for source, values in zip(("physical", "the paper’s", "ours"), three, strict=True)
        ],
        "errors": [
            (name, _largest(d), _rms(d), _largest(d[3:] - d[:3]), _rms(d[3:] - d[:3]))
            for name, d in differences.items()
        ],
    }
    figures = {
        "table_2_loads": _load_figure(names, (physical_n, paper_n, ours_n)),
        "table_2_slopes": _slope_figure(slopes_off_n),
    }
    return study_result("table_2", numbers, figures)


def _by_statics_n(loads: Loads) -> Array:
    """(K, 9) changes of tension under weights hung on segments of the straight arm."""
    mechanism = mechanism_of(open_arm(_ARM))
    forces = np.zeros((1 + len(loads), mechanism.segment_count, 3))
    for row, (segment, weight_n) in enumerate(loads, start=1):
        forces[row, segment - 1, 2] = -weight_n
    rest = solve_equilibrium(mechanism, np.zeros((len(forces), mechanism.joint_count)), forces)
    return np.asarray(rest.tensions_n[1:] - rest.tensions_n[0])


def _by_stepping_n(loads: Loads) -> Array:
    """The same by MuJoCo, stepped until the arm is at rest."""
    dynamics = ArmDynamics(open_arm(_ARM))
    dynamics.settle()
    unloaded = dynamics.tensions_n
    changes = []
    for segment, weight_n in loads:
        dynamics.reset()
        dynamics.load(segment, [0.0, 0.0, -weight_n])
        dynamics.settle()
        changes.append(dynamics.tensions_n - unloaded)
    return np.stack(changes)


def _signed(value: float) -> str:
    """Two decimals, with a true minus sign and none before nothing."""
    rounded = round(value, 2)
    return f"{rounded:+.2f}".replace("-", "−") if rounded else "0.00"


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _largest(values: Array) -> float:
    return float(np.abs(values).max())


def _load_figure(names: list[str], three_n: tuple[Array, ...]) -> Any:
    figure, every = panels(2, 3, 5.2, grid="y", sharex=True, sharey=True)
    for row, axes in enumerate(every.ravel()):
        for n, (label, mark, colour) in enumerate(_MARKS):
            x, changes_n = _CABLES + 0.22 * (n - 1), three_n[n][row]
            axes.vlines(x, 0.0, changes_n, color=colour, lw=1.1, alpha=0.55)
            axes.plot(x, changes_n, mark, color=colour, ms=5, label="" if row else label)
        axes.axhline(0.0, color=BLACK, lw=0.7)
        for border in (3.5, 6.5):
            axes.axvline(border, color=GRID, lw=1.4)
        axes.set(title=names[row], xticks=_CABLES)
    figure.supxlabel("cable (1 to 3 end on segment 1, 4 to 6 on 2, 7 to 9 on 3)", fontsize=9.5)
    figure.supylabel("change of tension, N", fontsize=9.5)
    figure.legend(loc="outside upper right", ncols=3)
    return figure


def _slope_figure(off_n: Array) -> Any:
    figure, axes = one_panel(2.9, width=0.72, grid="y")
    axes.axhspan(-_SLOPE_LIMIT_N, _SLOPE_LIMIT_N, color=GRID, lw=0)
    for point, (mark, colour) in enumerate(zip("osD", (BLUE, ORANGE, BLACK), strict=True)):
        axes.plot(
            _CABLES + 0.2 * (point - 1), off_n[point], mark, color=colour, ms=5.5,
            label=f"load on segment {point + 1}",
        )  # fmt: skip
    axes.axhline(0.0, color=BLACK, lw=0.7)
    axes.set(xlabel="cable", ylabel="ours less the paper’s, N", xticks=_CABLES)
    axes.set_ylim(-1.4 * _SLOPE_LIMIT_N, 1.4 * _SLOPE_LIMIT_N)
    figure.legend(loc="outside right center")
    return figure
