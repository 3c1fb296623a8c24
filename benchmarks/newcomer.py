"""How long a newcomer waits: from a fresh clone to the page, and to an estimator of an own arm.

The lines are those of docs/tutorial.md, up to the one that makes the estimator. uv's cache is
empty at first; what pip installs comes from its cache where it has it.
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

import harness

ROOT = Path(__file__).parents[1]
PICTURE_S = 120.0
ESTIMATOR_S = 360.0
MAKES_ONE = ("cablesense export", "cablesense train")
ADDRESS = re.compile(r"http://\S+")


def tutorial_lines() -> list[str]:
    """The lines after the first demo, up to the one that makes an estimator."""
    page = (ROOT / "docs/tutorial.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", "").splitlines()]
    makes = next(n for n, line in enumerate(lines) if line.startswith(MAKES_ONE))
    return [line for line in lines[1 : makes + 1] if not line.startswith(". ")]


def page_answers_s(clone: Path) -> float:
    """When the page of `make demo` answers, s on the monotonic clock."""
    command = ["make", "demo", "ARGS=--no-open"]
    demo = subprocess.Popen(
        command, cwd=clone, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        assert demo.stdout is not None
        for line in demo.stdout:
            if address := ADDRESS.search(line):
                urllib.request.urlopen(address[0]).read()
                return time.monotonic()
        raise SystemExit(f"make demo ended with {demo.wait()}")
    finally:
        os.killpg(demo.pid, signal.SIGINT)
        demo.wait()


def main() -> None:
    """Measures in the order of the tutorial, prints; writes with `--write`."""
    options = harness.parser(__doc__, "newcomer.json").parse_args()
    lines_s: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "cablesense"
        os.environ["UV_CACHE_DIR"] = f"{folder}/uv"
        began = time.monotonic()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        picture_s = page_answers_s(clone) - began
        os.environ["PATH"] = f"{clone}/.venv/bin{os.pathsep}{os.environ['PATH']}"
        for line in tutorial_lines():
            since = time.monotonic()
            subprocess.run(["bash", "-c", line], cwd=clone, check=True)
            lines_s[line] = round(time.monotonic() - since, 1)
        estimator_s = picture_s + sum(lines_s.values())
    result = {
        "first_picture_s": round(picture_s, 1),
        "lines_s": lines_s,
        "estimator_s": round(estimator_s, 1),
        "bars": {
            f"first picture within {PICTURE_S:g} s": picture_s <= PICTURE_S,
            f"estimator within {ESTIMATOR_S:g} s": estimator_s <= ESTIMATOR_S,
        },
    }
    harness.publish("newcomer.json", result, options)


if __name__ == "__main__":
    main()
