"""Accuracy of every estimator in every setting, on the same fresh samples, with the noise bound.

    python benchmarks/accuracy.py [--samples 100000] [--quick] [--write]
    python benchmarks/accuracy.py --several [--samples 50000] [--write]

The shipped models and their bundled baselines answer as ONNX files. Baselines too large or too
many to ship are trained here, by their recipes and with seed 0: gradient boosting in every
setting, the decoupled networks and shared backbone of the paper on the straight arm and at random
poses. `--write` puts `accuracy.json` and the tables `accuracy.md` into `benchmarks/results/`.

With `--several` there are none to four forces of 0 to 60 N at once on the straight arm, answered
by gradient boosting too: `multi_contact.json`. Recognition counts contacts from 5 N and all
untouched segments.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import harness

from cablesense_sim.arm import Arm, open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import Protocol
from cablesense_training.evaluation.comparison import (
    DOWN_DEG,
    MULTI_ARM,
    SETTINGS,
    SHIPPED,
    TABLE2_MODELS,
    WEAKEST_MULTI_N,
    Setting,
    evaluate_answer,
    evaluate_multi_answer,
    evaluate_multi_models,
    evaluate_setting,
    evaluate_table2,
    metrics_json,
    multi_protocol,
)
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    angle_difference_deg,
    multi_contact_bound_n,
)
from cablesense_training.fit import FitSettings, fit
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.model_training import build_network, contact_answer, recipe_for
from cablesense_training.networks.layers import ContactNetwork
from examples.paper.boosting import BoostingBaseline, BoostingSettings, MultiBoostingBaseline

TEST_SEED = 20_260_001
TRAIN_SEED = 0
BOOSTING_SAMPLES = 50_000
TRAINED_HERE = {
    "straight": ("decoupled", "shared-backbone"),
    "random_pose": ("decoupled", "shared-backbone"),
}

PAPER = {
    "contact_accuracy": 0.98,
    "direction_mae_deg": 5.96,
    "magnitude_mae_n": 9.97,
    "magnitude_rmse_n": 14.26,
}
"""The paper's numbers: straight arm, noise-free, every sample a contact."""


def main() -> None:
    """Measures and prints; writes with `--write`."""
    parser = harness.parser(__doc__, "results/accuracy.*")
    parser.add_argument("--samples", type=int, default=100_000, help="test samples per setting")
    parser.add_argument("--workers", type=int, default=2, help="processes that draw samples")
    parser.add_argument("--quick", action="store_true", help="bundled models only")
    parser.add_argument("--several", action="store_true", help="several contacts at once instead")
    options = parser.parse_args()
    if options.several:
        harness.publish("multi_contact.json", _several(options.samples), options)
        return
    start = time.perf_counter()

    def drawn(arm: Arm, protocol: Protocol) -> Dataset:
        return draw_dataset(arm, protocol, TEST_SEED, workers=options.workers)

    single: dict[str, Any] = {}
    for setting in SETTINGS:
        _log(f"{setting.name} …")
        dataset = drawn(setting.arm, setting.protocol(options.samples))
        found = evaluate_setting(setting, dataset)
        shipped = found.models.pop(SHIPPED)
        peers = {name: metrics_json(metrics) for name, metrics in found.models.items()}
        if not options.quick:
            peers |= _trained_baselines(setting, dataset, options.workers)
        coverage = ("magnitude_coverage95", "direction_coverage95")
        single[setting.name] = {
            "shipped": metrics_json(shipped)
            | {name: getattr(shipped.errors, name) for name in coverage},
            "mae_over_bound_above_2_n": found.firm_ratio,
            "bound": asdict(found.bound),
            "peers": peers,
            "confusion": shipped.confusion,
        }
    multi = drawn(open_arm(MULTI_ARM), multi_protocol(options.samples))
    result: dict[str, Any] = {
        **harness.origin(),
        "seed": TEST_SEED,
        "samples": options.samples,
        "paper": PAPER,
        "single": single,
        "multi": {n: asdict(found.metrics) for n, found in evaluate_multi_models(multi).items()},
        "table2": {name: _table2_rows(model) for name, model in TABLE2_MODELS.items()},
        "seconds": time.perf_counter() - start,
    }
    table = markdown(result)
    print(table)
    if options.write:
        harness.write_result("accuracy.json", result)
        harness.write_result("accuracy.md", table)


def _several(samples: int) -> dict[str, Any]:
    """Several contacts at once: the bundled models, boosted trees, and the bound."""
    arm = open_arm(MULTI_ARM)
    test = draw_dataset(arm, multi_protocol(samples), TEST_SEED)
    metrics = {name: asdict(found.metrics) for name, found in evaluate_multi_models(test).items()}
    training = draw_dataset(arm, multi_protocol(BOOSTING_SAMPLES), TRAIN_SEED)
    answer = MultiBoostingBaseline(training).answer(test)
    metrics["gradient_boosting"] = asdict(evaluate_multi_answer(*answer, test).metrics)
    bound = multi_contact_bound_n(test, WEAKEST_MULTI_N)
    metrics["noise_bound"] = {"magnitude_mae_n": bound.tolist()}
    return {"seed": TEST_SEED, "samples": samples, "several_contacts": metrics}


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _trained_baselines(setting: Setting, test: Dataset, workers: int) -> dict[str, Any]:
    """Errors of the baselines that are trained here, with the seconds their training took."""
    baselines: dict[str, Any] = {}

    def add(name: str, answer: ContactAnswer, seconds: float) -> None:
        metrics = evaluate_answer(answer, test).metrics
        baselines[name] = {**metrics_json(metrics), "training_seconds": seconds}

    names = TRAINED_HERE.get(setting.name, ())
    samples = max([BOOSTING_SAMPLES, *(recipe_for(name).samples for name in names)])
    training = draw_dataset(setting.arm, setting.protocol(samples), TRAIN_SEED, workers=workers)
    for name in names:
        _log(f"  training {name} …")
        recipe, network = recipe_for(name), build_network(name, setting.arm, TRAIN_SEED)
        assert isinstance(network, ContactNetwork)
        assert isinstance(recipe.settings, FitSettings)
        history = fit(network, training.select(slice(recipe.samples)), recipe.settings)
        answer = contact_answer(network.double(), test.tension_difference_n, test.command_rad)
        add(name, answer, history.seconds)
    _log("  training gradient boosting …")
    start = time.perf_counter()
    settings = BoostingSettings(pose_aware=setting.name in ("random_pose", "compliant"))
    boosting = BoostingBaseline(training.select(slice(BOOSTING_SAMPLES)), settings)
    seconds = time.perf_counter() - start
    add("gradient_boosting", boosting.answer(test), seconds)
    return baselines


def _table2_rows(model: str) -> list[dict[str, float]]:
    return [
        {
            "true_segment": load.segment,
            "true_n": load.weight_n,
            "segment": found.segment,
            "magnitude_n": found.magnitude_n,
            "off_from_down_deg": float(angle_difference_deg(found.angle_deg, DOWN_DEG)),
        }
        for load, found in evaluate_table2(Estimator.load(find_model(model)))
    ]


_COLUMNS = {
    "contact": ("contact_accuracy", ".2%"),
    "direction MAE, °": ("direction_mae_deg", ".3f"),
    "force MAE, N": ("magnitude_mae_n", ".3f"),
    "force RMSE, N": ("magnitude_rmse_n", ".3f"),
    "95 % interval holds": ("coverage95", ".1%"),
    "training, s": ("training_seconds", ".0f"),
}


def markdown(result: dict[str, Any]) -> str:
    """The result as tables for people."""
    lines = [
        "# Accuracy",
        "",
        f"Made by `{result['command']}` in {result['seconds']:.0f} s; {result['samples']:,} fresh "
        f"samples a setting, seed {result['seed']}: 0 to 200 N, one fifth of the samples without "
        "contact, sensor noise and step on. Contact counts *no contact* as a class; direction is "
        "over the contacts found; force over all contacts, an answer of none counting as 0 N. "
        "The paper's numbers are for a straight arm without noise and without contact-free "
        "samples.",
    ]

    def add(headings: str, rows: Iterable[str]) -> None:
        rule = "---" + " | ---" * (headings.count("|") + 1)
        table = (f"estimator | {headings}", rule, *rows)
        lines.extend(["", *(f"| {line} |" for line in table)])

    columns = list(_COLUMNS)
    for name, setting in result["single"].items():
        compared = {"**shipped model**": setting["shipped"], **setting["peers"]}
        compared |= {"noise bound": setting["bound"], "the paper": result["paper"]}
        lines += ["", f"## {_words(name)}"]
        add(
            " | ".join(columns),
            (f"{_words(n)} | {_cells(m, columns)}" for n, m in compared.items()),
        )
        ratio = setting["mae_over_bound_above_2_n"]
        lines += ["", f"Force MAE over that of the noise bound, above 2 N: {ratio:.2f}."]
        binned = {"shipped": setting["shipped"]}
        if two_stage := setting["peers"].get("two_stage"):
            binned["two stage"] = two_stage
        rows = (
            f"{label} | {part['low_n']:g}–{part['high_n']:g} | {_cells(part, columns[:3])}"
            for label, metrics in binned.items()
            for part in metrics["by_force"]
        )
        add(" | ".join(["force, N", *columns[:3]]), rows)
    lines += ["", "## several contacts"]
    rows = (
        f"{_words(name)} | {multi['recognition_accuracy']:.2%} | {multi['macro_f1']:.4f} | "
        + ", ".join(f"{value:.2f}" for value in multi["magnitude_mae_n"])
        for name, multi in result["multi"].items()
    )
    add("recognised | macro F1 | force MAE per segment, N", rows)
    lines += ["", "## Table II, physical rows"]
    rows = (
        f"{_words(name)} | segment {row['true_segment']}, {row['true_n']:.2f} N | "
        f"segment {row['segment']}, {row['magnitude_n']:.2f} N | "
        f"{row['off_from_down_deg']:+.2f}° | {row['magnitude_n'] / row['true_n'] - 1.0:+.1%}"
        for name, answers in result["table2"].items()
        for row in answers
    )
    add("true | estimated | off from down | error", rows)
    return "\n".join(lines) + "\n"


def _words(name: str) -> str:
    return name.replace("_", " ")


def _cells(metrics: dict[str, Any], columns: list[str]) -> str:
    found = ((metrics.get(key), form) for key, form in map(_COLUMNS.__getitem__, columns))
    return " | ".join("" if value is None else format(value, form) for value, form in found)


if __name__ == "__main__":
    main()
