"""The file of a result: what made it, on which machine, written whole or not at all."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[1] / "results"


def with_origin(command: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """The result, after the command, the time and the machine that made it."""
    return {
        "command": command,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": f"{platform.machine()}, {os.cpu_count()} CPUs",
        "python": platform.python_version(),
        "rclpy": version("rclpy"),
        **result,
    }


def write_result(name: str, result: Mapping[str, Any]) -> Path:
    """Put the result into its file; gives the path."""
    path = RESULTS / name
    path.parent.mkdir(exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    part.replace(path)
    return path
