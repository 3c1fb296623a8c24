"""The one command that follows from a verdict, with the reason for it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

from cablesense_gap.amended_arm import AMENDED_ARM
from cablesense_gap.report.style import newtons
from cablesense_gap.verdict import CANNOT_TELL, DECIDING_ERROR, NONE, UNKNOWN, Verdict, joined
from cablesense_sim.effects.registry import known_effects

ADAPTED_MODEL = "estimator.onnx"
"""The model file beside the report of an adaptation."""
CALIBRATION = "calibration.npz"
"""Its calibration."""

_LIKELIER_THAN_ALL_OTHERS = 0.5
_LAG = "sensor_lag"
"""Without effect on readings at rest."""


@dataclass(frozen=True)
class Given:
    """What a diagnosis was asked for, as the user names it.

    Attributes:
        recording: its path.
        machine: the arm file or its bundled name, or a robot's model.
        out: the folder of the report.
        estimator: of an adaptation, the model file in use; empty for that of the arm file.
        external: whether positions of a robot were measured outside of its drives.
    """

    recording: str = "RECORDING"
    machine: str = "ARM"
    out: str = "OUT"
    estimator: str = ""
    external: bool = False


@dataclass(frozen=True)
class NextStep:
    """What to do, why, and the command that does it."""

    title: str
    why: str
    command: str


def next_step(verdict: Verdict, given: Given) -> NextStep:
    """The next step after a diagnosis or an adaptation of an arm."""
    estimator = verdict.estimator
    if estimator is not None and estimator.after is not None and estimator.use == "after":
        return _run_the_new(verdict, given)
    if verdict.effects == (CANNOT_TELL,):
        return _record_when_healthy(given, arm=given.machine)
    if is_undecided(verdict):
        return NextStep(
            "Record what decides",
            "This recording does not tell the explanations apart. Record the block that is "
            "described here, with its unloaded rows, and diagnose it.",
            _command("gap", "record", arm=given.machine, out="next.mcap"),
        )
    if verdict.effects == (UNKNOWN,):
        return NextStep(
            "Narrow it down",
            "No effect of the library explains the gap, so no other arm file is better. Record "
            "the protocol, with the block that is described here, and diagnose it.",
            _command("gap", "record", arm=given.machine, out="next.mcap"),
        )
    if verdict.effects == (NONE,):
        return NextStep(
            "Calibrate the arm",
            "The arm is as its file says, within its tolerances. Its unloaded rows tell where in "
            "these it is, and an estimator that knows this errs less.",
            _command(
                "calibrate", given.recording, arm=given.machine, out=f"{given.out}/{CALIBRATION}"
            ),
        )
    if all(_acts_on_loads(name) for name in verdict.effects):
        return NextStep(
            "Correct the load cell",
            "The arm is as its file says, and so is its estimator; the stated loads are not those "
            "that acted. With the loads as found, the arm reads what was recorded.",
            _predict_as_found(given),
        )
    if verdict.effects == (_LAG,):
        return NextStep(
            "Make the sensors faster",
            "The arm is as its file says, and so is its estimator once readings have settled; a "
            "force that changes is stated as late as the sensors are. With the lag as found, the "
            "arm reads what was recorded.",
            _predict_as_found(given),
        )
    if estimator is not None:
        return _keep_the_first(verdict, given)
    return NextStep(
        "Adapt the estimator",
        "It makes the estimator of the arm as it is found to be, with its calibration, and judges "
        "it beside the present one on loads that the diagnosis does not have.",
        _command(
            "gap",
            "adapt",
            given.recording,
            arm=given.machine,
            out=f"{given.out.rstrip('/')}_adapted",
        ),
    )


def _predict_as_found(given: Given) -> str:
    """The command that predicts the recording with the arm as it was found."""
    return _command(
        "gap",
        "predict",
        given.recording,
        arm=f"{given.out}/{AMENDED_ARM}",
        out=f"{given.out}/predicted.csv",
    )


def robot_next_step(verdict: Verdict, given: Given) -> NextStep:
    """The next step after a diagnosis of a robot, whose model is `given.machine`."""
    positions = {"positions": "external"} if given.external else {}
    if verdict.effects == (CANNOT_TELL,):
        return _record_when_healthy(given, model=given.machine, **positions)
    if verdict.effects == (NONE,):
        return NextStep(
            "Keep this recording",
            "The model holds. With this recording as the reference, a later one says what changed "
            "since.",
            _command(
                "gap",
                "diagnose",
                "NEW_RECORDING",
                reference=given.recording,
                model=given.machine,
                **positions,
                out="changes",
            ),
        )
    if verdict.effects == (UNKNOWN,) or verdict.doubts or is_undecided(verdict):
        return NextStep(
            "Narrow it down",
            "The recording does not show the cause surely. The protocol has the motions that tell "
            "effects apart; record and diagnose them.",
            _command("gap", "protocol", model=given.machine, out="next.csv"),
        )
    return NextStep(
        "Check the amended model",
        "Its gap on a recording that was not used here says whether the finding holds.",
        _command(
            "gap", "predict", "NEW_RECORDING", model=given.out, **positions, out="predicted.csv"
        ),
    )


def _record_when_healthy(given: Given, **machine: str) -> NextStep:
    return NextStep(
        "Record this motion when healthy",
        "The reference does not cover the motions and loads of this recording. Record them on the "
        "healthy machine, and diagnose this recording again with that as the reference.",
        _command(
            "gap",
            "diagnose",
            given.recording,
            **machine,
            reference="HEALTHY_RECORDING",
            out=f"{given.out.rstrip('/')}_again",
        ),
    )


def is_undecided(verdict: Verdict) -> bool:
    """Whether others are as likely as the verdict: it names one of several explanations."""
    rivals = {name for name in verdict.ambiguity_group if name != joined(verdict.effects)}
    return bool(rivals) or verdict.probability <= _LIKELIER_THAN_ALL_OTHERS


def run_command(arm: str, model: str = "", calibration: str = "") -> str:
    """The command that starts the estimator node."""
    parameters = {"arm": arm, "model": model, "calibration_file": calibration}
    words = ["ros2", "run", "cablesense_ros", "estimator", "--ros-args"]
    for name, value in parameters.items():
        if value:
            words += ["-p", f"{name}:={value}"]
    return shlex.join(words)


def _run_the_new(verdict: Verdict, given: Given) -> NextStep:
    assert verdict.estimator is not None
    return NextStep(
        "Use the new estimator",
        f"On withheld loads it errs less: {_decided_by(verdict)}.",
        run_command(
            f"{given.out}/{AMENDED_ARM}",
            f"{given.out}/{ADAPTED_MODEL}",
            f"{given.out}/{CALIBRATION}",
        ),
    )


def _keep_the_first(verdict: Verdict, given: Given) -> NextStep:
    made = verdict.estimator is not None and verdict.estimator.after is not None
    why = "Nothing was found that would make another estimator."
    if made:
        why = (
            f"On withheld loads the new one errs no less: {_decided_by(verdict)}. It is kept "
            f"beside this report, as {ADAPTED_MODEL} with {CALIBRATION}."
        )
    return NextStep("Keep the estimator in use", why, run_command(given.machine, given.estimator))


def _decided_by(verdict: Verdict) -> str:
    """The figure that decides between two estimators, before and after."""
    assert verdict.estimator is not None
    before = verdict.estimator.before.get(DECIDING_ERROR)
    after = (verdict.estimator.after or {}).get(DECIDING_ERROR)
    if before is None or after is None:
        return "see the figures"
    return f"force stated wrongly {newtons(before)} before, {newtons(after)} after"


def _acts_on_loads(name: str) -> bool:
    effect = known_effects().get(name)
    return effect is not None and effect.acts_on == "load"


def _command(*words: str, **options: str) -> str:
    parts = ["cablesense", *words]
    for name, value in options.items():
        parts += [f"--{name}", value]
    return shlex.join(parts)
