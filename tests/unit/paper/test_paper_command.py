"""`python -m paper`: one line and an exit code for what is wrong, a report for what runs."""

import json

import pytest
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from paper.__main__ import app
from paper.study import FailedStudyError, StudyResult
from tests.helpers.paper_studies import failing, study


def invoke(*arguments):
    return CliRunner().invoke(app, [*arguments])


def test_a_study_alone_makes_a_report(tmp_path):
    result = invoke("--out", str(tmp_path / "report"), "--quick", "--only", "displacement")
    assert result.exit_code == 0, result.output
    results = json.loads((tmp_path / "report" / "results.json").read_text(encoding="utf-8"))
    assert [studies_done["name"] for studies_done in results["studies"]] == ["displacement"]
    assert (tmp_path / "report" / "report.html").is_file()


def test_after_a_failure_the_others_run_and_the_command_fails(tmp_path, monkeypatch):
    ran = []

    def work(quick, progress):
        ran.append(quick)
        return StudyResult("It ran.")

    chosen = (failing(ZeroDivisionError()), study(work, name="second"))
    monkeypatch.setattr("paper.study.chosen_studies", lambda only: chosen)
    result = invoke("--out", str(tmp_path / "report"))
    assert isinstance(result.exception, FailedStudyError)
    assert result.exception.exit_code == 1
    assert "1 of 2 studies failed: rope" in str(result.exception)
    assert ran == [False]
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "It ran." in page
    assert "ZeroDivisionError" in page


@pytest.mark.parametrize("missing", ["jinja2", "matplotlib"])
def test_a_missing_package_is_named_before_anything_is_made(missing, tmp_path, monkeypatch):
    def import_module(name):
        if name == missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr("paper.__main__.import_module", import_module)
    result = invoke("--out", str(tmp_path / "report"))
    assert isinstance(result.exception, ModuleNotFoundError)
    assert result.exception.name == missing
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["--out", "p", "--only", "fig99"], "no study 'fig99'; there are"),
        (["--out", "/proc/none"], "give another --out"),
    ],
)
def test_wrong_input_is_refused_with_a_remedy(arguments, remedy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = invoke(*arguments).exception
    assert isinstance(refused, CableSenseError)
    assert remedy in str(refused)
