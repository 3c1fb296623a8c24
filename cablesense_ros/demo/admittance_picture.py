"""The picture of the controller's demo: forces and commanded angles over time, and the phases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cablesense_ros.admittance.estimate_watch import Sight
from cablesense_ros.demo.admittance_record import AdmittanceRecord
from cablesense_ros.demo.picture_style import DIM, DPI, INK, STYLE
from cablesense_ros.page.colours import ESTIMATE_RGB, TRUE_RGB, css, segment_rgb

SIZE_IN = (12.0, 6.6)
PHASES = {
    Sight.CONTACT: ("#7a4a00", "contact"),
    Sight.FREE: ("#12452f", "free"),
    Sight.BLIND: ("#2c323c", "blind: the arm moves"),
    Sight.STOPPED: ("#6b1f2a", "stopped"),
}


def draw_admittance(path: Path, record: AdmittanceRecord, segment: int, deadband_n: float) -> None:
    """Write the picture as PNG, beside its place first, so that no half of one is ever seen."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        figure, (forces, phases, angles) = plt.subplots(
            3, 1, sharex=True, figsize=SIZE_IN, height_ratios=(3.0, 0.22, 2.0)
        )
        figure.subplots_adjust(left=0.07, right=0.985, top=0.87, bottom=0.085, hspace=0.12)
        _draw_forces(forces, record, deadband_n)
        _draw_phases(figure, phases, record)
        _draw_angles(angles, record)
        figure.text(0.07, 0.945, "CableSense: the arm yields to a contact", size=15, weight="bold")
        figure.text(
            0.07,
            0.908,
            f"an elastic wall presses on segment {segment} and leaves at "
            f"{record.leaves_s:.0f} s; felt through the cables alone",
            color=DIM,
        )
        part = path.with_name(f".{path.name}.part")
        figure.savefig(part, dpi=DPI, format="png")
        plt.close(figure)
    part.replace(path)


def _draw_forces(axes: Any, record: AdmittanceRecord, deadband_n: float) -> None:
    times = record.times_s
    axes.plot(
        times,
        record.unyielding_n,
        color=DIM,
        lw=1.4,
        ls="--",
        label="without controller (computed)",
    )
    axes.plot(times, record.true_n, color=css(TRUE_RGB), lw=2.2, label="true force of the wall")
    touched = np.array([sight is Sight.CONTACT for sight in record.sights])
    felt = np.where(touched & (record.estimated_n > 0.0), record.estimated_n, np.nan)
    axes.plot(
        times,
        felt,
        color=css(ESTIMATE_RGB),
        lw=0,
        marker="o",
        ms=3.2,
        label="estimated, while it can",
    )
    axes.axhline(deadband_n, color=INK, lw=0.8, ls=":", label=f"deadband, {deadband_n:g} N")
    axes.set(ylabel="force, N", ylim=(-0.5, None), xlim=(0.0, times[-1]))
    axes.grid(axis="y", lw=0.6)
    axes.legend(loc="upper right", frameon=False, ncols=2)


def _draw_phases(figure: Any, axes: Any, record: AdmittanceRecord) -> None:
    from matplotlib.patches import Patch

    edges = [*record.times_s, record.times_s[-1]]
    for k, sight in enumerate(record.sights):
        axes.axvspan(edges[k], edges[k + 1], color=PHASES[sight][0], lw=0)
    axes.set(yticks=[], ylim=(0, 1))
    axes.spines[:].set_visible(False)
    axes.tick_params(bottom=False)
    seen = [sight for sight in PHASES if sight in record.sights]
    figure.legend(
        handles=[Patch(color=PHASES[s][0], label=PHASES[s][1]) for s in seen],
        loc="upper right",
        bbox_to_anchor=(0.985, 0.985),
        ncols=len(seen),
        frameon=False,
    )


def _draw_angles(axes: Any, record: AdmittanceRecord) -> None:
    degrees = np.rad2deg(record.commands_rad)
    for joint in range(degrees.shape[1] // 2):
        colour = css(segment_rgb(joint + 1))
        axes.step(
            record.times_s, degrees[:, 2 * joint], where="post", color=colour, lw=1.4, ls="--"
        )
        axes.step(
            record.times_s,
            degrees[:, 2 * joint + 1],
            where="post",
            color=colour,
            lw=1.8,
            label=f"joint {joint + 1}",
        )
    axes.set(xlabel="time, s", ylabel="commanded angle, °\n(yaw; pitch dashed)")
    axes.grid(axis="y", lw=0.6)
    axes.legend(loc="upper right", frameon=False, ncols=4)
