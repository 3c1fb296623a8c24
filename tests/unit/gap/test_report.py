"""The report: its first line is the verdict, it says what to do, and it stands alone."""

from __future__ import annotations

import base64
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from cablesense_gap.amended_arm import amended_arm
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.report.page import overlay_picture, report_page, write_diagnosis
from cablesense_gap.report.text import headline, size_lines
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import (
    ChannelGap,
    EstimatorErrors,
    FittedNumber,
    Share,
    UnlistedBeside,
    read_verdict,
)
from cablesense_sim.arm import load_arm
from tests.helpers.expected_parameters import expected_parameters
from tests.helpers.gap_recordings import LAB, small_recording
from tests.helpers.html_page import Page, draw_no_pictures
from tests.helpers.verdict_cases import gap_of, verdict_of

pytestmark = pytest.mark.slow  # each page has pictures to draw

SMALL = small_recording()
NOISE = np.random.default_rng(3).normal(0.0, 0.1, SMALL.tensions_n.shape)
PAYLOAD = verdict_of(
    "payload",
    0.93,
    others={"base_tilt": 0.07},
    segments=("segment_2",),
    parameters={
        "payload.segment_2.mass_kg": FittedNumber(value=0.4, unit="kg", ci95=(0.38, 0.42))
    },
    why=("Only a payload <pulls> like that.",),
    next_experiment="Load segment 2 downwards.",
    estimator=EstimatorErrors(before={"force MAE, N": 4.0}, after={"force MAE, N": 0.5}),
)


def found(
    verdict,
    recording=SMALL,
    before_n=NOISE - 3.0,
    after_n=NOISE,
    notes=(),
    warnings=(),
    counted=True,
):
    """A diagnosis with such residuals before and after, negated."""
    before_n = recording.tensions_n + before_n
    after_n = recording.tensions_n + after_n
    rows = np.broadcast_to(counted, len(recording))
    known = expected_parameters(LAB)
    return Diagnosis(recording, LAB, verdict, LAB, before_n, after_n, rows, known, notes, warnings)


@pytest.fixture(scope="module")
def html():
    return report_page(found(PAYLOAD))


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


@pytest.fixture
def text_of(monkeypatch):
    """The text of a diagnosis's page, its title first."""
    draw_no_pictures(monkeypatch)
    return lambda verdict, **made: " ".join(Page(report_page(found(verdict, **made))).text.split())


def test_the_first_line_is_the_verdict(page):
    assert page.h1 == ("The gap comes from mass that nobody modelled, on segment 2 (93 % sure).")
    assert page.text.strip().startswith(page.h1)  # the title too


def test_it_says_what_to_do_and_shows_figures(page):
    for words in (
        "Use the new estimator",
        "ros2 run cablesense_ros estimator",
        "Load segment 2 downwards.",
        "0.400",
        "0.380 to 0.420",
        "Only a payload <pulls> like that.",
        "force MAE, N",
        "Nothing was missing",
    ):
        assert words in page.text, words


def test_it_stands_alone(page):
    assert len(page.sources) == 3
    for source in page.sources:
        kind, _, data = source.partition(";base64,")
        assert kind in ("data:image/png", "data:image/svg+xml")
        assert len(base64.b64decode(data)) > 1000


@pytest.mark.parametrize("numbers", [(-7, -3), (5, 1_000_000_000)])
def test_the_picture_of_the_worst_trial_has_its_number_whatever_that_is(monkeypatch, numbers):
    monkeypatch.setattr("cablesense_gap.report.page.as_uri", lambda figure, _kind: figure)
    is_later = np.arange(len(SMALL)) >= len(SMALL) // 2
    recording = replace(SMALL, trial=np.where(is_later, numbers[1], numbers[0]))
    before_n = np.where(is_later[:, None], 1.0, 0.1) * np.ones_like(NOISE)
    figure = overlay_picture(found(PAYLOAD, recording, before_n=before_n))
    _, of_trial = figure.axes
    title = of_trial.get_title()
    plt.close(figure)
    assert f"trial {numbers[1]}, where its gap is largest" in title


def test_what_was_read_of_a_bag_is_no_reason_to_check_it(text_of):
    note = "Topics are /cable_tensions, /commands and /loads."
    text = text_of(PAYLOAD, notes=(note,))
    assert note in text
    assert "Check the recording first" not in text
    assert "Nothing was missing" in text


def test_a_warning_comes_before_what_to_do(text_of):
    text = text_of(PAYLOAD, notes=("Topics are these.",), warnings=("cable_3 stands still",))
    first, rest = text.split("Check the recording first.")
    assert "Topics are these." in first
    assert rest.strip().startswith("cable_3 stands still")
    assert "Nothing was missing" not in text


def test_none_keeps_the_arm_and_shows_nothing_amended(text_of):
    text = text_of(verdict_of("none", 0.97, gap=gap_of(0.12, 0.12)), before_n=NOISE)
    assert text.startswith("Nothing to add")
    assert "Keep the nominal arm file" in text
    assert "amended" not in text.lower()
    assert "What remains" not in text


def test_unknown_warns_against_amending_and_names_places(text_of):
    text = text_of(verdict_of("unknown", 0.7, cables=("cable_1", "cable_2")))
    assert text.startswith(
        "Something that no known effect explains makes a gap of 3.00 N, at cables 1 and 2 "
        "(70 % sure)."
    )
    assert "Do not amend the arm file" in text
    assert "Use the amended" not in text


@pytest.mark.parametrize(
    ("value", "ci95", "words"),
    [
        (0.5, (0.43, 0.5), "at least 0.430; its range ends at 0.500"),
        (-0.5, (-0.5, -0.44), "at most -0.440; its range ends at -0.500"),
        (0.5, (-0.5, 0.5), "anywhere in its range"),
        (0.4, (0.3, 0.5), "0.30 to 0.50"),
    ],
)
def test_a_number_at_an_end_of_its_range_is_known_to_one_side(text_of, value, ci95, words):
    number = FittedNumber(value=value, unit="1", ci95=ci95)
    text = text_of(verdict_of("payload", parameters={"payload.segment_2.beyond_middle": number}))
    assert words in text
    assert "beyond the segment's middle, as a share of the segment's length" in text


@pytest.mark.parametrize(
    ("effects", "probability", "others", "begins", "ends"),
    [
        ("payload", 0.93, {}, "The gap comes from", "(93 % sure)."),
        (
            "payload",
            0.37,
            {"base_tilt": 0.32, "unknown": 0.29, "none": 0.02},
            "The gap may come from",
            "(most likely of three, 37 %).",
        ),
        ("payload", 0.32, {"unknown": 0.4}, "The gap may come from", "(one of two, 32 %)."),
        ("unknown", 0.4, {"payload": 0.35}, "Something that", "(most likely of two, 40 %)."),
    ],
)
def test_probable_is_said_of_more_than_half_alone(effects, probability, others, begins, ends):
    said = headline(verdict_of(effects, probability, others=others))
    assert said.startswith(begins)
    assert said.endswith(ends)


def test_each_of_several_effects_has_its_own_probability():
    def share(probability):
        return Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.2, probability=probability)

    shares = {"payload": share(0.997), "sensor_gain": share(0.57)}
    said = headline(verdict_of("payload+sensor_gain", 0.57, shares=shares))
    payload, gain = said.split(", and probably comes from ")
    assert payload.startswith("The gap comes from ")
    assert payload.endswith("(> 99 %)")
    assert gain.endswith("(57 %); together they are 57 % sure.")


def cable(before, after, unlisted=0.0, effects=()):
    return ChannelGap(
        unit="N",
        before=before,
        after=after,
        floor=0.1,
        removed_fraction=(before - after) / (before - 0.1),
        effects=effects,
        unlisted=unlisted,
    )


PART = verdict_of(
    "payload",
    0.9,
    others={"unknown": 0.05},
    shares={"payload": Share(share_n=1.0, ci95_n=(0.9, 1.1), left_n=0.2, probability=0.97)},
    tolerances_n=0.1,
    unexplained_n=1.9,
    unexplained_share=0.6,
    channels={"cable_1": cable(3.0, 0.1, effects=("payload",)), "cable_2": cable(3.1, 2.1, 0.98)},
    unlisted=UnlistedBeside(probability=0.95, channels=("cable_2",), before_n=3.1, after_n=2.1),
)


def test_the_certain_part_comes_first_then_the_rest_in_its_unit_and_per_cent():
    assert headline(PART) == (
        "Part of the gap comes from mass that nobody modelled (97 %); cable 2 keeps 2.1 N, 67 % "
        "of its gap, which nothing in the list explains."
    )
    many = {f"cable_{n}": cable(1.1, 0.8 + 0.02 * n, 0.9) for n in range(1, 6)}
    of_many = PART.model_copy(
        update={
            "channels": many,
            "unlisted": UnlistedBeside(probability=0.9, channels=tuple(many)),
        }
    )
    assert "5 of 5 cables keep 72 to 80 % of their gaps" in headline(of_many)


def test_the_report_has_a_verdict_by_cable(text_of):
    text = text_of(PART)
    assert "The verdict by cable" in text
    assert "something unlisted acts here (98 %)" in text
    assert "Something that no known effect explains acts as well (95 % sure)" in text
    assert "the gap goes from 3.10 N to 2.10 N." in text


def test_a_candidate_beside_something_unlisted_has_another_name(text_of):
    alone, other = PAYLOAD.candidates
    beside = alone.model_copy(update={"unlisted": True, "probability": 0.05})
    text = text_of(PAYLOAD.model_copy(update={"candidates": (beside, alone, other)}))
    listed = text.split("The candidates")[1]
    assert "payload + something unlisted 1.000" in listed
    assert "payload 1.000" in listed


@pytest.mark.parametrize(
    ("effects", "after_n", "words"),
    [
        ("payload", 0.2, "amended arm shrinks the gap from 3.00 N to 0.20 N on trials"),
        ("payload", 3.2, "does not shrink"),
        ("unknown", 0.2, "flexible correction, which knows no physics, shrinks the gap"),
        ("unknown", 3.0, "No effect of the library shrinks it"),
        ("none", 3.0, "noise and the sensors' step alone make 0.10 N"),
    ],
)
def test_how_far_the_gap_shrinks_is_stated(text_of, effects, after_n, words):
    assert words in text_of(verdict_of(effects, gap=gap_of(3.0, after_n)))


def test_what_is_undecided_is_recorded_before_anything_is_adapted(text_of):
    sure = text_of(verdict_of("payload", 0.95, next_experiment="Load it."))
    assert sure.index("Adapt the estimator") < sure.index("What to record next. Load it.")
    less_sure = text_of(verdict_of("payload", 0.6, next_experiment="Load it."))
    assert "40 % of the probability lies elsewhere" in less_sure
    for undecided in (
        verdict_of("payload", 0.4, next_experiment="Load it."),
        verdict_of("payload", 0.95, next_experiment="Load it.", ambiguity_group=("none",)),
    ):
        text = text_of(undecided)
        assert "Record what decides" in text
        assert "cablesense gap record" in text
        assert "gap adapt" not in text


def test_the_folder_holds_the_verdict_the_amended_arm_and_the_report(tmp_path, monkeypatch):
    draw_no_pictures(monkeypatch)
    folder = tmp_path / "new" / "diagnosis"
    heavier = amended_arm(LAB, {Term("payload", "segment_2", "mass_kg"): 0.3}, {})
    diagnosis = replace(found(PAYLOAD, warnings=("cable_3 stands still",)), amended=heavier)
    write_diagnosis(folder, diagnosis)
    assert read_verdict(folder / "verdict.json") == PAYLOAD
    amended = folder / "amended_arm.yaml"
    assert load_arm(amended) == heavier
    headline = amended.read_text(encoding="utf-8").splitlines()[0]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert headline.removeprefix("# ") in page
    assert "cable_3 stands still" in page


def test_the_terminal_says_how_large_an_effect_is_and_what_it_leaves_of_the_gap():
    number = FittedNumber(value=0.2002, unit="N·m", ci95=(0.1987, 0.2017))
    one = verdict_of("joint_friction", parameters={"joint_friction.torque_n_m": number})
    assert size_lines(one) == [
        "  joint_friction.torque_n_m: 0.2002 N·m (0.1987 to 0.2017)",
        "With that, the gap of trials that were not fitted falls from 3.00 N to 0.20 N.",
    ]
    many = {f"sensor_gain.cable_{n}.gain": number for n in range(1, 8)}
    (*_, further, _) = size_lines(verdict_of("sensor_gain", parameters=many))
    assert further == "  and 3 more in the report"
    assert not size_lines(verdict_of("none"))
