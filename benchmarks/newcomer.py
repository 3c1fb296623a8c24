"""How long a newcomer waits: from a fresh clone to the page, and to an estimator of an own arm.

The lines are those of docs/tutorial.md, up to the one that trains. uv's cache is empty at first;
what pip installs comes from its cache where it has it.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

from harness import parser, publish

ROOT = Path(__file__).parents[1]
BARS_S = {"first_picture_s": 120.0, "trained_estimator_s": 360.0}
ADDRESS = re.compile(r"http://\S+")


def tutorial_lines() -> list[str]:
    """The lines after the first demo, up to the one that trains."""
    page = (ROOT / "docs/tutorial.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", "").splitlines()]
    trains = next(n for n, line in enumerate(lines) if line.startswith("cablesense train"))
    return [line for line in lines[1 : trains + 1] if not line.startswith(". ")]


def seconds_to_page(clone: Path) -> float:
    """From `make demo` until its page answers, s."""
    began = time.monotonic()
    demo = subprocess.Popen(
        ["make", "demo", "ARGS=--no-open"],
        cwd=clone,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert demo.stdout is not None
        for line in demo.stdout:
            if found := ADDRESS.search(line):
                urllib.request.urlopen(found[0]).read()
                return time.monotonic() - began
        raise SystemExit(f"make demo ended with {demo.wait()}")
    finally:
        os.killpg(demo.pid, signal.SIGINT)
        demo.wait()


def measure() -> dict[str, Any]:
    """The times, in the order of the tutorial."""
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "cablesense"
        os.environ["UV_CACHE_DIR"] = f"{folder}/uv"
        began = time.monotonic()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        cloned_s = time.monotonic() - began
        result["first_picture_s"] = round(cloned_s + seconds_to_page(clone), 1)
        began = time.monotonic()
        result["lines_s"] = {}
        path = f"{clone}/.venv/bin{os.pathsep}{os.environ['PATH']}"
        for line in tutorial_lines():
            since = time.monotonic()
            subprocess.run(
                ["bash", "-c", line], cwd=clone, env=os.environ | {"PATH": path}, check=True
            )
            result["lines_s"][line] = round(time.monotonic() - since, 1)
        trained_s = result["first_picture_s"] + time.monotonic() - began
        result["trained_estimator_s"] = round(trained_s, 1)
    result["bars_kept"] = {name: result[name] <= most_s for name, most_s in BARS_S.items()}
    return result


if __name__ == "__main__":
    options = parser(__doc__, "newcomer.json").parse_args()
    publish("newcomer.json", measure(), options)
