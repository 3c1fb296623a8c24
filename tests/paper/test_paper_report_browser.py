"""The report in a real Chromium: every picture is drawn, and nothing is wider than the page."""

import json
import re
import shutil
import subprocess

import pytest
from paper_studies import failing, ignore

from cablesense_paper.report import paper_page
from cablesense_paper.study import chosen_studies, run_study

pytestmark = [pytest.mark.browser, pytest.mark.slow]

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ASKED = """<script>addEventListener("load", () => {
  document.title = JSON.stringify({
    drawn: [...document.images].map(image => image.naturalWidth),
    wide: document.documentElement.scrollWidth,
    sections: document.querySelectorAll("section").length,
    anchors: [...document.querySelectorAll("nav a")].every(
      a => document.querySelector(a.getAttribute("href"))),
  });
});</script>"""


@pytest.fixture(scope="module")
def program():
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"no Chromium on PATH ({', '.join(BROWSERS)}); install one to test the page")
    return program


@pytest.mark.parametrize("width", [1200, 500])
def test_the_page_is_whole_and_fits(program, tmp_path, width):
    chosen = chosen_studies(["pretension", "table_2"])
    real = [run_study(one, True, ignore) for one in chosen]
    failed = run_study(failing(ZeroDivisionError("a long line " * 60)), True, ignore)
    page = paper_page([*real, failed], quick=True)
    path = tmp_path / "report.html"
    path.write_text(page.replace("</body>", f"{ASKED}</body>"), encoding="utf-8")
    command = [
        program, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
        f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},900",
        "--virtual-time-budget=5000", "--dump-dom", path.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=60)
    title = re.search(r"<title>(\{.*?\})</title>", done.stdout)
    assert title, done.stderr[-500:]
    seen = json.loads(title[1])
    assert len(seen["drawn"]) == 4
    assert all(pixels > 1000 for pixels in seen["drawn"])
    assert seen["sections"] == 3
    assert seen["anchors"]
    assert seen["wide"] <= width
