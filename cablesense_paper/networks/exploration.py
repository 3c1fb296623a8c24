"""A plan, carried out: every shape trained on the same samples, tested, and timed."""

from __future__ import annotations

from collections.abc import Iterator

from cablesense_paper.networks.answer_time import answer_us
from cablesense_paper.networks.findings import Findings
from cablesense_paper.networks.plan import PAPER_BATCH_SIZE, PAPER_SAMPLES, PAPER_SHAPE, Plan
from cablesense_paper.networks.trials import Trial, trial, trials
from cablesense_paper.study import Tell
from cablesense_sim.arm import Arm
from cablesense_sim.arm_files import open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.protocols import Pose, SingleContact
from cablesense_training.fit import FitSettings

_TRAIN_SEED, _TEST_SEED = 0, 20_260_002


def explore(plan: Plan, tell: Tell) -> Findings:
    """What the plan finds on the arm of the paper; all but microseconds come out the same again.

    Args:
        plan: what is tried.
        tell: hears which share is done, up to 0.99.
    """
    arm = open_arm("cdsm")
    done: list[Trial] = []
    for one in _tried(plan, arm):
        done.append(one)
        tell(0.7 * len(done) / (len(plan.shapes) * len(plan.seeds)))
    with_little_data = {pose: _with_little_data(plan, arm, pose) for pose in plan.paper_poses}
    tell(0.8)
    cost_us = {}
    for shape in plan.compared:
        cost_us[shape] = answer_us(shape, arm)
        tell(0.8 + 0.19 * len(cost_us) / len(plan.compared))
    return Findings(plan, tuple(done), cost_us, with_little_data)


def _tried(plan: Plan, arm: Arm) -> Iterator[Trial]:
    """Trials of all shapes and seeds on the straight arm, as each is done."""
    training, test = (
        Dataset.from_protocol(arm, SingleContact(samples=samples), seed)
        for samples, seed in ((plan.samples, _TRAIN_SEED), (plan.test_samples, _TEST_SEED))
    )
    cases = [(shape, seed) for shape in plan.shapes for seed in plan.seeds]
    settings = FitSettings(epochs=plan.epochs, batch_size=plan.batch_size)
    return trials(cases, training, test, settings, plan.workers)


def _with_little_data(plan: Plan, arm: Arm, pose: Pose) -> Trial:
    """A two-stage network on the paper's amount of data, tested as the paper tests."""
    training, test = (
        Dataset.from_protocol(
            arm,
            SingleContact(samples=samples, pose=pose, noise=False, no_contact_fraction=0.0),
            seed,
        )
        for samples, seed in ((PAPER_SAMPLES, _TRAIN_SEED), (plan.test_samples, _TEST_SEED))
    )
    settings = FitSettings(epochs=2 * plan.epochs, batch_size=PAPER_BATCH_SIZE)
    return trial(PAPER_SHAPE, 0, training, test, settings)
