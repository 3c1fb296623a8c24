"""A verdict as a file: what is written is read again, and what cannot be is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from cablesense_gap.report.text import headline
from cablesense_gap.verdict import (
    CandidateResult,
    EstimatorErrors,
    FittedNumber,
    Gap,
    Verdict,
    VerdictError,
    Where,
    read_verdict,
    removed_fraction,
    write_verdict,
)

VERDICT = Verdict(
    effects=("payload",),
    probability=0.93,
    ambiguity_group=("payload",),
    next_experiment="Load segment 2 downwards.",
    where=Where(segments=("segment_2",), regimes=("bent poses",)),
    parameters={"payload.mass_kg": FittedNumber(value=0.4, unit="kg", ci95=(0.38, 0.42))},
    gap=Gap(
        before_n=3.0,
        after_n=0.2,
        floor_n=0.1,
        removed_fraction=0.966,
        ci95=(0.95, 0.97),
        by_cable_n=(3.0,) * 12,
    ),
    candidates=(
        CandidateResult(effects=("none",), held_out_rmse_n=3.0, probability=0.0),
        CandidateResult(effects=("payload",), held_out_rmse_n=0.2, probability=0.93),
        CandidateResult(
            effects=("base_tilt", "payload"),
            held_out_rmse_n=0.2,
            probability=0.07,
            held_out_ci95_n=(0.1, 0.3),
        ),
    ),
    seconds=12.0,
    rows=600_000,
    rows_used=6_000,
)


def written(**changes: Any) -> str:
    return json.dumps({**json.loads(VERDICT.model_dump_json(exclude_none=True)), **changes})


def test_a_verdict_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "verdict.json"
    trained = EstimatorErrors(before={"force_mae_n": 4.0}, after={"force_mae_n": 1.0})
    for verdict in (VERDICT, VERDICT.model_copy(update={"estimator": trained})):
        write_verdict(path, verdict)
        assert read_verdict(path) == verdict
    assert [name.name for name in tmp_path.iterdir()] == ["verdict.json"]
    assert "null" not in path.read_text()


def against(**shares: float) -> dict[str, Any]:
    """A reference that covers these shares of the channels."""
    coverage = {name: {"share": share} for name, share in shares.items()}
    return {"recording": "healthy", "before_n": 1.0, "left_n": 0.5, "coverage": coverage}


def none_with(probability: float) -> dict[str, Any]:
    return {"effects": ["none"], "held_out_rmse_n": 1.0, "probability": probability}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"effects": []}, "effects"),
        ({"effects": ["payload", "base_tilt"]}, "alphabetical order"),
        ({"effects": ["payload", "payload"]}, "each once"),
        ({"effects": ["none", "payload"]}, "none must stand alone"),
        ({"effects": ["payload", "unknown"]}, "unknown must stand alone"),
        ({"effects": ["cannot_tell", "payload"]}, "cannot_tell must stand alone"),
        ({"effects": "payload"}, "effects"),
        ({"probability": 1.2}, "probability"),
        ({"probability": "0.9"}, "probability"),
        ({"where": {"cables": ["cable 3"]}}, r"where.cables.*'cable 3'.*cable_\["),
        ({"where": {"segments": ["segment_0"]}}, "where.segments"),
        ({"parameters": {"mass": {"value": 1.0, "unit": "kg", "ci95": [0, 2]}}}, "parameters"),
        ({"parameters": {"a.b": {"value": 1.0, "unit": "kg", "ci95": [2, 0]}}}, "lower, upper"),
        ({"parameters": {"a.b": {"value": 1.0, "unit": "kg", "ci95": [2]}}}, "ci95"),
        ({"confidence": 0.9}, "confidence"),
        ({"candidates": [none_with(0.6)] * 2}, "add up"),
        ({"candidates": [none_with(0.2)] * 2}, "twice"),
        ({"effects": ["cannot_tell"]}, "against a reference"),
        ({"effects": ["cannot_tell"], "reference": against()}, "less than 50% is covered"),
        ({"effects": ["cannot_tell"], "reference": against(cable_1=0.7)}, "reference.coverage"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    tmp_path: Path, changes: dict[str, Any], says: str
) -> None:
    path = tmp_path / "verdict.json"
    path.write_text(written(**changes))
    with pytest.raises(VerdictError, match=says) as refused:
        read_verdict(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_a_verdict_that_cannot_tell_has_a_first_line(tmp_path: Path) -> None:
    path = tmp_path / "verdict.json"
    path.write_text(written(effects=["cannot_tell"], reference=against(cable_1=0.7, cable_2=0.1)))
    assert "which covers 10 % of cable 2:" in headline(read_verdict(path))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "JSON"),
        (b"{", "JSON"),
        (b"[]", "verdict.json"),
        (b'{"effects": ["none"]}', "where|probability"),
        (b"\xff\xfe\x00", "as text"),
        (None, "No such file"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes | None, says: str) -> None:
    path = tmp_path / "verdict.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(VerdictError, match=says):
        read_verdict(path)
    with pytest.raises(VerdictError, match="cannot be written"):
        write_verdict(tmp_path / "nowhere" / "verdict.json", VERDICT)


def test_the_removed_share_counts_what_can_be_removed() -> None:
    assert removed_fraction(10.0, 1.0, 1.0) == 1.0
    assert removed_fraction(10.0, 10.0, 1.0) == 0.0
    assert removed_fraction(11.0, 6.0, 1.0) == pytest.approx(0.5)
    assert removed_fraction(10.0, 12.0, 1.0) < 0.0
    assert removed_fraction(0.9, 0.8, 1.0) == 0.0
    assert removed_fraction(10.0, 0.9, 1.0) == 1.0
