"""A score sheet as JSON."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

from cablesense_gap.scoring.proportion import Proportion
from cablesense_gap.scoring.score import Score


def as_json(score: Score) -> dict[str, Any]:
    """The score as plain values; a proportion becomes its value, interval and counts."""
    figures = {field.name: _plain(getattr(score, field.name)) for field in fields(score)}
    figures["calibration"] = asdict(score.calibration)
    return figures


def _plain(value: Any) -> Any:
    if isinstance(value, Proportion):
        return value.as_json()
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return list(value) if isinstance(value, tuple) else value
