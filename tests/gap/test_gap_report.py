"""The report: its first line says the verdict, each way out has its words, it stands alone."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording
from html_page import Page
from verdict_cases import gap_of, verdict_of

from cablesense_gap.report.inputs import ReportInputs
from cablesense_gap.report.page import report_page, write_report
from cablesense_gap.report.style import ReportError
from cablesense_gap.verdict import Candidate, Estimate, Estimator

pytestmark = pytest.mark.slow  # each page has five pictures to draw

SMALL = small_recording()
NOISE = np.random.default_rng(3).normal(0.0, 0.1, SMALL.tensions_n.shape)
PAYLOAD = verdict_of(
    "payload",
    0.93,
    others={"base_tilt": 0.07},
    segments=("segment_2",),
    parameters={"payload.segment_2.mass_kg": Estimate(value=0.4, unit="kg", ci95=(0.38, 0.42))},
    why=("Only a payload <pulls> like that.",),
    next_experiment="Load segment 2 downwards.",
    estimator=Estimator(before={"force MAE, N": 4.0}, after={"force MAE, N": 0.5}),
)


def inputs_of(verdict, **changes):
    inputs = ReportInputs(
        recording=SMALL,
        arm=LAB,
        verdict=verdict,
        predicted_before_n=SMALL.tensions_n + NOISE - 3.0,
        predicted_after_n=SMALL.tensions_n + NOISE,
    )
    return replace(inputs, **changes)


@pytest.fixture(scope="module")
def html():
    return report_page(inputs_of(PAYLOAD))


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_the_first_line_is_the_verdict(page):
    assert page.h1 == ("The gap comes from mass that nobody modelled, on segment 2 (93 % sure).")
    assert page.text.strip().startswith(page.h1)  # the title too


def test_it_says_what_to_do_and_shows_figures(page):
    for words in (
        "Use the amended arm file arm.yaml",
        "cablesense train --arm arm.yaml",
        "Load segment 2 downwards.",
        "0.400",
        "0.380 to 0.420",
        "Only a payload <pulls> like that.",
        "force MAE, N",
        "Nothing was missing",
    ):
        assert words in page.text, words


def test_it_stands_alone(page):
    assert len(page.sources) == 5
    for source in page.sources:
        kind, _, data = source.partition(";base64,")
        assert kind in ("data:image/png", "data:image/svg+xml")
        assert len(base64.b64decode(data)) > 1000


def test_none_says_to_keep_the_arm_and_shows_nothing_amended():
    verdict = verdict_of("none", 0.97, gap=gap_of(0.12, 0.12))
    near = SMALL.tensions_n + NOISE
    page = Page(report_page(inputs_of(verdict, predicted_before_n=near, predicted_after_n=near)))
    assert page.h1.startswith("Nothing to add")
    assert "Keep the nominal arm file" in page.text
    assert "amended" not in page.text.lower()
    assert "What remains" not in page.text


def test_unknown_warns_against_amending_and_says_where():
    verdict = verdict_of("unknown", 0.7, cables=("cable_1", "cable_2"))
    page = Page(report_page(inputs_of(verdict)))
    assert page.h1 == (
        "Something that no known effect explains makes a gap of 3.00 N, at cables 1 and 2 "
        "(70 % sure)."
    )
    assert "Do not amend the arm file" in page.text
    assert "Use the amended" not in page.text


def test_held_out_predictions_with_gaps_and_findings_are_shown_for_what_they_are():
    held_out = SMALL.tensions_n + 2.0 * NOISE
    held_out[SMALL.trial == 0] = np.nan
    inputs = inputs_of(PAYLOAD, held_out_n=held_out, findings=("cable_4 <hung>",))
    page = Page(report_page(inputs))
    assert "by a fit that has not seen it" in page.text
    assert "0.20 N RMS" in page.text
    assert "cable_4 <hung>" in page.text
    assert "Nothing was missing" not in page.text


def test_it_is_written_whole_small_and_the_same_each_time(tmp_path, html):
    path = tmp_path / "report.html"
    write_report(path, inputs_of(PAYLOAD))
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    assert path.stat().st_size < 3_000_000
    assert path.read_text(encoding="utf-8") == html


def test_a_place_that_cannot_be_written_to_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("cablesense_gap.report.page.report_page", lambda _: "page")
    with pytest.raises(ReportError, match="cannot be written"):
        write_report(tmp_path / "nowhere" / "report.html", inputs_of(PAYLOAD))


def test_readings_without_noise_can_be_shown_too():
    verdict = verdict_of(
        "none",
        1.0,
        gap=gap_of(0.0, 0.0, floor_n=0.0),
    ).model_copy(
        update={
            "candidates": (Candidate(effects=("none",), held_out_rmse_n=0.0, probability=1.0),)
        }
    )
    exact = SMALL.tensions_n
    inputs = inputs_of(verdict, predicted_before_n=exact, predicted_after_n=exact)
    assert Page(report_page(inputs)).h1.startswith("Nothing to add: the gap of 0.00 N")


def test_a_long_recording_is_drawn_small_and_soon():
    times = 60
    many = replace(
        SMALL.rows(np.tile(np.arange(len(SMALL)), times)),
        time_s=np.arange(times * len(SMALL)) / 5.0,
    )
    noise = np.tile(NOISE, (times, 1))
    html = report_page(
        ReportInputs(many, LAB, PAYLOAD, many.tensions_n + noise + 1.0, many.tensions_n + noise)
    )
    assert len(html) < 3_000_000
    assert f"{len(many):,} rows" in html


def test_a_number_of_the_only_place_is_shown_with_that_place():
    alone = {"payload.mass_kg": Estimate(value=0.4, unit="kg", ci95=(0.38, 0.42))}
    page = report_page(inputs_of(PAYLOAD.model_copy(update={"parameters": alone})))
    assert "<td>segment 2</td><td>mass_kg</td>" in page
