"""A recorded run through the same code gives the same bytes, and says where it does not."""

from __future__ import annotations

import csv
import functools
import json

import pytest
from recorded_runs import EPOCH_NS, STEP_NS, MadeRun
from typer.testing import CliRunner

from cablesense_base import CableSenseError
from cablesense_gap.recordings.recording import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.serialized import restamped
from cablesense_online.replay import RebuiltEstimation, RecordedRun, replay_in_process
from cablesense_ros.cli.app import app

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)


pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning")]


made_run = functools.cache(MadeRun)


@pytest.fixture(scope="module")
def made():
    return made_run()


@pytest.fixture(scope="module")
def whole(made, tmp_path_factory):
    return made.write(tmp_path_factory.mktemp("runs") / "whole.mcap")


def replayed(path):
    return replay_in_process(RecordedRun(path))


def test_every_byte_is_the_same(whole):
    got = replayed(whole)
    assert (got.samples, got.compared, got.identical) == (300, 300, 300)
    assert 50 < got.contacts < 250
    assert got.same
    assert not got.first_difference


def test_a_breath_is_repeated_from_the_journal_from_between_its_turns_too(tmp_path):
    made = made_run(breath=True)
    got = replayed(made.write(tmp_path / "breath.mcap"))
    assert (got.compared, got.identical) == (300, 300)
    assert got.contacts < replayed(made_run().write(tmp_path / "none.mcap")).contacts
    for first in (75, 115, 145):
        begin = EPOCH_NS + first * STEP_NS
        latched = [r for r in made.records if r[0] == topics.JOURNAL and r[1] < begin][-1:]
        records = [(topic, begin, raw) for topic, _, raw in latched]
        records += [record for record in made.records if record[1] >= begin]
        got = replayed(made.write(tmp_path / f"from_{first}.mcap", records))
        assert (got.compared, got.identical) == (300 - first, 300 - first)


@pytest.mark.parametrize(("model", "missed"), [("", 30), ("cdsm_moving", 2)])
def test_answers_that_the_recorder_came_too_late_for_change_nothing(model, missed, tmp_path):
    made = made_run(model=model) if model else made_run()
    first = [record for record in made.records if record[0] == topics.WRENCH][:missed]
    path = made.write(tmp_path / "late.mcap", [r for r in made.records if r not in first])
    got = replayed(path)
    assert (got.unanswered, got.compared, got.identical) == (missed, 300 - missed, 300 - missed)


def test_a_history_dependent_model_is_reproducible_only_from_a_start_on(tmp_path):
    states = RecordedRun(made_run(model="cdsm_moving").write(tmp_path / "run.mcap")).states
    rebuilt = RebuiltEstimation("", "")
    rebuilt.restore(states[0].model_copy(update={"events": ()}))
    assert not rebuilt.reproducible  # its past was not recorded
    rebuilt.restore(states[0])
    assert rebuilt.reproducible


def test_begun_anywhere_and_in_any_namespace_it_is_the_same(made, tmp_path):
    """The latest journal entry is latched, and comes first to who joins late."""
    latched = [
        r for r in made.records if r[0] == topics.JOURNAL and r[1] < 500 * STEP_NS + EPOCH_NS
    ]
    for first in (75, 152, 285):
        begin = EPOCH_NS + first * STEP_NS
        before = [r for r in latched if r[1] < begin][-1:]
        records = [(topic, begin, raw) for topic, _, raw in before]
        records += [r for r in made.records if r[1] >= begin]
        path = made.write(tmp_path / f"from_{first}.mcap", records, "/left/arm")
        got = replayed(path)
        assert (got.samples, got.identical) == (300 - first, 300 - first), first


def test_a_changed_bit_is_found_and_the_command_fails(made, tmp_path):
    records = list(made.records)
    at = [i for i, record in enumerate(records) if record[0] == topics.WRENCH][100]
    topic, log_ns, raw = records[at]
    records[at] = (topic, log_ns, raw[:-9] + bytes([raw[-9] ^ 1]) + raw[-8:])
    path = made.write(tmp_path / "changed.mcap", records)
    got = replayed(path)
    assert (got.compared, got.identical) == (300, 299)
    assert got.first_difference.startswith("sample 101, stamp 17")
    assert "recorded" in got.first_difference
    done = CliRunner().invoke(app, ["replay", str(path)])
    assert done.exit_code == 1
    assert "first difference: sample 101" in done.stdout
    assert "299  bit-identical" in done.stdout


def test_samples_without_answer_or_stamp_and_answers_without_sample_are_counted(made, tmp_path):
    answers = [i for i, record in enumerate(made.records) if record[0] == topics.WRENCH]
    samples = [i for i, record in enumerate(made.records) if record[0] == topics.CABLE_TENSIONS]
    records = list(made.records)
    topic, log_ns, raw = records[samples[20]]
    records[samples[20]] = (topic, log_ns, restamped(raw, 0))  # its answer is a zero
    gone = {answers[10], answers[120], samples[130]}  # sample 130 had a contact
    records = [record for i, record in enumerate(records) if i not in gone]
    got = replayed(made.write(tmp_path / "holes.mcap", records))
    assert (got.unanswered, got.lone_contacts) == (3, 1)
    assert got.compared == got.identical == 296


def test_a_recording_that_breaks_off_is_compared_up_to_there(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: int(0.6 * whole.stat().st_size)])
    done = CliRunner().invoke(app, ["replay", str(path), "--json"])
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert "breaks off" in printed["cut"]
    assert 0 < printed["compared"] == printed["identical"] < 300


def test_estimates_are_written_and_another_model_gives_others(whole, tmp_path):
    table = tmp_path / "estimates.csv"
    done = CliRunner().invoke(app, ["replay", str(whole), "--estimates", str(table)])
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 300
    touched = [row for row in rows if row["segment"] == "3"]
    assert 50 < len(touched) < 250
    assert all(abs(float(row["magnitude_n"]) - 31.6) < 2.0 for row in touched)
    assert [path.name for path in tmp_path.iterdir()] == ["estimates.csv"]
    other = ["--model", "cdsm_tensions_only", "--estimates", str(tmp_path / "other.csv")]
    done = CliRunner().invoke(app, ["replay", str(whole), *other])
    assert done.exit_code == 0, done.output
    assert 0 < replay_in_process(RecordedRun(whole), model="cdsm_tensions_only").identical < 300
    assert len((tmp_path / "other.csv").read_text(encoding="utf-8").splitlines()) == 301


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"model SHA-256": "0" * 64}, "is another; name the model with --model"),
        ({"model": "/nowhere/none.onnx"}, "unknown model 'none'"),
    ],
)
def test_a_recorded_model_that_is_not_there_is_refused(change, problem, whole):
    state = RecordedRun(whole).states[0]
    with pytest.raises(CableSenseError, match=problem):
        RebuiltEstimation("", "").restore(
            state.model_copy(update={"origin": {**state.origin, **change}})
        )


def test_recordings_that_cannot_be_replayed_are_one_line(made, tmp_path):
    def path(name, wanted=None, **more):
        records = [r for r in made.records if wanted is None or r[0] in wanted]
        return made.write(tmp_path / name, records, **more)

    with pytest.raises(RecordingError, match="has no cable_tensions, but /estimator/wrench"):
        RecordedRun(path("a.mcap", {topics.WRENCH}))
    with pytest.raises(RecordingError, match="has no ~/journal"):
        replayed(path("b.mcap", {topics.CABLE_TENSIONS, topics.WRENCH}))
    with pytest.raises(RecordingError, match="is of type 'std_msgs/msg/String'; it must be"):
        RecordedRun(path("c.mcap", kinds={topics.JOURNAL: "std_msgs/msg/String"}.items()))
    broken = [
        (t, log_ns, raw[:60] if t == topics.JOURNAL else raw) for t, log_ns, raw in made.records
    ]
    with pytest.raises(RecordingError, match="journal, message 1: cannot be read"):
        RecordedRun(made.write(tmp_path / "d.mcap", broken))
    with pytest.raises(RecordingError, match="is a folder"):
        RecordedRun(tmp_path)
