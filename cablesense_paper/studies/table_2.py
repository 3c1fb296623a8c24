"""Table II, section IV-A: weights hung on the nine-cable arm, ours beside the paper's two."""

from __future__ import annotations

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import GRID, WIDTH_IN
from cablesense_paper.study import (
    BLACK,
    BLUE,
    CLOSED_FORM,
    ORANGE,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

ARM = "cdsm_table2"
SLOPE_LARGEST_N, SLOPE_RMS_N = 0.45, 0.2
"""How near the part in proportion to the load is to come to the paper's simulation."""

PAPER_LARGEST_N, PAPER_SHARE = 5.98, 30.5
_MARKS = (
    ("physical, the paper’s", "D", BLACK),
    ("simulated, the paper’s", "s", ORANGE),
    ("simulated, here", "o", BLUE),
)


def run(quick: bool, tell: Tell) -> StudyResult:
    """All six loads by statics and by MuJoCo stepped to rest, beside the rows of the table."""
    from cablesense_training.evaluation.table2 import read_table2

    rows = read_table2()
    physical = [row for row in rows if row.source == "physical"]
    physical_n = np.stack([row.tension_difference_n for row in physical])
    paper_n = np.stack([row.tension_difference_n for row in rows if row.source == "simulated"])
    loads = [(row.segment, row.weight_n) for row in physical]
    names = [f"{_kg(weight_n):.0f} kg, segment {segment}" for segment, weight_n in loads]
    ours_n = _by_statics_n(loads)
    tell(0.3)
    apart_n = float(np.abs(_by_stepping_n(loads) - ours_n).max())
    tell(0.7)
    slopes_off_n = (ours_n[3:] - ours_n[:3]) - (paper_n[3:] - paper_n[:3])
    constant_n = (paper_n - ours_n).mean(0)
    error_n, paper_error_n = ours_n - physical_n, paper_n - physical_n
    likeness = float(np.corrcoef(ours_n.ravel(), physical_n.ravel())[0, 1])
    largest_n, paper_largest_n = _largest(error_n), _largest(paper_error_n)
    row, cable = np.unravel_index(np.abs(error_n).argmax(), error_n.shape)
    weight_n = loads[int(row)][1]
    same_cell = (row, cable) == np.unravel_index(np.abs(paper_error_n).argmax(), error_n.shape)
    return StudyResult(
        lead=(
            "What grows with the load is the same in both simulations: from 1 to 2 kg they differ "
            f"by {_rms(slopes_off_n):.2f} N RMS, {_largest(slopes_off_n):.2f} N at most. Of the "
            f"physical rows ours misses {_rms(error_n):.2f} N RMS and the paper’s "
            f"{_rms(paper_error_n):.2f} N, because the paper’s rows carry a constant that does "
            "not depend on the load."
        ),
        pictures=(
            _table_picture(names, physical_n, paper_n, ours_n),
            _slopes_picture(slopes_off_n),
        ),
        tables=(_values(names, physical_n, paper_n, ours_n), _errors(physical_n, paper_n, ours_n)),
        comparisons=(
            Comparison(
                "2 kg row less 1 kg row, largest difference of a cell",
                _largest(slopes_off_n), 0.0, "N",
                Agreement.within(_largest(slopes_off_n), 0.0, SLOPE_LARGEST_N),
                f"Within {SLOPE_LARGEST_N} N: the geometry of the cables, which sets these "
                "numbers, is the same.",
            ),
            Comparison(
                "2 kg row less 1 kg row, difference RMS", _rms(slopes_off_n), 0.0, "N",
                Agreement.within(_rms(slopes_off_n), 0.0, SLOPE_RMS_N),
                f"Within {SLOPE_RMS_N} N over 27 cells.",
            ),
            Comparison(
                "simulated rows, RMS difference", _rms(ours_n - paper_n), 0.0, "N",
                Agreement.PARTLY,
                f"All but {_rms(ours_n - paper_n + constant_n):.2f} N of it is the same at every "
                "load: the paper’s changes seem to count from another unloaded state.",
            ),
            Comparison(
                "largest error of the paper’s simulation, from its table", paper_largest_n,
                PAPER_LARGEST_N, "N",
                Agreement.within(paper_largest_n, PAPER_LARGEST_N, 0.0151),
                "The table has two decimals.",
            ),
            Comparison(
                "largest error against the physical rows", largest_n, PAPER_LARGEST_N, "N",
                Agreement.YES if largest_n <= PAPER_LARGEST_N else Agreement.NO,
                f"Ours is smaller, {'in the same cell' if same_cell else 'in another cell'}: "
                f"cable {cable + 1}, {names[int(row)]}.",
            ),
            Comparison(
                "that error as a share of the weight", 100.0 * largest_n / weight_n, PAPER_SHARE,
                "%", Agreement.YES if 100.0 * largest_n / weight_n <= PAPER_SHARE else
                Agreement.NO, "With the paper’s 9.81 m/s².",
            ),
            Comparison(
                "simulated against physical rows", f"correlation {likeness:.3f}",
                "trends show strong consistency", "",
                Agreement.YES if likeness > 0.98 else Agreement.PARTLY,
                "Over all 54 cells; what is left is the subject of the study on sim-to-real.",
            ),
            Comparison(
                "statics against MuJoCo stepped to rest, largest difference", apart_n, 0.0, "N",
                Agreement.within(apart_n, 0.0, 1e-3),
                "Two ways to the same rest; ours is worked out without time steps.", CLOSED_FORM,
            ),
        ),
        notes=(
            "The paper does not say what the arm of Table II weighs or where its cables run. Both "
            "were read off its simulated rows, so that their slopes agree is no accident; that "
            "27 cells follow from one radius, one set of angles and the middle of each segment "
            "is the finding.",
            "The constant, paper less ours, on cables 1 to 9: "
            + ", ".join(_signed(value) for value in constant_n)
            + " N.",
        ),
    )  # fmt: skip


def _by_statics_n(loads: list[tuple[int, float]]) -> Array:
    """(K, 9) changes of tension under weights hung on segments of the straight arm."""
    from cablesense_sim.arm import open_arm
    from cablesense_sim.build import mechanism_of
    from cablesense_sim.equilibrium import solve_equilibrium

    mechanism = mechanism_of(open_arm(ARM))
    forces = np.zeros((1 + len(loads), mechanism.segment_count, 3))
    for row, (segment, weight_n) in enumerate(loads, start=1):
        forces[row, segment - 1, 2] = -weight_n
    rest = solve_equilibrium(mechanism, np.zeros((len(forces), mechanism.joint_count)), forces)
    return np.asarray(rest.tensions_n[1:] - rest.tensions_n[0])


def _by_stepping_n(loads: list[tuple[int, float]]) -> Array:
    """The same by MuJoCo, stepped until the arm is at rest."""
    from cablesense_sim.arm import open_arm
    from cablesense_sim.dynamics import ArmDynamics

    dynamics = ArmDynamics(open_arm(ARM))
    dynamics.settle()
    unloaded = dynamics.tensions_n
    changes = []
    for segment, weight_n in loads:
        dynamics.reset()
        dynamics.load(segment, [0.0, 0.0, -weight_n])
        dynamics.settle()
        changes.append(dynamics.tensions_n - unloaded)
    return np.stack(changes)


def _kg(weight_n: float) -> float:
    from cablesense_training.evaluation.table2 import STANDARD_GRAVITY_M_S2

    return weight_n / STANDARD_GRAVITY_M_S2


def _signed(value: float) -> str:
    """Two decimals, with a true minus sign and none before nothing."""
    rounded = round(value, 2)
    return f"{rounded:+.2f}".replace("-", "−") if rounded else "0.00"


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _largest(values: Array) -> float:
    return float(np.abs(values).max())


def _values(names: list[str], physical_n: Array, paper_n: Array, ours_n: Array) -> SmallTable:
    rows: list[tuple[str | float, ...]] = []
    for name, *three in zip(names, physical_n, paper_n, ours_n, strict=True):
        for source, values in zip(("physical", "the paper’s", "ours"), three, strict=True):
            rows.append((name, source, *(_signed(value) for value in values)))
    return SmallTable(
        "Table II of the paper with our rows: changes of the cable tensions, N.",
        ("load", "row", *(f"cable {i + 1}" for i in range(9))),
        tuple(rows),
    )


def _errors(physical_n: Array, paper_n: Array, ours_n: Array) -> SmallTable:
    pairs = (
        ("ours less physical", ours_n - physical_n),
        ("the paper’s simulation less physical", paper_n - physical_n),
        ("ours less the paper’s simulation", ours_n - paper_n),
    )
    return SmallTable(
        "Differences, N: all 54 cells, and the 27 cells of what 1 kg more adds.",
        ("difference", "largest", "RMS", "largest, 2 kg − 1 kg", "RMS, 2 kg − 1 kg"),
        tuple(
            (name, _largest(d), _rms(d), _largest(d[3:] - d[:3]), _rms(d[3:] - d[:3]))
            for name, d in pairs
        ),
    )


def _table_picture(names: list[str], *three_n: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        2, 3, figsize=(WIDTH_IN, 5.2), sharex=True, sharey=True, layout="constrained"
    )
    cables = np.arange(1, 10)
    for row, axes in enumerate(every.ravel()):
        for n, (label, mark, colour) in enumerate(_MARKS):
            x, changes_n = cables + 0.22 * (n - 1), three_n[n][row]
            axes.vlines(x, 0.0, changes_n, color=colour, lw=1.1, alpha=0.55)
            axes.plot(x, changes_n, mark, color=colour, ms=5, label="" if row else label)
        axes.axhline(0.0, color=BLACK, lw=0.7)
        for border in (3.5, 6.5):
            axes.axvline(border, color=GRID, lw=1.4)
        axes.set(title=names[row], xticks=cables)
        axes.grid(axis="y")
    figure.supxlabel("cable (1 to 3 end on segment 1, 4 to 6 on 2, 7 to 9 on 3)", fontsize=9.5)
    figure.supylabel("change of tension, N", fontsize=9.5)
    figure.legend(loc="outside upper right", ncols=3)
    return picture(
        "table_2_loads",
        figure,
        "Table II of the paper: changes of nine cable tensions under 1 kg (top) and 2 kg (bottom) "
        "hung on segments 1 to 3.",
        "Measured, the paper's simulated and our simulated changes for nine cables and six loads",
    )


def _slopes_picture(off_n: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.72 * WIDTH_IN, 2.9), layout="constrained")
    cables = np.arange(1, 10)
    axes.axhspan(-SLOPE_LARGEST_N, SLOPE_LARGEST_N, color=GRID, lw=0)
    for point, (mark, colour) in enumerate(zip("osD", (BLUE, ORANGE, BLACK), strict=True)):
        axes.plot(
            cables + 0.2 * (point - 1), off_n[point], mark, color=colour, ms=5.5,
            label=f"load on segment {point + 1}",
        )  # fmt: skip
    axes.axhline(0.0, color=BLACK, lw=0.7)
    axes.set(xlabel="cable", ylabel="ours less the paper’s, N", xticks=cables)
    axes.set_ylim(-1.4 * SLOPE_LARGEST_N, 1.4 * SLOPE_LARGEST_N)
    axes.grid(axis="y")
    figure.legend(loc="outside right center")
    return picture(
        "table_2_slopes",
        figure,
        "What the second kilogram adds (2 kg row less 1 kg row of Table II): our simulation less "
        f"the paper’s. The band is ±{SLOPE_LARGEST_N} N; tensions grow by up to 17 N.",
        "Difference of the two simulations in what the second kilogram adds, by cable",
    )


STUDY = Study(
    name="table_2",
    title="Weights on the arm",
    place="Table II, IV-A",
    order=70,
    quick="",
    run=run,
)
