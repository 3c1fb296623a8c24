"""What a stranger meets first: the site, the workflow and the forms."""

import json
import re
import subprocess
import sys
from importlib import import_module

import pytest
import yaml

from tests.helpers.checkout import CHECKOUT

PACKAGES = ("cablesense_sim", "cablesense_training", "cablesense_gap", "cablesense_online")


@pytest.mark.slow
def test_the_site_builds_with_every_link_right_and_every_public_name(tmp_path):
    build = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    done = subprocess.run(
        [*build, "--site-dir", tmp_path], cwd=CHECKOUT, capture_output=True, check=False, text=True
    )
    assert done.returncode == 0, done.stderr
    for package in PACKAGES:
        page = (tmp_path / "api" / package / "index.html").read_text(encoding="utf-8")
        shown = set(re.findall(rf'<h2 id="{package}\.([\w.]+)"', page))
        assert shown == set(import_module(package).__all__), package
    index = json.loads((tmp_path / "search/search_index.json").read_text(encoding="utf-8"))
    titles = [entry["title"].lower() for entry in index["docs"]]
    assert any(title.startswith("stop when the force") for title in titles), "what people ask for"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("schema", "files"),
    [
        ("github-workflows", ".github/workflows/*.yml"),
        ("github-issue-forms", ".github/ISSUE_TEMPLATE/*.yml"),
        ("citation-file-format", "CITATION.cff"),
    ],
)
def test_files_for_hosts_follow_their_schemas(schema, files):
    found = sorted(CHECKOUT.glob(files))
    assert found
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*check, *found], capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stdout


def test_every_page_is_in_the_navigation():
    configuration = (CHECKOUT / "mkdocs.yml").read_text(encoding="utf-8")
    navigation = configuration[configuration.index("\nnav:") :]
    named = set(re.findall(r"(?m)(\S+\.md)$", navigation))
    docs = CHECKOUT / "docs"
    assert {str(page.relative_to(docs)) for page in docs.rglob("*.md")} <= named


def test_the_workflow_runs_the_commands_of_the_readme():
    workflow = yaml.safe_load((CHECKOUT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    run = [step["run"] for step in job["steps"] if "run" in step]
    readme = (CHECKOUT / "README.md").read_text(encoding="utf-8")
    assert run == ["make demo ARGS=--headless", "make test"]
    assert all(command in readme for command in run)
