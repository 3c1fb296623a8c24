"""The demo: its nodes, its script of pushes, the report of a record, and headless runs."""

import io
import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from cablesense_msgs_py.messages import Contact, ForceState, Level
from cablesense_online.page.shown_arm import ShownArm
from cablesense_online.page.snapshot import ForceBounds, PlaceInterval, ShownStatus, Snapshot
from cablesense_ros import demo
from cablesense_ros.cli import runs
from cablesense_ros.cli.app import app
from cablesense_ros.demo import (
    AS_FILE,
    BUILT_SEED,
    DemoOptions,
    Source,
    node_commands,
    run_headless,
)
from cablesense_ros.demo_pushes import (
    PushRecord,
    ScriptError,
    coverage_line,
    draw_pushes,
    make_script,
    metrics,
    push_results,
    results_table,
    summary,
)
from cablesense_sim.arm import open_arm
from tests.helpers.example_machines import MACHINES

SHOWN = ShownArm(open_arm("cdsm"))
TOUCHED_M = np.tile([0.02, 0.13], (4, 1))
SOURCES = {Source.SIM: ["sim"], Source.CAN: ["can_emulator", "can_driver", "sim"]}


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize("source", Source)
def test_the_nodes_are_those_of_the_source(source, live, tmp_path):
    options = DemoOptions(out=tmp_path, seed=3, source=source)
    commands = node_commands(options, live)
    assert list(commands) == [
        *SOURCES[source],
        "estimator",
        "commissioner",
        *(["page"] if live else []),
    ]
    assert "seed:=3" in commands["sim"]
    assert f"built_seed:={BUILT_SEED}" in commands["sim"]
    if live:
        assert "commission_at_start:=true" in commands["page"]
    if source is Source.SIM:
        assert "-r" not in commands["sim"]
    else:
        link = f'channel:="{tmp_path}/can_adapter"'
        assert link in commands["can_emulator"]
        assert link in commands["can_driver"]
        assert "cable_tensions:=simulated_tensions" in commands["sim"]


def test_slow_sensors_are_read_more_often_and_fast_ones_at_their_rate(tmp_path):
    slow, fast = (
        node_commands(DemoOptions(arm=arm, out=tmp_path), live=False)["sim"]
        for arm in ("cdsm_lab", "cdsm")
    )
    assert "rate_hz:=50.0" in slow
    assert not any(word.startswith("rate_hz") for word in fast)


def test_a_machine_of_commanded_joints_is_commissioned_at_a_rate_that_shows(tmp_path):
    commands = node_commands(
        DemoOptions(arm=str(MACHINES / "finger.yaml"), out=tmp_path), live=True
    )
    assert "commission_at_start:=true" in commands["page"]
    assert "rate_hz:=50.0" in commands["sim"]
    assert list(commands) == ["sim", "estimator", "commissioner", "page"]


def test_without_a_commissioning_nobody_asks_for_one(tmp_path):
    commands = node_commands(DemoOptions(out=tmp_path, commission=False), live=True)
    assert "commissioner" not in commands
    assert "commission_at_start:=false" in commands["page"]


@pytest.mark.parametrize(
    ("asked", "built_seed", "commission"),
    [
        ([], BUILT_SEED, True),
        (["--built-seed", "3"], 3, True),
        (["--as-file"], AS_FILE, True),
        (["--breathe"], AS_FILE, True),
        (["--no-commission"], BUILT_SEED, False),
    ],
)
def test_the_arm_is_a_built_one_unless_it_is_asked_for_as_its_file(
    tmp_path, monkeypatch, asked, built_seed, commission
):
    played = []
    monkeypatch.setattr(runs, "run_headless", lambda options, **_: played.append(options))
    command = ["demo", "--headless", "--out", str(tmp_path), *asked]
    assert CliRunner().invoke(app, command).exit_code == 0
    (options,) = played
    assert (options.built_seed, options.commission) == (built_seed, commission)


def test_as_its_file_and_with_errors_at_once_is_refused(tmp_path):
    command = ["demo", "--headless", "--out", str(tmp_path), "--as-file", "--built-seed", "3"]
    refused = CliRunner().invoke(app, command).exception
    assert "--built-seed has no effect with --as-file" in str(refused)


def test_breathing_keeps_an_arm_that_is_asked_for(tmp_path, monkeypatch):
    played = []
    monkeypatch.setattr(runs, "run_headless", lambda options, **_: played.append(options))
    for asked in ([], ["--arm", "cdsm"]):
        command = ["demo", "--headless", "--breathe", "--out", str(tmp_path), *asked]
        assert CliRunner().invoke(app, command).exit_code == 0
    assert [options.arm for options in played] == ["cdsm_friction", "cdsm"]
    assert "breather" in node_commands(played[0], live=False)


@pytest.mark.parametrize(
    ("screens", "opened"), [({}, []), ({"DISPLAY": ":0"}, ["http://page/"])], ids=["none", "X"]
)
def test_the_page_opens_where_there_is_a_screen(monkeypatch, screens, opened):
    addresses = []
    monkeypatch.setattr(demo.webbrowser, "open", addresses.append)
    monkeypatch.setattr(demo.sys, "platform", "linux")
    monkeypatch.setattr(demo.os, "environ", screens)
    demo._open_in_browser("http://page/")
    assert addresses == opened


def test_a_minute_visits_every_segment_straight_and_bent():
    script = make_script(SHOWN, TOUCHED_M, 60.0, seed=0)
    assert script[-1].end_s <= 60.0
    assert {push.contact.segment for push in script} == {1, 2, 3, 4}
    assert {push.bent for push in script} == {True, False}
    assert all(push.bent == bool(push.command.any()) for push in script)
    assert all(a.end_s < b.start_s for a, b in pairwise(script))
    assert all(push.move_s < push.start_s < push.end_s for push in script)
    again = make_script(SHOWN, TOUCHED_M, 60.0, seed=0)
    other = make_script(SHOWN, TOUCHED_M, 60.0, seed=8)
    assert [p.contact for p in again] == [p.contact for p in script]
    assert [p.contact for p in other] != [p.contact for p in script]
    newtons = np.array([push.contact.magnitude_n for push in script])
    assert (newtons > 0.02 * SHOWN.strongest_n).all()
    assert (newtons < 0.61 * SHOWN.strongest_n).all()


def test_pushes_go_anywhere_within_the_reach_with_a_small_axial_part():
    contacts = [push.contact for push in make_script(SHOWN, TOUCHED_M, 600.0, seed=0)]
    places_m = np.array([each.contact_m for each in contacts])
    nearest_m, farthest_m = TOUCHED_M[[each.segment - 1 for each in contacts]].T
    share = (places_m - nearest_m) / (farthest_m - nearest_m)
    assert 0.0 <= share.min() < 0.1 < 0.9 < share.max() <= 1.0
    along = np.array([each.along_n / each.magnitude_n for each in contacts])
    assert -0.2 <= along.min() < -0.1 < 0.1 < along.max() <= 0.2
    points = make_script(SHOWN, np.full((4, 2), 0.065), 60.0, seed=0, most_along=0.0)
    assert {push.contact[3:5] for push in points} == {(0.065, 0.0)}


@pytest.mark.parametrize("duration_s", [-1.0, 3.9, float("nan")])
def test_no_script_without_room_for_a_push(duration_s):
    with pytest.raises(ScriptError, match="one push takes"):
        make_script(SHOWN, TOUCHED_M, duration_s, seed=0)


def results_of(script, estimate_of, unknown=None):
    """The record of a script whose pushes are estimated so, and its results."""
    times = np.arange(0.0, script[-1].end_s, 0.04)
    snapshots = []
    for time_s in times:
        push = next((p for p in script if p.start_s <= time_s < p.end_s), None)
        estimate = estimate_of(push) if push else None
        moment = estimate if estimate and estimate.moment_n_m else None
        contacts = () if estimate is None or moment else (estimate,)
        state = unknown or (ForceState.CONTACT if estimate else ForceState.FREE)
        fine = ShownStatus(Level.OK, "fine")
        pose = np.zeros(8)
        tensions = np.full(12, 50.0)
        shown = contacts, state, contacts, None, None, fine, moment
        snapshots.append(Snapshot(time_s, pose, pose, tensions, *shown))
    played = PushRecord(times, snapshots)
    return played, push_results(script, played)


def shown(segment, angle_deg=0.0):
    return Contact(segment, angle_deg, 10.0, 0.05)


def exact(push):
    return push.contact


def test_exact_estimates_have_no_error_and_are_reported_in_full(tmp_path):
    script = make_script(SHOWN, TOUCHED_M, 60.0, seed=0)
    played, results = results_of(script, exact)
    summarised = summary(results)
    assert summarised["segment_right"] == summarised["pushes"] == len(script)
    assert summarised["direction_mae_deg"] == pytest.approx(0.0, abs=1e-9)
    assert summarised["magnitude_mae_n"] == pytest.approx(0.0, abs=1e-9)
    assert summarised["place_mae_mm"] == pytest.approx(0.0, abs=1e-9)
    assert summarised["moment_mae_n_m"] is None
    output = io.StringIO()
    Console(file=output, width=80).print(results_table(results, SHOWN.words))
    for push, plain in zip(script, metrics(results)["pushes"], strict=True):
        assert f"{push.contact.angle_deg:.1f}°" in output.getvalue()
        assert f"{push.contact.magnitude_n:.1f} N" in output.getvalue()
        assert plain["true"] == pytest.approx(plain["estimated"])
    pytest.importorskip("matplotlib")
    from PIL import Image

    draw_pushes(tmp_path / "demo.png", played, results, SHOWN.words)
    image = np.asarray(Image.open(tmp_path / "demo.png").convert("RGB"))
    assert image.shape[0] > 600
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 200
    assert [path.name for path in tmp_path.iterdir()] == ["demo.png"]


def test_a_wrong_segment_silence_and_no_contact_are_told_apart():
    script = make_script(SHOWN, TOUCHED_M, 4.0, seed=0)
    other = shown(script[0].contact.segment - 1)
    _, (wrong,) = results_of(script, lambda _: other)
    _, (silent,) = results_of(script, exact, unknown=ForceState.SILENT)
    _, (no_contacts,) = results_of(script, lambda _: None)
    assert not wrong.segment_right
    assert summary([wrong])["magnitude_mae_n"] is None
    assert (silent.sample_count, no_contacts.estimate) == (0, None)
    assert no_contacts.sample_count > 10
    output = io.StringIO()
    Console(file=output, width=80).print(results_table([silent, no_contacts], SHOWN.words))
    assert "no estimate" in output.getvalue()
    assert "no contact" in output.getvalue()


def test_a_moment_is_compared_as_one_and_has_no_place():
    def moment(push):
        contact = push.contact
        moment_n_m = 0.1 + contact.contact_m * contact.magnitude_n
        return Contact(contact.segment, contact.angle_deg, moment_n_m=moment_n_m)

    _, (result,) = results_of(make_script(SHOWN, TOUCHED_M, 4.0, seed=0), moment)
    assert result.segment_right
    assert result.errors.keys() == {"direction_deg", "moment_n_m"}
    assert result.errors["moment_n_m"] == pytest.approx(0.1)
    output = io.StringIO()
    Console(file=output, width=80).print(results_table([result], SHOWN.words))
    assert "4, moment" in output.getvalue()
    assert "+0.10 N·m" in output.getvalue()
    assert metrics([result])["pushes"][0]["estimated"]["moment_n_m"] > 0.0


def with_intervals(played, force_n, place_m):
    """The same record with intervals of these half widths about the truth of each moment."""
    snapshots = []
    for now in played.snapshots:
        if not now.true:
            snapshots.append(now)
            continue
        true = now.true[0]
        low_m = true.contact_m - place_m
        high_m = true.contact_m + place_m
        snapshots.append(
            replace(
                now,
                bounds=ForceBounds(true.magnitude_n - 1.0, true.magnitude_n + force_n),
                region=(PlaceInterval(true.segment, low_m, high_m),),
            )
        )
    return PushRecord(played.times_s, snapshots)


@pytest.mark.parametrize(
    ("force_n", "place_m", "line"),
    [(1.0, 0.005, "1 of 1 places, 1 of 1 forces"), (-0.5, -0.005, "0 of 1 places, 0 of 1 forces")],
)
def test_the_report_counts_truths_in_their_stated_intervals(force_n, place_m, line):
    script = make_script(SHOWN, TOUCHED_M, 4.0, seed=0)
    played, _ = results_of(script, exact)
    results = push_results(script, with_intervals(played, force_n, place_m))
    assert coverage_line(results).endswith(line)
    figures = metrics(results)
    assert figures["summary"]["force_intervals"] == 1
    assert len(figures["pushes"][0]["force_ci95_n"]) == 2


def test_a_built_arm_is_commissioned_pushed_and_reported(tmp_path, capfd):
    """By simulated sensors; test_kills.py has the chain through CAN frames."""
    run_headless(DemoOptions(out=tmp_path), duration_s=4.0, as_json=True)
    out, said = capfd.readouterr()
    report = json.loads(out)
    known_n = [float(each) for each in re.findall(r"±\s*([0-9.]+)\s+N", said)]
    assert 0.0 < known_n[1] < known_n[0]  # after the tare, and after the commissioning
    assert report["summary"]["pushes"] == report["summary"]["segment_right"] == 1
    assert report["summary"]["place_covered"] == report["summary"]["force_covered"] == 1
    assert report["summary"]["magnitude_mae_n"] < 2.0
    assert report["summary"]["place_mae_mm"] < 3.0
    assert (tmp_path / "demo.png").is_file()
