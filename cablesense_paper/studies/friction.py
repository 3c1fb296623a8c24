"""Fig. 6, section II-E and equation (2): what friction does to a cable over a cylinder."""

from __future__ import annotations

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.report.style import FLOOR, WIDTH_IN
from cablesense_paper.study import (
    BLACK,
    BLUE,
    CLOSED_FORM,
    DASHES,
    GREY,
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

COEFFICIENT, WRAP_RAD = 0.2, float(np.pi)
HIGH_M, LOW_M = 8e-6, -2e-6
"""The drive's way; both halves of the cable stay taut."""

CYCLE_S, QUICK_CYCLE_S = 16.0, 4.0
_STEP_S, _FINE_STEP_S = 1e-3, 5e-4
_PULL_S, _SETTLE_S = 1.0, 0.3
_LAWS = ("frictionloss", "frictionloss, hardened", "yielding spring", "capstan")


def run(quick: bool, tell: Tell) -> StudyResult:
    """Loops, the sweep of equation (2), and what is left after a rest, on Fig. 3 (c)."""
    from cablesense_paper.rubbing_cable import rubbing_tensions_n

    course = _course_m(QUICK_CYCLE_S if quick else CYCLE_S)
    loops = {}
    for done, law in enumerate(("none", *_LAWS)):
        loops[law] = _pulled_n(law, COEFFICIENT, WRAP_RAD, course, _FINE_STEP_S)
        tell(0.05 * (done + 1))
    own_n = rubbing_tensions_n(course, COEFFICIENT, WRAP_RAD)
    apart_n = float(np.abs(own_n - loops["capstan"]).max())
    tell(0.35)
    sweep = _sweep(quick)
    expected = np.exp(-sweep[:, 0] * sweep[:, 1])
    worst = float(np.abs(sweep[:, 2] / expected - 1.0).max())
    tell(0.65)
    rest_s = 5.0 if quick else 60.0
    held = {law: _held_n(law, rest_s) for law in _LAWS}
    left = {law: float(held_n[-1] / held_n[0]) for law, held_n in held.items()}
    width_n = {law: _loop_width_n(course, loops[law][:, 0]) for law in _LAWS}
    ratio = float(np.exp(-COEFFICIENT * WRAP_RAD))
    return StudyResult(
        lead=(
            "MuJoCo's frictionloss is a damper with a limit: at these speeds it makes a loop of "
            f"{width_n['frictionloss']:.2f} N as it comes, and one of "
            f"{width_n['frictionloss, hardened']:.0f} N at the hardest setting, which creeps away "
            "at rest. A yielding spring holds, but by a fixed force. With its yield following the "
            "tensions it gives equation (2) in slip, at every μ and θ tried, and holds at rest."
        ),
        pictures=(
            _loops_picture(course, loops, own_n),
            _sweep_picture(sweep),
            _held_picture(held, rest_s),
        ),
        tables=(
            SmallTable(
                f"μ = {COEFFICIENT:g}, θ = {WRAP_RAD:.3f} rad. The loop: tension at the drive, "
                "drawing less letting out, where that is most.",
                ("law", "width of the loop, N", f"left of it after {rest_s:.0f} s at rest, %"),
                tuple((law, width_n[law], 100.0 * left[law]) for law in _LAWS),
            ),
        ),
        comparisons=(
            Comparison(
                "hysteresis from frictionloss",
                f"{width_n[_LAWS[0]]:.2f} N; {width_n[_LAWS[1]]:.0f} N hardened",
                "a loop", "", Agreement.PARTLY,
                "There is one, but its width is set by speed, moving mass and solver settings; "
                "the paper gives none of them.",
            ),
            Comparison(
                "frictionloss and equation (2)", "the same force at every tension",
                "approximates friction", "", Agreement.NO,
                "Its limit is one number in newtons; equation (2) grows with the tension.",
            ),
            Comparison(
                "T_out / T_in in slip, largest share off", worst, 0.0, "",
                Agreement.within(worst, 0.0, 1e-3),
                f"Equation (2) over {len(sweep)} pairs of μ and θ, with capstan friction from a "
                "spring that yields at (T1 + T2) tanh(μ θ / 2).",
            ),
            Comparison(
                "T_out / T_in in slip, μ = 0.2, θ = π",
                float(_ratio(COEFFICIENT, WRAP_RAD)), ratio, "",
                Agreement.within(_ratio(COEFFICIENT, WRAP_RAD), ratio, 1e-4),
                "exp(-μ θ).",
            ),
            Comparison(
                "MuJoCo's loop and that of the effect capstan_friction, largest difference",
                apart_n, 0.0, "N", _near(apart_n, width_n["capstan"]),
                "They slip alike. Before that, the effect's contact gives in proportion to the "
                "tension, and MuJoCo's spring by a fixed stiffness; and a step lags.",
                "this project's effect",
            ),
            Comparison(
                f"share of the loop left after {rest_s:.0f} s, capstan", left["capstan"], 1.0, "",
                Agreement.within(left["capstan"], 1.0, 1e-3),
                "Dry friction holds for ever, and so must its model: the estimator takes its "
                "readings at rest.", CLOSED_FORM,
            ),
        ),
        notes=(
            "A MuJoCo tendon has one tension along its whole length, so no friction of one tendon "
            "can make T_out differ from T_in. Here the cable is two tendons that meet on a ring "
            "on the cylinder, and what rubs holds the ring.",
            "The fixed laws take the force that the capstan holds at the pretension, "
            f"{100.0 * np.tanh(0.5 * COEFFICIENT * WRAP_RAD):.1f} N. The paper gives neither its "
            "μ, nor its wrap angle, nor its frictionloss.",
        ),
    )  # fmt: skip


def _near(apart_n: float, width_n: float) -> Agreement:
    """In part where two loops differ by less than a tenth of their width."""
    return Agreement.PARTLY if apart_n < 0.1 * width_n else Agreement.NO


def _course_m(cycle_s: float) -> Array:
    """To the high end, and then one closed cycle of the drive; begins and ends at rest."""
    time_s = np.arange(0.0, 1.5 * cycle_s, _FINE_STEP_S)
    phase = 2.0 * np.pi * time_s / cycle_s
    up = 0.5 * HIGH_M * (1.0 - np.cos(phase))
    mean, half = 0.5 * (HIGH_M + LOW_M), 0.5 * (HIGH_M - LOW_M)
    return np.where(time_s < 0.5 * cycle_s, up, mean - half * np.cos(phase))


def _pulled_n(
    law: str, coefficient: float, wrap_rad: float, course_m: Array, step_s: float = _STEP_S
) -> Array:
    from cablesense_paper.rubbing_cable import Friction, RubbingCable

    return RubbingCable(Friction(law), coefficient, wrap_rad, step_s).drawn(course_m)


def _ratio(coefficient: float, wrap_rad: float) -> float:
    """T_out / T_in after a pull that has made the cable slip, at rest."""
    from cablesense_paper.cables import PRETENSION_N, STIFFNESS_N_M

    slips_at_m = PRETENSION_N * np.expm1(coefficient * wrap_rad) / (2.0 * STIFFNESS_N_M)
    time_s = np.arange(0.0, _PULL_S + _SETTLE_S, _STEP_S)
    course = 5.0 * slips_at_m * np.clip(time_s / _PULL_S, 0.0, 1.0)
    near_n, far_n = _pulled_n("capstan", coefficient, wrap_rad, course)[-1]
    return float(far_n / near_n)


def _sweep(quick: bool) -> Array:
    """Rows of μ, θ and T_out / T_in."""
    coefficients = (0.05, 0.2, 0.5) if quick else (0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
    wraps = np.pi * np.array([0.25, 1.0, 1.5] if quick else [0.25, 0.5, 0.75, 1.0, 1.25, 1.5])
    return np.array([(mu, wrap, _ratio(mu, wrap)) for mu in coefficients for wrap in wraps])


def _held_n(law: str, rest_s: float) -> Array:
    """T1 - T2, each step from the end of a pull into slip, with the drive at rest."""
    pull = HIGH_M * np.clip(np.arange(0.0, _PULL_S, _STEP_S) / _PULL_S, 0.0, 1.0)
    still = np.full(round((_SETTLE_S + rest_s) / _STEP_S), HIGH_M)
    tensions = _pulled_n(law, COEFFICIENT, WRAP_RAD, np.concatenate([pull, still]))
    # a spring that yields lags by a step's way, which is over at once when the drive stops
    settled = len(pull) + (round(_SETTLE_S / _STEP_S) if "frictionloss" not in law else 0)
    return np.asarray(tensions[settled:, 0] - tensions[settled:, 1])


def _loop_width_n(course_m: Array, tension_n: Array) -> float:
    """Drawing less letting out, where that is most, in the closed cycle."""
    third = len(course_m) // 3
    out, back = slice(third, 2 * third), slice(2 * third, None)
    way = np.linspace(LOW_M, HIGH_M, 400)
    letting = np.interp(-way, -course_m[out], tension_n[out])
    drawing = np.interp(way, course_m[back], tension_n[back])
    return float((drawing - letting).max())


def _loops_picture(course_m: Array, loops: dict[str, Array], own_n: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        1, 4, figsize=(WIDTH_IN, 3.5), sharex=True, sharey=True, layout="constrained"
    )
    cycle = slice(len(course_m) // 3, None)
    for axes, law in zip(every, _LAWS, strict=True):
        axes.plot(
            1e6 * course_m[cycle], loops["none"][cycle, 0], color=GREY, ls="--", lw=1.2,
            label="no friction",
        )  # fmt: skip
        axes.plot(1e6 * course_m, loops[law][:, 0], color=BLUE, lw=1.8, label="at the drive, T1")
        axes.plot(
            1e6 * course_m, loops[law][:, 1], color=ORANGE, ls="-.", lw=1.8,
            label="beyond the cylinder, T2",
        )  # fmt: skip
        axes.set(title=law, xlabel="drive position, µm")
        axes.grid()
    every[-1].plot(
        1e6 * course_m, own_n[:, 0], color=BLACK, ls=":", lw=1.4,
        label="T1 by the effect capstan_friction",
    )  # fmt: skip
    every[0].set(ylabel="tension, N", ylim=(0.0, None))
    handles, labels = every[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4)
    return picture(
        "fig_6_hysteresis",
        figure,
        "Fig. 6 of the paper: hysteresis of the cable over the cylinder, drawn to and fro once, "
        "under four laws of friction. μ = 0.2, θ = π.",
        "Tension against drive position under four laws of friction",
    )


def _sweep_picture(sweep: Array) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.62 * WIDTH_IN, 3.6), layout="constrained")
    product = np.linspace(0.0, 1.05 * float((sweep[:, 0] * sweep[:, 1]).max()), 200)
    axes.plot(product, np.exp(-product), color=BLACK, lw=1.2, label="equation (2), exp(−μθ)")
    for n, mu in enumerate(np.unique(sweep[:, 0])):
        rows = sweep[sweep[:, 0] == mu]
        axes.plot(
            mu * rows[:, 1], rows[:, 2], "os^vDP"[n], color=SERIES[n], ms=6, ls="none",
            label=f"MuJoCo, μ = {mu:g}",
        )  # fmt: skip
    axes.set(xlabel="μ θ", ylabel="T_out / T_in in slip", ylim=(0.0, 1.03), xlim=(0.0, None))
    axes.grid()
    axes.legend()
    return picture(
        "equation_2_capstan",
        figure,
        "Equation (2) of the paper, recovered by capstan friction in MuJoCo at wrap angles from "
        "45° to 270°.",
        "Ratio of the tensions in slip against the product of coefficient and wrap angle",
    )


def _held_picture(held: dict[str, Array], rest_s: float) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.62 * WIDTH_IN, 3.4), layout="constrained")
    for n, (law, held_n) in enumerate(held.items()):
        time_s = _STEP_S * np.arange(1, len(held_n) + 1)
        axes.semilogx(time_s, held_n, color=SERIES[n], ls=DASHES[n], lw=2.0, label=law)
    axes.axhline(0.0, color=FLOOR, lw=0.8)
    axes.set(xlabel="time at rest, s (logarithmic)", ylabel="T1 − T2, N", xlim=(_STEP_S, rest_s))
    axes.grid()
    axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.66))
    return picture(
        "fig_6_at_rest",
        figure,
        "What friction still holds after the drive has stopped. Dry friction holds for ever; "
        "frictionloss creeps.",
        "Difference of the tensions over time at rest under four laws of friction",
    )


STUDY = Study(
    name="friction",
    title="Frictional contact",
    place="Fig. 6, II-E, equation (2)",
    order=50,
    quick="a cycle of 4 s rather than 16 s, 9 pairs of μ and θ rather than 36, 5 s of rest "
    "rather than 60 s",
    run=run,
)
