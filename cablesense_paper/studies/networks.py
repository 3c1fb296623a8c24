"""Section III-C: how deep and wide, together or apart, and what an answer costs."""

from __future__ import annotations

from collections.abc import Iterator

from cablesense_paper.network_findings import (
    DECOUPLED,
    DIRECTION,
    FORCE,
    FULL,
    METRICS,
    PAPER_FIGURES,
    PAPER_SAMPLES,
    QUICK,
    SHARED_TRUNK,
    TWO_STAGE,
    Findings,
    Plan,
)
from cablesense_paper.study import Agreement, Comparison, SmallTable, Study, StudyResult, Tell

_POSES = {"straight": "straight arm", "random": "poses within ±10°, unknown"}


def run(quick: bool, tell: Tell) -> StudyResult:
    """Train every shape on the same samples of the straight arm, test, and time its answers."""
    from cablesense_paper.network_trials import explore

    return said_of(explore(QUICK if quick else FULL, tell))


def said_of(findings: Findings) -> StudyResult:
    """The study, from what was found at any plan's size; to be called in the report's style."""
    from cablesense_paper.network_trials import compared_picture, cost_picture, depth_picture

    return StudyResult(
        lead=_lead(findings),
        pictures=(depth_picture(findings), compared_picture(findings), cost_picture(findings)),
        tables=(_table(findings), _little_data_table(findings)),
        comparisons=(
            _apart_or_together(findings),
            _what_a_shared_trunk_saves(findings),
            _what_two_stages_bring(findings),
            *_with_little_data(findings),
        ),
        notes=_notes(findings.plan),
    )


def _lead(findings: Findings) -> str:
    least = findings.least_that_reaches()
    if least is None:
        reached = "No decoupled network tried here reaches all of the paper’s figures. "
    else:
        layers = f"{least.depth} layer{'s' if least.depth > 1 else ''} of {least.width}"
        reached = (
            f"The smallest decoupled networks tried that reach the paper’s figures have {layers} "
            f"each, {findings.parameters(least):,} parameters in all. "
        )
    widest = max(findings.plan.widths)
    figures = [
        f"{shape.architecture} {findings.mean(shape, DIRECTION):.2f}°, "
        f"{findings.mean(shape, FORCE):.2f} N, {cost_us:.0f} µs"
        for shape, cost_us in findings.cost_us.items()
        if shape.width == widest
    ]
    return f"{reached}At a width of {widest}: {'; '.join(figures)}."


def _apart_or_together(findings: Findings) -> Comparison:
    ratios = findings.error_ratios(SHARED_TRUNK, DECOUPLED)
    better = [ratio < 1.0 for ratio in ratios.values()]
    return Comparison(
        "decoupled against shared trunk, same widths",
        _said({name: 1.0 / ratio for name, ratio in ratios.items()}),
        "task-specific networks achieve high precision", "",
        Agreement.NO if all(better) else Agreement.PARTLY if any(better) else Agreement.YES,
        "Below 1 the decoupled networks are the more precise; tasks that are apart do not "
        "weigh on each other.",
    )  # fmt: skip


def _what_a_shared_trunk_saves(findings: Findings) -> Comparison:
    ratios = findings.error_ratios(SHARED_TRUNK, DECOUPLED)
    fewer = findings.parameter_ratio(SHARED_TRUNK, DECOUPLED)
    cheaper = findings.cost_ratio(SHARED_TRUNK, DECOUPLED)
    pays = max(ratios.values()) < 1.0 / fewer
    return Comparison(
        "shared trunk against decoupled, same widths",
        f"{fewer:.0%} of the parameters, {cheaper:.0%} of the time; {_said(ratios)}",
        "favorable performance-efficiency trade-off", "",
        Agreement.YES if pays else Agreement.PARTLY,
        "The errors grow by less than the parameters shrink."
        if pays
        else "Some error grows by more than the parameters shrink.",
    )  # fmt: skip


def _what_two_stages_bring(findings: Findings) -> Comparison:
    ratios = findings.error_ratios(TWO_STAGE, SHARED_TRUNK)
    helped = [ratios[metric] < 1.0 for metric in (DIRECTION, FORCE)]
    return Comparison(
        "two-stage against shared trunk, same widths", _said(ratios),
        "contact information guides force and direction", "",
        Agreement.YES if all(helped) else Agreement.PARTLY if any(helped) else Agreement.NO,
        "Below 1 knowing the contact helps; the trunk can find it in the tensions by itself, "
        "so there is little to gain.",
    )  # fmt: skip


def _said(ratios: dict[str, float]) -> str:
    wrong, direction, force = ratios.values()
    return f"×{wrong:.2f} wrong contacts, ×{direction:.2f} direction, ×{force:.2f} force"


def _with_little_data(findings: Findings) -> Iterator[Comparison]:
    for pose, one in findings.with_little_data.items():
        for what, metric, unit in (("direction", DIRECTION, "°"), ("force", FORCE, "N")):
            ours, theirs = METRICS[metric](one), PAPER_FIGURES[metric]
            yield Comparison(
                f"two-stage on {PAPER_SAMPLES:,} samples without noise, {_POSES[pose]}: "
                f"{what} error",
                ours, theirs, unit, Agreement.YES if ours <= theirs else Agreement.NO,
                "Less than the paper’s, so the amount of data alone does not make that error."
                if ours <= theirs
                else "More than the paper’s: with so little training data this is what is left.",
            )  # fmt: skip


def _table(findings: Findings) -> SmallTable:
    rows: list[tuple[str | float, ...]] = [
        (
            shape.architecture, shape.depth, shape.width, f"{findings.parameters(shape):,}",
            *(findings.mean(shape, metric) for metric in METRICS),
            findings.cost_us.get(shape, "–"),
        )
        for shape in findings.plan.shapes
    ]  # fmt: skip
    return SmallTable(
        "All shapes that were tried.",
        ("architecture", "layers", "width", "parameters", *METRICS, "one answer, µs"),
        tuple(rows),
    )


def _little_data_table(findings: Findings) -> SmallTable:
    rows: list[tuple[str | float, ...]] = [
        (
            _POSES[pose], 100.0 * (1.0 - one.wrong_contact), one.direction_mae_deg,
            one.magnitude_mae_n, one.magnitude_rmse_n,
        )
        for pose, one in findings.with_little_data.items()
    ]  # fmt: skip
    rows.append(("the paper", "over 98", 5.96, 9.97, 14.26))
    return SmallTable(
        f"A two-stage network on the paper’s amount of data: {PAPER_SAMPLES:,} samples "
        "without noise, each a contact; tested on fresh ones like them.",
        ("samples", "contact, %", "direction MAE, °", "force MAE, N", "force RMSE, N"),
        tuple(rows),
    )


def _notes(plan: Plan) -> tuple[str, ...]:
    return (
        f"Straight arm, noise on, a fifth of the samples without contact: {plan.samples:,} "
        f"samples to train on, {plan.epochs} passes at most, {plan.test_samples:,} fresh ones "
        f"to test on, seeds {', '.join(str(seed) for seed in plan.seeds)}; figures are means "
        "over the seeds, and come out the same again. Microseconds do not: they are of one "
        "answer in ONNX Runtime on one core of this machine, the stated uncertainty "
        "included.",
        "The paper names depth, parameter count and trade-off as what it explored, and prints "
        "none of the numbers. Parameters here are those behind the answers. Each trunk has "
        "the depth and width named; the first stage of two has a layer less.",
    )


STUDY = Study(
    name="networks",
    title="Which network",
    place="III-C",
    order=100,
    quick=f"decoupled networks of {len(QUICK.depths)} depths and one width rather than "
    f"{len(FULL.depths)} and {len(FULL.widths)}, one seed rather than {len(FULL.seeds)}, "
    f"{QUICK.samples:,} samples and {QUICK.epochs} passes rather than {FULL.samples:,} and "
    f"{FULL.epochs}: networks far from learnt out, whose figures only show the way",
    run=run,
)
