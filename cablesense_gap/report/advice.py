"""What to do next, as steps that someone who has never seen the tool can follow."""

from __future__ import annotations

from dataclasses import dataclass

from cablesense_gap.report.effect_words import effect_words
from cablesense_gap.report.inputs import ReportInputs
from cablesense_gap.report.numbers import percent
from cablesense_gap.report.wording import SURE, ambiguity, cause
from cablesense_gap.verdict import NONE, UNKNOWN

POOR_SHARE = 0.5
"""Where less of the gap is removed, an amended arm is not to be relied on."""


@dataclass(frozen=True)
class Step:
    """One thing to do.

    Attributes:
        title: what, in a few words.
        text: how, and why.
        commands: to type.
    """

    title: str
    text: str
    commands: tuple[str, ...] = ()


def steps(inputs: ReportInputs) -> tuple[Step, ...]:
    """What to do about the verdict, the most urgent first."""
    verdict = inputs.verdict
    if verdict.effects == (NONE,):
        return (_keep(), *_experiment(inputs, "To be surer"))
    if verdict.effects == (UNKNOWN,):
        return (*_experiment(inputs, "Narrow it down"), *_look(), _own_effect())
    use = _use_amended(inputs)
    doubtful = verdict.probability < SURE or ambiguity(verdict) != ""
    if doubtful or verdict.gap.removed_fraction < POOR_SHARE:
        return (*_experiment(inputs, "First make sure"), use, *_mend(inputs))
    return (use, *_mend(inputs), *_experiment(inputs, "To be surer still"))


def _keep() -> Step:
    return Step(
        "Keep the nominal arm file",
        "No effect of the library earns a place in it. If an estimate is still poor, the cause is "
        "not the arm's simulation in the regimes that were recorded.",
    )


def _use_amended(inputs: ReportInputs) -> Step:
    name = inputs.amended_file
    return Step(
        f"Use the amended arm file {name}",
        f"It lies beside this page: arm {inputs.arm.name} with the parameters of the table below. "
        "Check it on a recording that was not used here, train the estimator on it, and measure "
        "again.",
        (
            f"cablesense gap predict NEW_RECORDING --arm {name} --out predicted.csv",
            f"cablesense train --arm {name} --out amended.onnx",
        ),
    )


def _mend(inputs: ReportInputs) -> tuple[Step, ...]:
    return tuple(
        Step(f"Or mend the arm: {cause(inputs.verdict, name)}", effect_words(name).look)
        for name in inputs.verdict.effects
        if effect_words(name).look
    )


def _experiment(inputs: ReportInputs, title: str) -> tuple[Step, ...]:
    verdict = inputs.verdict
    if not verdict.next_experiment:
        return ()
    text = verdict.next_experiment
    if verdict.effects not in ((NONE,), (UNKNOWN,)) and verdict.probability < SURE:
        text += (
            f" As it stands, {percent(1.0 - verdict.probability)} of the belief lies elsewhere."
        )
    return (Step(title, text, ("cablesense gap record --out next.mcap",)),)


def _look() -> tuple[Step, ...]:
    return (
        Step(
            "Do not amend the arm file",
            "The nominal arm is still the best that the library offers. The pictures below show "
            "in which cables and regimes the gap is; look at the arm there for what rubs, gives "
            "way, touches or comes loose.",
        ),
    )


def _own_effect() -> Step:
    return Step(
        "If you know the physics, add it as an effect",
        "An effect is one Python file, in the package or in one of your own; diagnose again with "
        "it (docs/diagnosis.md).",
    )
