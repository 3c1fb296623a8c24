"""A folder of verdicts: `RECORDING/verdict.json`, or `RECORDING.json`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cablesense_gap.scoring.score_error import ScoreError
from cablesense_gap.verdict import Verdict, read_verdict


def read_verdicts(folder: str | Path, recordings: Iterable[str]) -> dict[str, Verdict]:
    """Read the verdicts on these recordings; what else lies in the folder is left alone.

    Raises:
        ScoreError: no such folder; a recording without a verdict, or with two.
        VerdictError: a file is no verdict.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ScoreError(f"{folder}: no such folder; give the one that holds the verdicts")
    found, missing = {}, []
    for name in recordings:
        paths = [
            path
            for path in (folder / name / "verdict.json", folder / f"{name}.json")
            if path.is_file()
        ]
        if len(paths) > 1:
            raise ScoreError(f"{folder}: has {name}/verdict.json and {name}.json; keep one")
        if paths:
            found[name] = read_verdict(paths[0])
        else:
            missing.append(name)
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ScoreError(
            f"{folder}: no verdict on {missing[0]}{more}; every recording of the answers needs "
            f"its {missing[0]}/verdict.json or {missing[0]}.json"
        )
    return found
