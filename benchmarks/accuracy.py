"""Accuracy of every estimator in every setting, on the same fresh samples, beside the noise bound.

    python benchmarks/accuracy.py [--samples 100000] [--quick] [--write]

The shipped models and their bundled baselines answer as ONNX files. Baselines too large or too
many to ship are trained here, by their recipes and with seed 0: gradient boosting in every
setting, the decoupled networks and shared backbone of the paper on the straight arm and at random
poses. `--write` puts `accuracy.json` and the tables `accuracy.md` into `benchmarks/results/`.
"""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from typing import Any

import harness

from cablesense_sim.arm import open_arm
from cablesense_training.baselines import BoostingBaseline, BoostingSettings
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.evaluation.comparison import (
    MULTI_ARM,
    SETTINGS,
    SHIPPED,
    TABLE2_MODELS,
    Setting,
    SettingEvaluation,
    evaluate_answer,
    evaluate_multi_models,
    evaluate_setting,
    metrics_json,
    multi_protocol,
)
from cablesense_training.evaluation.table2 import evaluate_table2
from cablesense_training.fit import FitSettings, fit
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.model_training import single_contact_answer
from cablesense_training.networks import SingleContactNetwork
from cablesense_training.recipes import build_network, recipe_for

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
    options = parser.parse_args()
    start = time.perf_counter()
    result: dict[str, Any] = {
        **harness.origin(),
        "seed": TEST_SEED,
        "samples": options.samples,
        "paper": PAPER,
        "single": {},
    }
    for setting in SETTINGS:
        print(f"{setting.name} …", file=sys.stderr, flush=True)
        dataset = draw_dataset(
            setting.arm, setting.protocol(options.samples), TEST_SEED, workers=options.workers
        )
        evaluation = evaluate_setting(setting, dataset)
        extra = {} if options.quick else _trained_baselines(setting, dataset, options.workers)
        result["single"][setting.name] = _setting_json(evaluation, extra)
    multi = draw_dataset(
        open_arm(MULTI_ARM), multi_protocol(options.samples), TEST_SEED, workers=options.workers
    )
    result["multi"] = {
        name: asdict(found.metrics) for name, found in evaluate_multi_models(multi).items()
    }
    result["table2"] = {name: _table2_rows(model) for name, model in TABLE2_MODELS.items()}
    result["seconds"] = time.perf_counter() - start
    table = markdown(result)
    print(table)
    if options.write:
        harness.write_result("accuracy.json", result)
        harness.write_result("accuracy.md", table)


def _trained_baselines(setting: Setting, test: Dataset, workers: int) -> dict[str, Any]:
    """Errors of the baselines that are trained here, with the seconds their training took."""
    baselines: dict[str, Any] = {}
    names = TRAINED_HERE.get(setting.name, ())
    samples = max([BOOSTING_SAMPLES, *(recipe_for(name).samples for name in names)])
    training = draw_dataset(setting.arm, setting.protocol(samples), TRAIN_SEED, workers=workers)
    for name in names:
        print(f"  training {name} …", file=sys.stderr, flush=True)
        recipe, network = recipe_for(name), build_network(name, setting.arm, TRAIN_SEED)
        assert isinstance(network, SingleContactNetwork)
        assert isinstance(recipe.settings, FitSettings)
        history = fit(network, training.select(slice(recipe.samples)), recipe.settings)
        answer = single_contact_answer(network.double(), test)
        metrics = evaluate_answer(answer, test).metrics
        baselines[name] = {**metrics_json(metrics), "training_seconds": history.seconds}
    print("  training gradient boosting …", file=sys.stderr, flush=True)
    start = time.perf_counter()
    aware = setting.name in ("random_pose", "compliant")
    boosting = BoostingBaseline(
        training.select(slice(BOOSTING_SAMPLES)), BoostingSettings(pose_aware=aware)
    )
    seconds = time.perf_counter() - start
    metrics = evaluate_answer(boosting.answer(test), test).metrics
    baselines["gradient_boosting"] = {**metrics_json(metrics), "training_seconds": seconds}
    return baselines


def _setting_json(evaluation: SettingEvaluation, extra: dict[str, Any]) -> dict[str, Any]:
    shipped, errors = evaluation.models[SHIPPED], evaluation.models[SHIPPED].errors
    bundled = {n: metrics_json(m) for n, m in evaluation.models.items() if n != SHIPPED}
    return {
        "shipped": {
            **metrics_json(shipped),
            "magnitude_coverage95": errors.magnitude_coverage95,
            "direction_coverage95": errors.direction_coverage95,
        },
        "mae_over_bound_above_2_n": evaluation.firm_ratio,
        "bound": asdict(evaluation.bound),
        "peers": {**bundled, **extra},
        "confusion": [list(row) for row in shipped.confusion],
    }


def _table2_rows(model: str) -> list[dict[str, float]]:
    return [
        {
            "true_segment": a.load.segment,
            "true_n": a.load.weight_n,
            "segment": a.segment,
            "magnitude_n": a.magnitude_n,
            "off_from_down_deg": a.angle_error_deg,
        }
        for a in evaluate_table2(Estimator.load(find_model(model)))
    ]


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
    headings = [heading for heading, _, _ in _COLUMNS]
    for name, setting in result["single"].items():
        lines += ["", f"## {name.replace('_', ' ')}", "", *_head("estimator", *headings)]
        lines.append(_row("**shipped model**", setting["shipped"]))
        lines += [_row(baseline.replace("_", " "), m) for baseline, m in setting["peers"].items()]
        lines.append(_row("noise bound", setting["bound"]))
        lines.append(_row("the paper", result["paper"]))
        ratio = setting["mae_over_bound_above_2_n"]
        lines += ["", f"Force MAE over that of the noise bound, above 2 N: {ratio:.2f}.", ""]
        columns = ("force, N", "contact", "direction MAE, °", "force MAE, N")
        lines += _head("estimator", *columns)
        lines += _bin_rows("shipped", setting["shipped"])
        lines += _bin_rows("two stage", setting["peers"]["two_stage"])
    lines += ["", "## several contacts", ""]
    lines += _head("estimator", "recognised", "macro F1", "force MAE per segment, N")
    for name, multi in result["multi"].items():
        errors = ", ".join(f"{value:.2f}" for value in multi["magnitude_mae_n"])
        lines.append(
            f"| {name.replace('_', ' ')} | {multi['recognition_accuracy']:.2%} "
            f"| {multi['macro_f1']:.4f} | {errors} |"
        )
    lines += ["", "## Table II, physical rows", ""]
    lines += _head("estimator", "true", "estimated", "off from down", "error")
    for name, rows in result["table2"].items():
        for row in rows:
            error = row["magnitude_n"] / row["true_n"] - 1.0
            lines.append(
                f"| {name.replace('_', ' ')} "
                f"| segment {row['true_segment']}, {row['true_n']:.2f} N "
                f"| segment {row['segment']}, {row['magnitude_n']:.2f} N "
                f"| {row['off_from_down_deg']:+.2f}° | {error:+.1%} |"
            )
    return "\n".join(lines) + "\n"


_COLUMNS = (
    ("contact", "contact_accuracy", ".2%"),
    ("direction MAE, °", "direction_mae_deg", ".3f"),
    ("force MAE, N", "magnitude_mae_n", ".3f"),
    ("force RMSE, N", "magnitude_rmse_n", ".3f"),
    ("95 % interval holds", "coverage95", ".1%"),
    ("training, s", "training_seconds", ".0f"),
)


def _head(*columns: str) -> list[str]:
    return [f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}"]


def _row(name: str, metrics: dict[str, Any]) -> str:
    cells = [
        format(metrics[key], form) if metrics.get(key) is not None else ""
        for _, key, form in _COLUMNS
    ]
    return f"| {' | '.join([name, *cells])} |"


def _bin_rows(name: str, metrics: dict[str, Any]) -> list[str]:
    return [
        f"| {name} | {b['low_n']:g}–{b['high_n']:g} | {b['contact_accuracy']:.2%} "
        f"| {b['direction_mae_deg']:.3f} | {b['magnitude_mae_n']:.3f} |"
        for b in metrics["by_force"]
    ]


if __name__ == "__main__":
    main()
