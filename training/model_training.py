"""Makes a model file for an arm, with its errors on fresh data: draw, train, test, export.

`RECIPES` has the networks by the names that commands and model files use.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from cablesense_base import Array
from cablesense_base.files import output_file
from cablesense_base.installation import package_version
from cablesense_base.progress import progress_bar
from cablesense_sim.arm import Arm
from cablesense_sim.contact_location import TorqueBalance
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset, generate
from cablesense_training.data.protocols import borne_by, protocol_from_options
from cablesense_training.data.sequences import MotionProtocol, Sequences, draw_sequences
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.anywhere import evaluate_anywhere
from cablesense_training.evaluation.comparison import WEAKEST_MULTI_N, evaluate_estimator
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    multi_contact_metrics,
    plain_values,
    sequence_metrics,
)
from cablesense_training.export import export_model
from cablesense_training.fit import FitHistory, FitSettings, OnEpoch, fit, fit_anywhere, outputs_of
from cablesense_training.fit_sequences import fit_sequences
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import NORMAL_95, Estimates, Estimator, MultiEstimator
from cablesense_training.inference.history_simulation import (
    HistorySimulation,
    depends_on_history,
    without_history,
)
from cablesense_training.inference.metadata import (
    ANYWHERE,
    HISTORY_SIMULATED,
    ModelKind,
    ModelMetadata,
    effect_versions,
)
from cablesense_training.inference.temporal_estimator import TemporalEstimator
from cablesense_training.networks.layers import ContactNetwork
from cablesense_training.networks.learnt import (
    DecoupledNetwork,
    ScaleAwareNetwork,
    SharedBackboneNetwork,
    TwoStageMultiContactNetwork,
    TwoStageNetwork,
)
from cablesense_training.networks.statics import (
    AnywhereStatics,
    CorrectedClosedForm,
    MultiContactClosedForm,
)
from cablesense_training.networks.temporal import TemporalNetwork

TEST_SAMPLES = 20_000
TEST_SHARE_OF_SEQUENCES = 0.125
TEST_SEED_OFFSET = 1_000_000
"""Test data follow the protocol of the training data, with its seed plus this."""

_JUDGED_SEQUENCES = 12
"""Sequences from which the intervals of a model with a simulated history are found."""


@dataclass(frozen=True)
class Recipe:
    """How a network is trained unless chosen otherwise: the least that reached its accuracy.

    Attributes:
        learns_from: kind of the protocol of its samples, or `motion` for sequences.
        build: makes it for an arm and the number of readings averaged into a tare.
        samples: how many of these, or sequences, to draw.
        drawn_on: makes of the arm the one whose samples it learns from.
    """

    learns_from: Literal["single", "multi", "anywhere", "motion"]
    build: Callable[[Arm, int], ContactNetwork | TemporalNetwork]
    samples: int
    settings: FitSettings = field(default_factory=FitSettings)
    drawn_on: Callable[[Arm], Arm] = lambda arm: arm


def _closed_form_without_history(arm: Arm, tare_samples: int) -> CorrectedClosedForm:
    """For what `inference.history_simulation` leaves of the readings; trained as any other."""
    if not depends_on_history(arm):
        raise TrainingError(
            f"network {HISTORY_SIMULATED} is for an arm file that lists friction, creep, "
            f"backlash or lagging sensors; {arm.identity} does not"
        )
    return CorrectedClosedForm.for_arm(without_history(arm), tare_samples)


_CORRECTED = FitSettings(epochs=20, batch_size=1024, learning_rate=5e-3, stop_patience=4)

RECIPES: dict[str, Recipe] = {
    "anywhere": Recipe("anywhere", AnywhereStatics.for_arm, 20_000),
    "closed-form": Recipe("single", CorrectedClosedForm.untrained, 20_000),
    "closed-form-corrected": Recipe("single", CorrectedClosedForm.for_arm, 40_000, _CORRECTED),
    HISTORY_SIMULATED: Recipe(
        "single", _closed_form_without_history, 40_000, _CORRECTED, without_history
    ),
    "decoupled": Recipe("single", DecoupledNetwork.for_arm, 100_000),
    "shared-backbone": Recipe("single", SharedBackboneNetwork.for_arm, 100_000),
    "two-stage": Recipe("single", TwoStageNetwork.for_arm, 100_000),
    "scale-aware": Recipe(
        "single",
        ScaleAwareNetwork.for_arm,
        300_000,
        FitSettings(epochs=45, batch_size=1024, tolerance=5e-3, decay=0.6),
    ),
    "multi-contact": Recipe("multi", TwoStageMultiContactNetwork.for_arm, 100_000),
    "multi-contact-closed-form": Recipe(
        "multi",
        MultiContactClosedForm.for_arm,
        50_000,
        FitSettings(epochs=20, batch_size=1024, learning_rate=1e-2),
    ),
    "temporal": Recipe(
        "motion",
        TemporalNetwork.for_arm,
        256,
        FitSettings(epochs=20, batch_size=32, learning_rate=3e-3),
    ),
}


def recipe_for(name: str) -> Recipe:
    """The recipe of a network.

    Raises:
        TrainingError: there is no network of that name; the message lists those there are.
    """
    if name not in RECIPES:
        raise TrainingError(f"no network {name!r}; there are: {', '.join(RECIPES)}")
    return RECIPES[name]


def build_network(
    name: str, arm: Arm, seed: int = 0, tare_samples: int = 50
) -> ContactNetwork | TemporalNetwork:
    """A network for an arm with the initial weights that the seed gives; see `recipe_for`."""
    recipe = recipe_for(name)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return recipe.build(arm, tare_samples)


@dataclass(frozen=True)
class TrainingReport:
    """The result of a training run: the model file, the network's name, and how it was trained.

    Attributes:
        parameters: number of trained numbers.
        errors: on test data, as plain values: `single`; `multi` and `multi_firm`, contacts below
            `WEAKEST_MULTI_N` left out; or `anywhere`. Of sequences those of `SequenceMetrics`.
    """

    path: Path
    network: str
    parameters: int
    history: FitHistory
    errors: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """As plain values; NaN becomes None."""
        plain = {
            "out": str(self.path),
            "network": self.network,
            "parameters": self.parameters,
            "bytes": self.path.stat().st_size,
            "epochs": len(self.history.epochs),
            "best_epoch": self.history.best_epoch,
            "best_validation": self.history.best_validation,
            "training_seconds": self.history.seconds,
            **self.errors,
        }
        return dict(plain_values(plain))


def draw_training_data(
    arm: Arm,
    network: str,
    options: dict[str, Any],
    seed: int,
    *,
    workers: int = 1,
    show_progress: bool = False,
) -> Dataset | Sequences:
    """Fresh samples or sequences for a network.

    `options` are those of a protocol. None means the default, or the load that the arm bears if
    that is less; `samples` counts sequences where the network learns from them.

    Raises:
        TrainingError: there is no such network.
        DatasetError: an option out of range, or one that the protocol does not have.
        WeakArmError: the arm cannot stand.
    """
    recipe = recipe_for(network)
    given = {name: value for name, value in options.items() if value is not None}
    if recipe.learns_from == "motion":
        given = borne_by(arm, MotionProtocol, given)
        motion = MotionProtocol(sequences=given.pop("samples", recipe.samples), **given)
        with progress_bar(motion.sequences, shown=show_progress, what="sequences") as advance:
            return draw_sequences(arm, motion, seed, workers=workers, on_done=advance)
    protocol = protocol_from_options({"kind": recipe.learns_from, **given}, arm)
    parts = []
    with progress_bar(protocol.samples, shown=show_progress) as advance:
        for part in generate(recipe.drawn_on(arm), protocol, seed, workers=workers):
            parts.append(part)
            advance(len(part))
    return replace(Dataset.concatenate(parts), arm=arm)


def train_model(
    path: str | Path,
    network: str,
    data: Dataset | Sequences,
    settings: FitSettings,
    *,
    command: str,
    test_samples: int | None = None,
    on_epoch: OnEpoch | None = None,
    on_trained: Callable[[ContactNetwork | TemporalNetwork], None] = lambda _: None,
) -> TrainingReport:
    """Train a network and write the model file; nothing is written when anything fails.

    Args:
        path: of the file.
        network: its name.
        data: what to train on; its arm is the model's arm.
        settings: how to train; the seed also fixes the initial weights.
        command: what makes the file again, kept in it.
        test_samples: size of the test set, drawn afresh by the data's own protocol; None means
            `TEST_SAMPLES`, or `TEST_SHARE_OF_SEQUENCES`.
        on_epoch: called after every epoch.
        on_trained: may change the trained network before it is tested.

    Raises:
        TrainingError: unknown network, data or settings that do not fit it, a place that cannot
            be written to, or a loss that is not finite.
    """
    path, recipe = Path(path), recipe_for(network)
    follows = "motion" if isinstance(data, Sequences) else data.protocol.kind
    if follows != recipe.learns_from:
        remedy = f" (cablesense dataset --protocol {recipe.learns_from})"
        raise TrainingError(
            f"network {network} is for protocol {recipe.learns_from}; the data follow {follows}"
            + (remedy if recipe.learns_from != "motion" else "")
        )
    output_file(path, TrainingError, force=True)
    built = build_network(network, data.arm, settings.seed, data.protocol.tare_samples)
    parameters = sum(p.numel() for p in built.parameters() if p.requires_grad)
    if isinstance(data, Sequences):
        assert isinstance(built, TemporalNetwork)
        history = fit_sequences(built, data, settings, on_epoch)
    elif isinstance(built, AnywhereStatics):
        history = fit_anywhere(built, data, settings.threads)
    else:
        assert isinstance(built, ContactNetwork)
        history = fit(built, data, settings, on_epoch)
    built.double()
    on_trained(built)
    metadata = _metadata(network, built, data, settings.seed, command)
    export_model(built, path, metadata)
    test_seed = data.seed + TEST_SEED_OFFSET
    if isinstance(data, Sequences):
        count = test_samples or max(1, round(TEST_SHARE_OF_SEQUENCES * data.protocol.sequences))
        motion = replace(data.protocol, sequences=count)
        test = draw_sequences(data.arm, motion, test_seed, workers=os.cpu_count() or 1)
        answer = ContactAnswer.of(TemporalEstimator.load(path).estimate_sequences(test))
        errors = {"sequences": len(data), "test_sequences": len(test)}
        errors |= asdict(sequence_metrics(answer, test))
    else:
        protocol = replace(data.protocol, samples=test_samples or TEST_SAMPLES)
        tested = draw_dataset(recipe.drawn_on(data.arm), protocol, test_seed)
        errors = _sample_errors(path, metadata.kind, replace(tested, arm=data.arm))
    return TrainingReport(path, network, parameters, history, errors)


def _sample_errors(path: Path, kind: ModelKind, test: Dataset) -> dict[str, Any]:
    """The errors of a `TrainingReport`, of the model in a file on samples."""
    if kind == ANYWHERE:
        return {"anywhere": evaluate_anywhere(AnywhereEstimator.load(path), test).as_json()}
    if kind == "single-contact":
        metrics = evaluate_estimator(Estimator.load(path), test).metrics
        return {"single": asdict(metrics) | {"coverage95": metrics.coverage95}}
    found = MultiEstimator.load(path).estimate_batch(test.tension_difference_n, test.command_rad)
    judged = test.contacts, test.magnitudes_n, found.probabilities > 0.5, found.magnitude_n
    return {
        "multi": asdict(multi_contact_metrics(*judged)),
        "multi_firm": asdict(multi_contact_metrics(*judged, WEAKEST_MULTI_N)),
    }


def widened_by_history(arm: Arm, seed: int) -> Callable[[ContactNetwork | TemporalNetwork], None]:
    """For `train_model`: widens a network's intervals until they hold forces of fresh sequences.

    Behind a simulation of its history an arm is known as well as its friction tells, which no
    network learns from samples without history.
    """

    def widen(trained: ContactNetwork | TemporalNetwork) -> None:
        assert isinstance(trained, CorrectedClosedForm)
        protocol = MotionProtocol(sequences=_JUDGED_SEQUENCES)
        sequences = draw_sequences(arm, protocol, seed + TEST_SEED_OFFSET)
        simulation = HistorySimulation(arm, protocol.tare_samples)
        left_n, hidden_n = simulation.along_n(sequences)
        flat = sequences.joint_command_rad.reshape(-1, arm.joint_count)
        answer = contact_answer(trained, left_n.reshape(-1, arm.cable_count), flat)
        truth = ContactTruth.of(sequences)
        found = (truth.segment > 0) & (truth.segment == answer.segment)
        error_n = np.abs(truth.magnitude_n - answer.magnitude_n)[found]
        beyond_n = np.sqrt(np.maximum(error_n**2 - hidden_n.ravel()[found] ** 2, 0.0))
        ratio = beyond_n / (NORMAL_95 * answer.magnitude_std_n[found])
        trained.spread.factor *= max(1.0, float(np.quantile(ratio, 0.95)))

    return widen


def _metadata(
    name: str,
    network: ContactNetwork | TemporalNetwork,
    data: Dataset | Sequences,
    seed: int,
    command: str,
) -> ModelMetadata:
    arm, protocol = data.arm, data.protocol
    kind: ModelKind = "multi-contact" if network.several else "single-contact"
    of_sequences: dict[str, Any] = {}
    if isinstance(network, TemporalNetwork) and isinstance(protocol, MotionProtocol):
        of_sequences = {
            "memory": network.memory,
            "hidden": network.hidden,
            "tick_s": protocol.tick_s,
            "joint_speed_deg_s": protocol.joint_speed_deg_s,
        }
    return ModelMetadata(
        kind=ANYWHERE if isinstance(network, AnywhereStatics) else kind,
        network=name,
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        pose_aware=network.pose_aware,
        pose_range_deg=0.0 if protocol.pose == "straight" else protocol.pose_range_deg,
        force_range_n=protocol.force_high_n,
        tare_samples=protocol.tare_samples,
        effect_versions=effect_versions(arm),
        command=command,
        seed=seed,
        version=package_version(),
        **of_sequences,
    )


def contact_answer(
    network: ContactNetwork, tension_difference_n: Array, command_rad: Array
) -> ContactAnswer:
    """A single-contact network's answers on B samples, (B, M) and (B, 2N); angles in [0, 360)."""
    outputs = outputs_of(network, tension_difference_n, command_rad)
    return ContactAnswer.of(Estimates.of_outputs([part.numpy() for part in outputs]))


def balance_answer(
    network: AnywhereStatics, tension_difference_n: Array, command_rad: Array
) -> TorqueBalance:
    """The balance of torques that a network of contacts anywhere finds in B samples."""
    outputs = outputs_of(network, tension_difference_n, command_rad)
    return TorqueBalance(*(part.numpy() for part in outputs[:5]))
