"""Fig. 5 and section II-D: how stiff a servo must be, and which time steps bear that."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR, WIDTH_IN, plain_log_ticks
from cablesense_paper.study import (
    BLACK,
    BLUE,
    CLOSED_FORM,
    DASHES,
    ORANGE,
    SERIES,
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    Study,
    StudyResult,
    Tell,
    picture,
)

DRAWN_M = 20e-6
"""By servo 2, while servo 1 is told to stay: 200 N on the cable if both obeyed."""

SHOWN = (0.1, 1.0, 10.0, 100.0)
"""kp in cable stiffnesses, of the lines drawn in Fig. 5."""


class _Map(NamedTuple):
    """Which steps stay bounded: kp in stiffnesses (K,), steps (H,), and by integrator (K, H)."""

    times: Array
    step_s: Array
    bounded: dict[str, NDArray[np.bool_]]
    limit_s: dict[str, Array]


def run(quick: bool, tell: Tell) -> StudyResult:
    """Rest over a sweep of kp, and a map of integrators and steps, on Fig. 3 (b)."""
    from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M
    from cablesense_paper.servo_cable import positions_at_rest_m, steady_error_m

    command_m = np.linspace(0.0, DRAWN_M, 5 if quick else 21)
    commands = np.stack([np.zeros_like(command_m), command_m], axis=-1)
    reached = {
        times: positions_at_rest_m(times * STIFFNESS_N_M, commands)[:, 1] for times in SHOWN
    }
    tell(0.05)
    times = np.geomspace(0.1, 100.0, 10 if quick else 31)
    kp = times * STIFFNESS_N_M
    error_m = np.array(
        [commands[-1, 1] - positions_at_rest_m(one, commands[-1:])[0, 1] for one in kp]
    )
    unyielding_n = PRETENSION_N + STIFFNESS_N_M * DRAWN_M
    closed_m = np.asarray(steady_error_m(unyielding_n, STIFFNESS_N_M, kp, 2))
    off = float(np.abs(error_m / closed_m - 1.0).max())
    tell(0.2)
    found = _map(quick, tell)
    cells = sum(bounded.size for bounded in found.bounded.values())
    missed = sum(
        int((bounded != (found.step_s < found.limit_s[name][:, None])).sum())
        for name, bounded in found.bounded.items()
    )
    short = {
        one: float(steady_error_m(unyielding_n, STIFFNESS_N_M, one * STIFFNESS_N_M, 2)) / DRAWN_M
        for one in SHOWN
    }
    at_ten = int(np.argmin(np.abs(found.times - 10.0)))
    limits_s = {name: float(limit[at_ten]) for name, limit in found.limit_s.items()}
    return StudyResult(
        lead=(
            "A servo rests T / kp short of its command, so a joint misses its target by "
            f"{short[0.1]:.0%} where kp is a tenth of the cable's stiffness and by "
            f"{short[10.0]:.1%} where it is ten times that. What kp costs is the time step: "
            f"Euler bears {1e6 * limits_s['Euler']:.0f} µs at kp = 10 k, the integrators "
            f"that are implicit in speed {1e6 * limits_s['implicitfast']:.0f} µs, and "
            "MuJoCo 4.0's discrete, implicit in position too, any."
        ),
        pictures=(
            _fig_5(command_m, reached),
            _error_picture(times, error_m, kp, closed_m),
            _map_picture(found),
        ),
        tables=(
            SmallTable(
                f"Servo 2 draws {1e6 * DRAWN_M:.0f} µm while servo 1 is told to stay.",
                ("kp", "joint 2 reaches, µm", "short of its command, %"),
                tuple(
                    (f"{one:g} k", 1e6 * float(reached[one][-1]), 100.0 * short[one])
                    for one in SHOWN
                ),
            ),
            SmallTable(
                "Longest stable time step at kp = 10 k, moving mass 0.5 kg, critical damping.",
                ("integrator", "takes at the end of the step", "closed form"),
                tuple(
                    (name, taken, _in_us(limits_s[name]))
                    for name, taken in (
                        ("Euler", "nothing"),
                        ("implicit", "speed"),
                        ("implicitfast", "speed"),
                        ("discrete", "speed and position"),
                    )
                ),
            ),
        ),
        comparisons=(
            Comparison(
                "with a small kp the joint", f"reaches {1.0 - short[0.1]:.0%} at kp = 0.1 k",
                "fails to reach its target", "", Agreement.YES,
                "The servo gives way to the cable; its force is kp times what it is short by.",
            ),
            Comparison(
                "kp an order above the stiffness", f"{short[10.0]:.1%} short",
                "a small error remains", "", Agreement.YES,
                "The error falls as 1 / (2 + kp / k): an order more of kp, an order less of it.",
            ),
            Comparison(
                "steady-state error, largest share off over the sweep", off, 0.0, "",
                Agreement.within(off, 0.0, 1e-3),
                "e = T / kp with T = k (s + c) / (1 + 2 k / kp).", CLOSED_FORM,
            ),
            Comparison(
                "a very large kp", "unstable with Euler, implicit and implicitfast",
                "can be unstable", "", Agreement.YES,
                "The limit falls as 1 / sqrt(kp).",
            ),
            Comparison(
                "an implicit integrator and a smaller step",
                f"{limits_s['implicitfast'] / limits_s['Euler']:.1f} times Euler's limit",
                "improve stability", "", Agreement.YES,
                "implicit and implicitfast are implicit in speed alone, so they move the limit"
                " and leave it there; discrete, new in 2026, has none.",
            ),
            Comparison(
                "cells of the map on the wrong side of the closed form", missed, 0.0, "",
                Agreement.YES if missed == 0 else Agreement.PARTLY,
                f"Jury's criterion of one step, in {cells} simulations.", CLOSED_FORM,
            ),
        ),
        notes=(
            "The paper gives neither the moving mass nor the damping of its servo; here they are "
            "this project's, 0.5 kg and critical. A stiffer or lighter servo moves the limits by "
            "the square root. A true ball screw does not give at all: that is a mocap body here "
            "(kp infinite in an arm file), and has no limit of its own.",
        ),
    )  # fmt: skip


def _in_us(limit_s: float) -> str:
    return f"{1e6 * limit_s:.1f} µs" if np.isfinite(limit_s) else "none"


def _map(quick: bool, tell: Tell) -> _Map:
    from cablesense_paper.cables import STIFFNESS_N_M
    from cablesense_paper.servo_cable import INTEGRATORS, longest_bounded_step_s, stays_bounded

    side = 13 if quick else 37
    times, step_s = np.geomspace(0.1, 100.0, side), np.geomspace(1e-6, 1e-2, side)
    bounded, limits = {}, {}
    for done, name in enumerate(INTEGRATORS):
        limits[name] = np.asarray(longest_bounded_step_s(times * STIFFNESS_N_M, name))
        bounded[name] = np.array(
            [[stays_bounded(t * STIFFNESS_N_M, h, name) for h in step_s] for t in times]
        )
        tell(0.2 + 0.2 * (done + 1))
    return _Map(times, step_s, bounded, limits)


def _fig_5(command_m: Array, reached: dict[float, Array]) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.62 * WIDTH_IN, 3.9), layout="constrained")
    axes.plot(1e6 * command_m, 1e6 * command_m, color=FLOOR, lw=1.0, label="joint = actuator")
    for n, (times, position_m) in enumerate(reversed(reached.items())):
        axes.plot(
            1e6 * command_m, 1e6 * position_m, color=SERIES[n], ls=DASHES[n], lw=2.0,
            label=f"kp = {times:g} k",
        )  # fmt: skip
    axes.axhline(0.0, color=BLACK, lw=0.6)
    axes.set(xlabel="actuator position (command), µm", ylabel="joint position, µm")
    axes.grid()
    axes.legend(loc="upper left")
    return picture(
        "fig_5_joint_position",
        figure,
        "Fig. 5 of the paper: actuator position against joint position, at rest. Servo 1 is told "
        "to stay and servo 2 draws; below zero the pretension has drawn the servo in.",
        "Joint position against commanded actuator position for four proportional gains",
    )


def _error_picture(times: Array, error_m: Array, kp: Array, closed_m: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.62 * WIDTH_IN, 3.6), layout="constrained")
    axes.loglog(times, 1e6 * closed_m, color=BLACK, lw=1.2, label="closed form, T / kp")
    axes.loglog(times, 1e6 * error_m, "o", color=BLUE, ms=5, label="MuJoCo at rest")
    axes.axvline(10.0, color=FLOOR, ls="--", lw=1.0)
    axes.text(
        10.5, 0.97, "the paper’s choice,\nabout ten times k", color=FLOOR, va="top",
        transform=axes.get_xaxis_transform(),
    )  # fmt: skip
    axes.set(xlabel="kp in cable stiffnesses k", ylabel="steady-state error, µm")
    for axis in (axes.xaxis, axes.yaxis):
        plain_log_ticks(axis)
    axes.grid()
    axes.legend(loc="lower left")
    return picture(
        "fig_5_steady_error",
        figure,
        f"Section II-D: how far a servo rests short of a command of {1e6 * DRAWN_M:.0f} µm.",
        "Steady-state error against proportional gain, simulated and by closed form",
    )


def _map_picture(found: _Map) -> Picture:
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colours = ListedColormap([ORANGE, "#CFE3F1"])
    figure, every = plt.subplots(
        1, 4, figsize=(WIDTH_IN, 3.4), sharex=True, sharey=True, layout="constrained"
    )
    for axes, (name, bounded) in zip(every, found.bounded.items(), strict=True):
        axes.pcolormesh(
            found.times, found.step_s, bounded.T, cmap=colours, vmin=0, vmax=1, shading="nearest"
        )
        if np.isfinite(found.limit_s[name]).all():
            axes.plot(found.times, found.limit_s[name], color=BLACK, lw=1.8)
        axes.set(title=name, xscale="log", yscale="log", xlabel="kp / k")
    every[0].set(ylabel="time step, s", ylim=(found.step_s[0], found.step_s[-1]))
    key: list[Any] = [
        Patch(color="#CFE3F1", label="stable"),
        Patch(color=ORANGE, label="unstable"),
        Line2D([], [], color=BLACK, lw=1.8, label="closed form"),
    ]
    figure.legend(handles=key, loc="outside upper right", ncols=3)
    return picture(
        "fig_5_stability",
        figure,
        "Section II-D: which integrators and time steps stay stable, by MuJoCo 4.0's names. Each "
        "cell is a simulation of 400 steps after a small push. k = 1e7 N/m, moving mass 0.5 kg, "
        "critical damping of the servo.",
        "Maps of stable and unstable time steps over gain, one for each integrator",
    )


STUDY = Study(
    name="self_locking",
    title="Self-locking",
    place="Fig. 5, II-D",
    order=40,
    quick="a third as many gains, and a map of 13 by 13 cells rather than 37 by 37",
    run=run,
)
